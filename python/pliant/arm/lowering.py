"""Descent of an arm: goals and torque limits, tick by tick, from measured positions.

A position servo carries a weight by its lead, the distance from the joint to its goal. The lead is
measured. Stiffness, payload and friction are not, so the measured lead drives the descent. Goals
start at their present values and move toward the joints, in proportion to the lead:

``goal ← goal + dt r u``, ``u = −40/s (goal − q − ℓ*)``.

So the arm descends its real potential, and transfers its weight to the object on which it comes to
rest. A goal never follows a joint upward. ``ℓ* = ∓ 2 τ_f / k_p`` lets a joint press downward with
little more than its own friction. The factor r keeps every point of the arm below the allowed speed
and below the speed at which an impact on an object of stiffness k exceeds the allowed force,
``v √(k m)``, with m the effective mass of the point along its path. r decreases further if the arm
moves faster than its goals.

- `rest`: if there is a rest pose, move toward it first, ``u = 4/s (q_rest − q)``;
- `down`: descend until no joint carries a load;
- `ramp`: reduce the limits to zero, and wait while anything moves.

If positions no longer arrive, a model of the arm replaces the measured one.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Literal

import numpy as np

from pliant.arm._points import Points

if TYPE_CHECKING:
    from pliant._core import Model, Servos
    from pliant._typing import Array, Mask
    from pliant.arm._points import Geometry

    Phase = Literal["rest", "down", "ramp", "done"]

#: Largest speed of the tool and of every joint origin during the descent [m/s], and of any joint
#: [rad/s].
SPEED, JOINT_SPEED = 0.15, 0.8
#: Lowest speed written to servos [rad/s]: some interpret 0 as no speed limit.
LEAST_SPEED = 0.01
#: Rates of the two descents [1/s], and the fade-in time [s].
TO_REST, DOWN, FADE = 4.0, 40.0, 0.3
#: Distance at which a joint counts as arrived at the rest pose [rad].
ARRIVED = 0.02
#: Least progress toward the rest pose [rad]; and the time without progress, or with goals and arm
#: at a standstill, after which a phase ends [s].
NEARER, STUCK = 0.01, 1.5
#: Largest impact force [N] on an object of this stiffness [N/m], with an additional unknown load at
#: the tool [kg]. For arms of less reach than this [m], the force is reduced in proportion.
IMPACT, HARD, UNKNOWN, REACH = 10.0, 2e4, 0.5, 0.55
#: Downward torque over friction, by the assumed stiffness; and the largest force with which a joint
#: may press the lowest of its points on what is below it [N].
PRESS, PUSH = 2.0, 1.5
#: Gravity torque over friction at which the downward press reaches its full value.
CLEAR = 0.5
#: Time in which the limit of a sinking joint rises from zero to the servo's maximum [s].
RAISED = 0.1
#: Time over which goals slow down if the arm moves faster than they do [s].
EASE = 0.2
#: Increase of the lead from which on a joint is sinking [rad]; at least two counts.
SUNK = 0.004
#: Lead that counts as zero [rad]; and how long all leads must be below it before `ramp` [s].
NOTHING, SETTLED = 0.003, 0.3
#: Window over which the speed of the arm is measured [s].
LOOK = 0.15
#: Speed of the arm's points that counts as still, and above which the arm is sliding [m/s].
STILL, LOOSE = 0.01, 0.04
#: Time in which limits fall to zero [s]; the second applies if a joint has no position.
RAMP, UNSEEN = 1.0, 6.0
#: Holding torque over gravity torque.
SUPPORT = 1.1
#: After this long without any position the descent goes blind; a single joint that is silent for as
#: long keeps its goal [s].
PATIENCE = 0.2
#: Longest descent before an arm with measured positions is released where it is [s].
LONGEST = 60.0
#: Upper bound of the time between two ticks [s].
LONGEST_TICK = 0.1


def margin(servos: Servos, gravity: Array) -> Array:
    """Return the torque margin (n,) [N·m] of joints over their gravity torque (n,) [N·m]."""
    least = np.maximum(0.1 * np.asarray(servos.max_torque), 2.0 * np.asarray(servos.friction))
    return np.maximum(least, 0.3 * np.abs(gravity))


class Lowering:
    """One descent, from the present pose until the limits are zero.

    Attributes:
        phase: `rest`, `down`, `ramp` or `done`.
        blind: Whether positions have been missing for so long that the model's replace them.
        velocity: Largest joint velocities (n,) [rad/s] while blind, so that a joint does not jump
            to a goal after lost packets; otherwise None.
    """

    def __init__(
        self,
        model: Model,
        servos: Servos,
        q: Array,
        *,
        goal: Array | None = None,
        limit: Array | None = None,
        rest: Array | None = None,
        speed: float = SPEED,
        points: Points | None = None,
    ) -> None:
        """Start from the last good reading.

        Args:
            model: The arm; its `gravity` gives the downward direction of each joint.
            servos: Its servo parameters, n entries.
            q: Last good joint positions (n,) [rad].
            goal: Last goals sent (n,) [rad]; None: holding goals by the servo table.
            limit: Last limits sent (n,) [N·m]; None: the weight and a margin.
            rest: Rest pose (n,) [rad]; None: straight down.
            speed: Largest speed of any point of the arm [m/s].
            points: The arm's points; None: made from the model.
        """
        self._model, self._speed = model, speed
        self._kp = np.asarray(servos.kp, dtype=np.float64)
        self._usable = np.asarray(servos.max_torque, dtype=np.float64)
        self._friction = np.asarray(servos.friction, dtype=np.float64)
        self._count = np.asarray(servos.encoder_step, dtype=np.float64)
        self._servos = servos
        self._impact = IMPACT * min(model.reach / REACH, 1.0)
        self._points = Points(model, servos.armature) if points is None else points
        self._rest = None if rest is None else np.asarray(rest, dtype=np.float64)
        gravity_vector = np.asarray(model.gravity_vector, dtype=np.float64)
        size = float(np.linalg.norm(gravity_vector))
        self._up = -gravity_vector / size if size > 0.0 else np.zeros(3)
        self._q = np.array(q, dtype=np.float64)
        self._silence = np.zeros_like(self._q)
        gravity = self._gravity()
        self._goal = self._q + gravity / self._kp if goal is None else np.array(goal, dtype=float)
        enough = np.minimum(SUPPORT * np.abs(gravity) + margin(servos, gravity), self._usable)
        self._limit = enough if limit is None else np.array(limit, dtype=np.float64)
        self._least = np.abs(self._goal - self._q)
        # Difference between measured and modelled lead, added to the modelled one while blind.
        self._unknown = self._goal - self._q - gravity / self._kp
        self._free = self._goal - self._q
        self.phase: Phase = "down" if rest is None else "rest"
        self.blind = False
        self.velocity: Array | None = None
        self._ease = 1.0
        self._age = self._total = self._light = self._stuck = 0.0
        self._nearest = np.inf
        self._presses, self._demand, self._led = True, 0.0, 0.0
        self._share, self._start, self._most = 1.0, self._limit, self._least
        self._past: deque[tuple[float, Array]] = deque([(0.0, self._q.copy())])
        self._goals: deque[tuple[float, Array]] = deque([(0.0, self._goal)])
        self._lead = self._goal - self._q

    def step(
        self, q: Array, dt: float, ok: Mask | bool = True, age: float = 0.0
    ) -> tuple[Array, Array] | None:
        """Compute goals and limits of one tick.

        Args:
            q: Joint positions (n,) [rad]; NaN and inf count as lost.
            dt: Time since the last tick [s].
            ok: Mask of the new positions (n,).
            age: Age of the goals that were in force when q was sampled [s].

        Returns:
            Goals (n,) [rad] and torque limits (n,) [N·m] to write; None if the arm rests and torque
            can be switched off.
        """
        if self._is_over():
            return None
        dt = min(max(dt, 0.0), LONGEST_TICK)
        good = np.isfinite(q) & ok
        self._silence = np.where(good, 0.0, self._silence + dt)
        self._age += dt
        self._total += dt
        if good.any():
            self._q = np.where(good, q, self._q)
            if self.blind:
                self._see_again()
            self._lead = np.where(good, self._goal_before(age) - self._q, self._lead)
            self._advance(dt, self._silence > PATIENCE)
        elif self._silence.min() > PATIENCE:
            self._go_blind()
            self._advance(dt, good)
        return None if self._is_over() else (self._goal.copy(), self._limit.copy())

    def _is_over(self) -> bool:
        """Return True if torque can be switched off."""
        return self.phase == "done"

    def _advance(self, dt: float, lost: Mask) -> None:
        """Update goals and limits; joints without a position keep their goal."""
        here, gravity = self._points(self._q), self._gravity()
        self._past.append((self._total, self._q.copy()))
        while len(self._past) > 2 and self._past[1][0] <= self._total - LOOK + 1e-9:
            self._past.popleft()
        speeds = self._speeds(here)
        seen = float(speeds.max())
        before = self._goal
        self._goals.append((self._total, before))
        if self.phase == "ramp":
            self._let_go(dt, seen, lost)
        else:
            u = self._toward_rest(dt) if self.phase == "rest" else self._downward(here, gravity)
            blocked = self._is_outward(u) | (lost & ~self.blind)
            u = np.where(blocked, 0.0, u)
            if self.phase == "down":
                u = self._without_rise(here, gravity, u)
            u = self._paced(here, u, speeds, dt)
            self._goal = self._goal + dt * u
            if self.phase == "rest":
                self._leash(gravity, u)
            self._limit = self._next_limit(dt, gravity)
            self._change_phase(dt, here, gravity, np.logical_or(blocked, lost), seen)
        if self.blind:
            self._follow(gravity)
            way = np.abs(self._goal - before) / dt if dt > 0.0 else np.zeros_like(before)
            self.velocity = np.maximum(1.25 * way, LEAST_SPEED)
        else:
            self.velocity = None

    def _downward(self, here: Geometry, gravity: Array) -> Array:
        """Return the joint velocities (n,) [rad/s] of the descent, before the speed limit."""
        carried, half = self._carried(here, gravity), 0.5 * self._count
        return -DOWN * (carried - np.clip(carried, -half, half))

    def _carried(self, here: Geometry, gravity: Array) -> Array:
        """Return the lead (n,) [rad] minus that of a lightly pressing joint."""
        press = np.minimum(PRESS * self._friction, PUSH * self._lever(here)) * self._presses
        clear = np.maximum(CLEAR * self._friction, 1e-9)
        excess: Array = self._lead + press / self._kp * np.clip(gravity / clear, -1.0, 1.0)
        return excess

    def _lever(self, here: Geometry) -> Array:
        """Return the lever (n,) [m] of each joint about the lowest point that it moves."""
        moves = (here.jacobian**2).sum(axis=1) > 1e-12
        height = np.where(moves, (here.position @ self._up)[:, None], np.inf)
        rise = np.abs(self._up @ here.jacobian)
        lever: Array = rise[height.argmin(axis=0), np.arange(rise.shape[1])]
        return lever

    def _goal_before(self, age: float) -> Array:
        """Return the goals (n,) [rad] in force when the present positions were sampled."""
        while len(self._goals) > 1 and self._goals[1][0] <= self._total - age + 1e-9:
            self._goals.popleft()
        return self._goals[0][1]

    def _toward_rest(self, dt: float) -> Array:
        """Return joint velocities (n,) [rad/s] toward the rest pose."""
        assert self._rest is not None
        away = self._rest - self._q
        far = float(np.abs(away).max())
        if far < self._nearest - NEARER:
            self._nearest, self._stuck = far, 0.0
        else:
            self._stuck += dt
        return TO_REST * away

    def _leash(self, gravity: Array, u: Array) -> None:
        """Keep goals within a margin of the lead at which joints last moved freely."""
        push = margin(self._servos, gravity) / self._kp
        lead = self._goal - self._q
        moving = np.abs(self._speed_of_joints()) > 0.3 * np.abs(u)
        self._free = np.where(moving, self._free + 0.2 * (lead - self._free), self._free)
        self._goal = self._q + np.clip(lead, self._free - push, self._free + push)

    def _is_outward(self, u: Array) -> Mask:
        """Return a mask (n,) of joints at a position limit that u would move outward."""
        outward: Mask = (u < 0.0) & (self._q <= self._model.lower) | (u > 0.0) & (
            self._q >= self._model.upper
        )
        return outward

    def _without_rise(self, here: Geometry, gravity: Array, u: Array) -> Array:
        """Return u (n,) [rad/s] without the part that raises the tool."""
        rise = self._up @ here.jacobian[-1]
        climb = float(rise @ u)
        if climb <= 0.0:
            return u
        soft = np.where(u == 0.0, 0.0, rise / self._kp)
        u = u - soft * (climb / max(float(rise @ soft), 1e-9))
        # A joint that already presses enough must not press more to keep the tool down.
        pressed = self._carried(here, gravity) * np.sign(gravity) < -0.5 * self._count
        u = np.where(pressed & (u * gravity < 0.0), 0.0, u)
        lifts = np.maximum(rise * u, 0.0)
        climb, lift = float(rise @ u), float(lifts.sum())
        return u if climb <= 0.0 else np.where(lifts > 0.0, u * (1.0 - climb / lift), u)

    def _paced(self, here: Geometry, u: Array, speeds: Array, dt: float) -> Array:
        """Return u (n,) [rad/s], scaled down to the allowed speed."""
        velocity = here.velocity(u)
        speed = np.sqrt((velocity**2).sum(axis=1))
        mass = here.effective_mass(velocity)
        most = np.minimum(self._speed, self._impact / np.sqrt(HARD * (mass + UNKNOWN)))
        self._demand = float((speed / most).max())
        scale = min(
            1.0,
            1.0 / max(self._demand, 1e-9),
            JOINT_SPEED / max(float(np.abs(u).max()), 1e-9),
        )
        scale *= min(1.0, self._age / FADE)
        # If the arm moves faster than its goals, slow the goals down so that the servos brake it.
        ahead = min(max(2.2 - 2.0 * float((speeds / most).max()), 0.0), 1.0)
        self._ease += min(dt / EASE, 1.0) * (ahead - self._ease)
        scale *= self._ease
        self._led = scale * float(speed.max())
        return scale * u

    def _next_limit(self, dt: float, gravity: Array) -> Array:
        """Return torque limits (n,) [N·m] that fit the lead; they rise fast for a sinking joint."""
        size = np.abs(self._lead)
        sunk = size > self._least + np.maximum(SUNK, 2.0 * self._count)
        self._least = np.minimum(np.maximum(self._least, size - 2.0 * SUNK), size)
        weight = np.abs(gravity)
        enough = np.maximum(SUPPORT * weight, self._kp * size) + margin(self._servos, gravity)
        change = self._usable * dt / RAISED
        calm = np.maximum(np.minimum(self._limit, enough), self._limit - change)
        limit = np.where(sunk, self._limit + change, np.maximum(calm, SUPPORT * weight))
        return np.minimum(limit, self._usable)

    def _change_phase(
        self, dt: float, here: Geometry, gravity: Array, idle: Mask, seen: float
    ) -> None:
        """Enter the next phase if this one is over."""
        if self.phase == "rest":
            if self._nearest < ARRIVED or self._stuck > STUCK:
                self._enter("down")
            return
        carried = self._carried(here, gravity) * np.sign(gravity)
        little = np.maximum(NOTHING, 1.5 * self._count)
        waits = seen < STILL and self._led < STILL / 2.0
        # Encoder flicker makes goals tremble; the timer tolerates this on average.
        self._stuck = max(self._stuck + (dt if waits else -dt), 0.0)
        light = bool((idle | (carried < little)).all()) or self._stuck > STUCK
        calm = self._demand < 0.5 and seen < LOOSE if self._presses else seen < STILL
        self._light = self._light + dt if light and calm else 0.0
        # No timeout while blind: the model's arm comes to rest, a real one may still hang.
        late = self._total > LONGEST and not self.blind
        if late or (self._light > SETTLED and not self._presses):
            self._enter("ramp")
        elif self._light > SETTLED:
            # Stop pressing and check again: only the press may have moved the arm.
            self._presses, self._light = False, 0.0

    def _let_go(self, dt: float, seen: float, lost: Mask) -> None:
        """Reduce leads and limits to zero while the arm is still."""
        late = self._total > LONGEST and not self.blind
        if seen > LOOSE and not late:
            self._enter("down")
            return
        if seen < STILL or late:
            slow = UNSEEN if lost.any() or self.blind else RAMP
            self._share = max(self._share - dt / slow, 0.0)
        self._limit = self._share * self._start
        # Keep goals near a sliding arm; otherwise it would jump back once limits rise again.
        most = self._share * self._most
        goal = self._q + np.clip(self._goal - self._q, -most, most)
        self._goal = np.where(lost, self._goal, goal)
        if self._share <= 0.0:
            self.phase = "done"

    def _speed_of_joints(self) -> Array:
        """Return mean joint velocities (n,) [rad/s] over `LOOK`, without one count of flicker."""
        began, q = self._past[0]
        passed = self._past[-1][0] - began
        way = self._q - q
        way = way - np.clip(way, -self._count, self._count)
        speed: Array = way / passed if passed > 0.0 else np.zeros_like(way)
        return speed

    def _speeds(self, here: Geometry) -> Array:
        """Measured speeds of the arm's points (m,) [m/s]."""
        velocity = here.velocity(self._speed_of_joints())
        speeds: Array = np.sqrt((velocity**2).sum(axis=1))
        return speeds

    def _enter(self, phase: Phase) -> None:
        """Enter a phase and reset its timers."""
        self.phase, self._age, self._light, self._stuck = phase, 0.0, 0.0, 0.0
        self._share, self._start = 1.0, self._limit
        self._most = np.abs(self._goal - self._q)

    def _gravity(self) -> Array:
        """Return holding torques (n,) [N·m] at the last good positions, by the model."""
        return np.asarray(self._model.gravity(self._q), dtype=np.float64)

    # Without positions.

    def _go_blind(self) -> None:
        """Start to use the model's positions in place of the measured ones."""
        if not self.blind:
            self.blind = True
            self._unknown = self._goal - self._q - self._gravity() / self._kp

    def _follow(self, gravity: Array) -> None:
        """Move the model's arm to the positions that its goals hold."""
        self._lead = gravity / self._kp + self._unknown
        self._q = np.clip(self._goal - self._lead, self._model.lower, self._model.upper)

    def _see_again(self) -> None:
        """Continue from the measured positions; they may be far from the model's."""
        self.blind = False
        gravity = self._gravity()
        self._goal = self._q + gravity / self._kp + self._unknown
        self._past.clear()
        self._past.append((self._total, self._q.copy()))
        if self.phase == "ramp":
            self._enter("down")

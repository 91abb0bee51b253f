"""Bringing an arm down without dropping it: goals and limits, tick by tick, from positions alone.

A position servo carries a weight by its lead, the distance from the joint to its goal. The lead is
measured; stiffness, payload and friction are not, so nothing here is made from them. Goals begin
where they stand and creep toward the joints, each as fast as its lead is large,

``goal ← goal + dt r u``, ``u = −40/s (goal − q − ℓ*)``,

so that the arm descends the potential that it really has, and gives its weight to whatever it
comes to rest on. A goal never follows a joint upward. ``ℓ* = ∓ 2 τ_f / k_p`` lets a joint press
downward with little more than its own friction. r keeps every point of the arm below the speed
allowed and below what a thing of stiffness k may feel, ``v √(k m)``, m the mass that the point has
along its way; it falls further where the arm is seen to move faster than it is led.

- `rest`: toward a rest pose first, ``u = 4/s (q_rest − q)``, if there is one;
- `down`: until no joint carries anything;
- `ramp`: limits fall to zero, and wait while anything moves.

Where positions no longer arrive, the arm of the model takes the place of the real one.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Literal

import numpy as np

from pliant.arm.points import Points

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pliant import Model, Servos
    from pliant.arm.points import Geometry

    Array = NDArray[np.float64]
    Flags = NDArray[np.bool_]
    Phase = Literal["rest", "down", "ramp", "done"]

#: Speed of the tool and every joint origin on the way down [m/s], and of any joint [rad/s].
SPEED, JOINT_SPEED = 0.15, 0.8
#: Least speed that is asked of servos [rad/s]: some take 0 for no speed limit.
LEAST_SPEED = 0.01
#: Rates of the two descents [1/s], and the time over which they fade in [s].
TO_REST, DOWN, FADE = 4.0, 40.0, 0.3
#: Distance at which a joint counts as arrived at the rest pose [rad].
ARRIVED = 0.02
#: Way that counts as coming nearer to the rest pose [rad], and the time without any, or with goals
#: and arm at a standstill, after which a phase is over [s].
NEARER, STUCK = 0.01, 1.5
#: Largest force [N] that a thing of this stiffness [N/m] may feel where a point of the arm meets
#: it, with a load at the tool that the model does not know [kg]. Arms of less reach than this [m]
#: have as much less.
IMPACT, HARD, UNKNOWN, REACH = 10.0, 2e4, 0.5, 0.55
#: Downward torque over friction, by believed stiffness, and the largest force with which it may
#: press the lowest point that the joint moves on what is below it [N].
PRESS, PUSH = 2.0, 1.5
#: Gravity torque at which the downward press is fully there, over friction.
CLEAR = 0.5
#: A limit that lets a joint sink rises from nothing to all that the servo has in this time [s].
RAISED = 0.1
#: Time over which goals slow down for an arm that runs ahead of them [s].
EASE = 0.2
#: A joint sinks whose lead has grown by this much, or by two counts [rad].
SUNK = 0.004
#: Lead that counts as nothing [rad], and how long no joint may carry more before `ramp` [s].
NOTHING, SETTLED = 0.003, 0.3
#: Time over which the speed of the arm is measured, and by which it must be still [s].
LOOK = 0.15
#: Speed of the arm's points that counts as still, and above which an arm has come loose [m/s].
STILL, LOOSE = 0.01, 0.04
#: Time in which limits fall to zero [s]; the second where a joint is not seen.
RAMP, UNSEEN = 1.0, 6.0
#: Holding torque over gravity.
SUPPORT = 1.1
#: After this long without any position the descent goes blind; a joint silent for as long is left
#: alone [s].
PATIENCE = 0.2
#: Longest descent before an arm that is seen lets go wherever it is [s].
LONGEST = 60.0
#: Longest time between two ticks that counts [s].
LONGEST_TICK = 0.1


def margin(servos: Servos, gravity: Array) -> Array:
    """Torque (n,) [N·m] that joints may exert beyond their weight g (n,) [N·m]."""
    least = np.maximum(0.1 * np.asarray(servos.max_torque), 2.0 * np.asarray(servos.friction))
    return np.maximum(least, 0.3 * np.abs(gravity))


class Lowering:
    """One descent, from where the arm is to limits of zero.

    Attributes:
        phase: `rest`, `down`, `ramp` or `done`.
        blind: Whether no position has come for so long that the model's take their place.
        velocity: Fastest motion of the joints (n,) [rad/s] while blind: goals that did not arrive
            either would all be caught up with at once. None otherwise.
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
            model: The arm; its `gravity` tells which way is down for each joint.
            servos: Its servos (`kp`, `torque`, `friction`, `armature`, `count`), n entries.
            q: Last good joint positions (n,) [rad].
            goal: Last goals sent (n,) [rad]; None: what the weight needs by the servo table.
            limit: Last limits sent (n,) [N·m]; None: what the weight needs, and a margin.
            rest: Where to go first (n,) [rad]; None: straight down.
            speed: Largest speed of any point of the arm [m/s].
            points: The arm's points, where the caller has them already.
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
        self, q: Array, dt: float, ok: Flags | bool = True, age: float = 0.0
    ) -> tuple[Array, Array] | None:
        """One tick.

        Args:
            q: Joint positions (n,) [rad]; what is not finite counts as lost.
            dt: Time since the last tick [s].
            ok: Which positions are new (n,).
            age: How long before now a goal was sent that was in force when q was sampled [s].

        Returns:
            Goals (n,) [rad] and torque limits (n,) [N·m] to write; None when the arm rests and
            torque can go off.
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
        """Whether torque can go off."""
        return self.phase == "done"

    def _advance(self, dt: float, lost: Flags) -> None:
        """Move goals and limits on; lost joints keep their goal."""
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
        """Joint velocities (n,) [rad/s] of the descent, before they are paced."""
        carried, half = self._carried(here, gravity), 0.5 * self._count
        return -DOWN * (carried - np.clip(carried, -half, half))

    def _carried(self, here: Geometry, gravity: Array) -> Array:
        """How far the lead (n,) [rad] is from one that carries nothing and presses a little."""
        press = np.minimum(PRESS * self._friction, PUSH * self._lever(here)) * self._presses
        clear = np.maximum(CLEAR * self._friction, 1e-9)
        excess: Array = self._lead + press / self._kp * np.clip(gravity / clear, -1.0, 1.0)
        return excess

    def _lever(self, here: Geometry) -> Array:
        """Lever (n,) [m] with which each joint lowers the lowest of the points that it moves."""
        moves = (here.jacobian**2).sum(axis=1) > 1e-12
        height = np.where(moves, (here.position @ self._up)[:, None], np.inf)
        rise = np.abs(self._up @ here.jacobian)
        lever: Array = rise[height.argmin(axis=0), np.arange(rise.shape[1])]
        return lever

    def _goal_before(self, age: float) -> Array:
        """Goals (n,) [rad] that were in force when the present positions were sampled."""
        while len(self._goals) > 1 and self._goals[1][0] <= self._total - age + 1e-9:
            self._goals.popleft()
        return self._goals[0][1]

    def _toward_rest(self, dt: float) -> Array:
        """Joint velocities (n,) [rad/s] toward the rest pose."""
        assert self._rest is not None
        away = self._rest - self._q
        far = float(np.abs(away).max())
        if far < self._nearest - NEARER:
            self._nearest, self._stuck = far, 0.0
        else:
            self._stuck += dt
        return TO_REST * away

    def _leash(self, gravity: Array, u: Array) -> None:
        """Keep goals within a margin of the lead at which joints were last seen to move freely."""
        push = margin(self._servos, gravity) / self._kp
        lead = self._goal - self._q
        moving = np.abs(self._speed_of_joints()) > 0.3 * np.abs(u)
        self._free = np.where(moving, self._free + 0.2 * (lead - self._free), self._free)
        self._goal = self._q + np.clip(lead, self._free - push, self._free + push)

    def _is_outward(self, u: Array) -> Flags:
        """Which joints stand at a limit of their range and would be led out of it (n,)."""
        outward: Flags = (u < 0.0) & (self._q <= self._model.lower) | (u > 0.0) & (
            self._q >= self._model.upper
        )
        return outward

    def _without_rise(self, here: Geometry, gravity: Array, u: Array) -> Array:
        """Return u (n,) [rad/s] without what raises the tool."""
        rise = self._up @ here.jacobian[-1]
        climb = float(rise @ u)
        if climb <= 0.0:
            return u
        soft = np.where(u == 0.0, 0.0, rise / self._kp)
        u = u - soft * (climb / max(float(rise @ soft), 1e-9))
        # A joint that presses enough does not press more to keep the tool down.
        pressed = self._carried(here, gravity) * np.sign(gravity) < -0.5 * self._count
        u = np.where(pressed & (u * gravity < 0.0), 0.0, u)
        lifts = np.maximum(rise * u, 0.0)
        climb, lift = float(rise @ u), float(lifts.sum())
        return u if climb <= 0.0 else np.where(lifts > 0.0, u * (1.0 - climb / lift), u)

    def _paced(self, here: Geometry, u: Array, speeds: Array, dt: float) -> Array:
        """Return u (n,) [rad/s] as slow as the arm may move."""
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
        # A goal that waits lets the servo brake an arm that runs ahead of it.
        ahead = min(max(2.2 - 2.0 * float((speeds / most).max()), 0.0), 1.0)
        self._ease += min(dt / EASE, 1.0) * (ahead - self._ease)
        scale *= self._ease
        self._led = scale * float(speed.max())
        return scale * u

    def _next_limit(self, dt: float, gravity: Array) -> Array:
        """Torque limits (n,) [N·m]: enough for the lead, more at once for a joint that sinks."""
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
        self, dt: float, here: Geometry, gravity: Array, idle: Flags, seen: float
    ) -> None:
        """Go on to the next phase where this one is over."""
        if self.phase == "rest":
            if self._nearest < ARRIVED or self._stuck > STUCK:
                self._enter("down")
            return
        carried = self._carried(here, gravity) * np.sign(gravity)
        little = np.maximum(NOTHING, 1.5 * self._count)
        waits = seen < STILL and self._led < STILL / 2.0
        # Flickering encoders make goals tremble, which counts as waiting in the long run.
        self._stuck = max(self._stuck + (dt if waits else -dt), 0.0)
        light = bool((idle | (carried < little)).all()) or self._stuck > STUCK
        calm = self._demand < 0.5 and seen < LOOSE if self._presses else seen < STILL
        self._light = self._light + dt if light and calm else 0.0
        # The model's arm comes to rest in the end; a real one that is not seen may still hang.
        late = self._total > LONGEST and not self.blind
        if late or (self._light > SETTLED and not self._presses):
            self._enter("ramp")
        elif self._light > SETTLED:
            # An arm that moves only because its joints press counts as resting.
            self._presses, self._light = False, 0.0

    def _let_go(self, dt: float, seen: float, lost: Flags) -> None:
        """Let leads and limits fall to nothing while the arm is still."""
        late = self._total > LONGEST and not self.blind
        if seen > LOOSE and not late:
            self._enter("down")
            return
        if seen < STILL or late:
            slow = UNSEEN if lost.any() or self.blind else RAMP
            self._share = max(self._share - dt / slow, 0.0)
        self._limit = self._share * self._start
        # A goal that stayed behind a sliding arm would be caught up with once limits rise again.
        most = self._share * self._most
        goal = self._q + np.clip(self._goal - self._q, -most, most)
        self._goal = np.where(lost, self._goal, goal)
        if self._share <= 0.0:
            self.phase = "done"

    def _speed_of_joints(self) -> Array:
        """Mean joint velocities (n,) [rad/s] over the last moments; a count may flicker."""
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
        """Begin a phase with clean clocks."""
        self.phase, self._age, self._light, self._stuck = phase, 0.0, 0.0, 0.0
        self._share, self._start = 1.0, self._limit
        self._most = np.abs(self._goal - self._q)

    def _gravity(self) -> Array:
        """Holding torques (n,) [N·m] at the last good positions, as the model has them."""
        return np.asarray(self._model.gravity(self._q), dtype=np.float64)

    # Without positions.

    def _go_blind(self) -> None:
        """Let the model's arm take the place of one that is not seen."""
        if not self.blind:
            self.blind = True
            self._unknown = self._goal - self._q - self._gravity() / self._kp

    def _follow(self, gravity: Array) -> None:
        """Move the model's arm to where its goals hold it."""
        self._lead = gravity / self._kp + self._unknown
        self._q = np.clip(self._goal - self._lead, self._model.lower, self._model.upper)

    def _see_again(self) -> None:
        """Go on from where the arm is: what carried the model's may be far from it."""
        self.blind = False
        gravity = self._gravity()
        self._goal = self._q + gravity / self._kp + self._unknown
        self._past.clear()
        self._past.append((self._total, self._q.copy()))
        if self.phase == "ramp":
            self._enter("down")

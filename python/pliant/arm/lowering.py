"""Bringing an arm down without dropping it: goals and limits, tick by tick, from positions alone.

``push = max(0.1 usable, 2 τ_f, 0.3 |g|)`` is the torque a joint may press with, beyond its weight.

- `rest`: toward a rest pose, ``u = 4/s (q_rest − ref)``, if there is one;
- `down`: the arm descends its own potential, ``u = −40/s g / k_p``; joints at a limit drop out;
- `ramp`: the same, while the share s of the weight that goals carry by themselves falls from 1 to 0
  within 3 s, and waits while the arm moves. What then carries an arm that does not rest after all
  is the reference, which it stays behind, and which goes down no faster than before.

Where positions no longer arrive, the arm of the model takes the place of the real one: it is where
its goals are. What would have been sent to it is sent, down the path that it would have taken.

``ref ← q + clip(ref + dt r u − q)``, where r keeps every point of the arm below 0.8 of the speed
allowed and the kinetic energy below ``F²/2k``: whatever of stiffness k takes all of it up feels F.
The clip is (usable − s |g|)/k_p where it lifts and s push/k_p where it presses. Then
``goal = ref + s g/k_p`` and ``limit = max(1.1 s |g|, |s g + k_p (ref − q)|) + push``.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Literal

import numpy as np

from pliant.arm.points import Points

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pliant import Model, Servos

    Array = NDArray[np.float64]
    Flags = NDArray[np.bool_]
    Phase = Literal["rest", "down", "ramp", "done"]

#: Speed of the tool and every joint origin on the way down [m/s], and of any joint [rad/s].
SPEED, JOINT_SPEED = 0.15, 0.5
#: Share of the speed allowed at which the reference moves, so that an arm behind it may catch up.
PACE = 0.8
#: Least speed that is asked of servos [rad/s]: some take 0 for none to be kept.
LEAST_SPEED = 0.01
#: Rates of the two descents [1/s], and how long they take to fade in [s].
TO_REST, DOWN, FADE = 4.0, 40.0, 0.3
#: Distance at which a joint counts as arrived at the rest pose [rad].
ARRIVED = 0.02
#: Standing still: no point moved this share of its commanded way within this time [s].
STILL, WINDOW = 0.1, 0.5
#: Share of its margin with which a joint presses downward: gently on what is in the way, and harder
#: where one is lost that the others have to drag along, lest they stop short and slide later.
PRESS, DRAG = 0.3, 0.5
#: What the arm meets on its way down may feel so much [N] if it is as stiff as this [N/m] and takes
#: up all of the motion; and the kinetic energy that the arm may have for that [J].
IMPACT, HARD = 13.0, 2e4
ENERGY = IMPACT**2 / (2.0 * HARD)
#: Time in which the weight is given up [s], shares of that energy below which it is given up
#: further and above which the arm does not rest yet, and the time over which these are taken [s].
RAMP, CALM, REST, LOOK = 3.0, 0.25, 0.01, 0.2
#: Time for the weight where a joint is not seen: what hangs on it sinks by its own friction [s].
UNSEEN = 6.0
#: Time in which joints that nothing else can bring down let go [s].
LOOSEN = 1.0
#: Holding torque over gravity.
SUPPORT = 1.1
#: After this long without any position the descent goes blind; a joint silent for as long is left
#: alone [s].
PATIENCE = 0.2
#: Longest descent before the arm lets go wherever it is, and longest time for that [s].
LONGEST, LAST = 60.0, 10.0
#: Longest time between two ticks that counts [s].
LONGEST_TICK = 0.1


def margin(servos: Servos, gravity: Array) -> Array:
    """Torque (n,) [N·m] that joints may exert beyond their weight g (n,) [N·m]."""
    least = np.maximum(0.1 * np.asarray(servos.torque), 2.0 * np.asarray(servos.friction))
    return np.maximum(least, 0.3 * np.abs(gravity))


class Lowering:
    """One descent, from where the arm is to limits of zero.

    Attributes:
        phase: `rest`, `down`, `ramp` or `done`.
        share: Share of the weight that goals carry by themselves, 1 to 0 in `ramp`.
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
        rest: Array | None = None,
        speed: float = SPEED,
        points: Points | None = None,
    ) -> None:
        """Start from the last good reading.

        Args:
            model: The arm; its `gravity` is what the servos are told to carry.
            servos: Its servos (`kp`, `torque`, `friction`, `armature`, `count`), n entries.
            q: Last good joint positions (n,) [rad].
            goal: Last goals sent (n,) [rad]: the descent starts from what they carry.
            rest: Where to go first (n,) [rad]; None: straight down.
            speed: Largest speed of any point of the arm [m/s].
            points: The arm's points, where the caller has them already.
        """
        self._model, self._servos, self._speed = model, servos, speed
        self._kp = np.asarray(servos.kp, dtype=np.float64)
        self._usable = np.asarray(servos.torque, dtype=np.float64)
        self._friction = np.asarray(servos.friction, dtype=np.float64)
        self._count = np.asarray(servos.count, dtype=np.float64)
        self._points = Points(model, servos.armature) if points is None else points
        self._rest = None if rest is None else np.asarray(rest, dtype=np.float64)
        self._q = np.array(q, dtype=np.float64)
        self._silence = np.zeros_like(self._q)
        self.share = 1.0
        self.blind = False
        self.velocity: Array | None = None
        self._loose = np.zeros(self._q.shape, dtype=bool)
        gravity = self._gravity()
        start = self._q if goal is None else np.asarray(goal) - gravity / self._kp
        self._ref = self._leash(start, gravity)
        self._last = (self._ref + gravity / self._kp, self._limit(gravity))
        self.phase: Phase = "down" if rest is None else "rest"
        self._age = self._total = 0.0
        self._history: deque[tuple[float, Array, float]] = deque()
        self._way = 0.0
        self._recent: deque[tuple[float, Array]] = deque()

    def step(self, q: Array, dt: float, ok: Flags | bool = True) -> tuple[Array, Array] | None:
        """One tick.

        Args:
            q: Joint positions (n,) [rad]; what is not finite counts as lost.
            dt: Time since the last tick [s].
            ok: Which positions are new (n,).

        Returns:
            Goals (n,) [rad] and torque limits (n,) [N·m] to write; None when the arm rests and
            torque can go off.
        """
        if self._is_over():
            return None
        dt = min(max(dt, 0.0), LONGEST_TICK)
        good = np.isfinite(q) & ok
        self._silence = np.where(good, 0.0, self._silence + dt)
        self._q = np.where(good, q, self._q)
        if good.any():
            if self.blind:
                # What carried the model may be far from where the arm is.
                self.blind, self._ref = False, self._q.copy()
            self._last = self._advance(dt, self._silence > PATIENCE)
        elif self._silence.min() > PATIENCE:
            self.blind = True
            if self.phase != "ramp":
                self._q = np.clip(self._ref, self._model.lower, self._model.upper)
            self._last = self._advance(dt, good)
        return None if self._is_over() else self._last

    def _is_over(self) -> bool:
        """Whether torque can go off."""
        return self.phase == "done"

    def _advance(self, dt: float, lost: Flags) -> tuple[Array, Array]:
        """Goals and limits for the present positions; lost joints keep their goal."""
        gravity = self._gravity()
        self._age += dt
        self._total += dt
        if self.phase == "rest" and self._rest is not None:
            u = TO_REST * (self._rest - self._ref)
        else:
            u = -DOWN * gravity / self._kp
        outward = (u < 0.0) & (self._q <= self._model.lower) | (u > 0.0) & (
            self._q >= self._model.upper
        )
        idle = outward | lost
        place, speed, u = self._paced(np.where(idle, 0.0, u))
        self._ref = self._leash(self._ref + dt * u, gravity)
        if self.phase == "ramp":
            self._unload(dt, idle)
        elif self._has_arrived(gravity, idle, lost) or self._is_still(place, speed, dt):
            self._enter("down" if self.phase == "rest" else "ramp")
        elif self._total > LONGEST:
            self._enter("ramp")
        goal = np.where(lost, self._last[0], self._ref + self.share * gravity / self._kp)
        self.velocity = None
        if self.blind and dt > 0.0:
            way = np.maximum(np.abs(u), np.abs(goal - self._last[0]) / dt)
            self.velocity = np.maximum(way / PACE, LEAST_SPEED)
        return goal, self._limit(gravity)

    def _paced(self, u: Array) -> tuple[Array, float, Array]:
        """Slow joint velocities u (n,) down to what the arm may move at.

        Returns:
            Points (m, 3) [m], the speed of the fastest one [m/s], and the velocities (n,) [rad/s].
        """
        place, velocity, energy = self._points.walk(self._q, u)
        fastest = float(np.sqrt((velocity**2).sum(axis=1)).max())
        scale = min(
            1.0,
            PACE * self._speed / max(fastest, 1e-9),
            JOINT_SPEED / max(float(np.abs(u).max()), 1e-9),
            float(np.sqrt(ENERGY / max(energy, 1e-12))),
        )
        scale *= min(1.0, self._age / FADE)
        return place, scale * fastest, scale * u

    def _unload(self, dt: float, idle: Flags) -> None:
        """Give up the weight while nothing moves, and rest once the servos carry nothing."""
        late = self._total > LONGEST
        self._loose = idle | self.blind | late
        self._ref -= np.where(self._loose, min(dt / LOOSEN, 1.0), 0.0) * (self._ref - self._q)
        energy = self._energy()
        if late or energy < CALM * ENERGY:
            slow = UNSEEN if self._is_blind_to_some() else RAMP
            self.share = max(self.share - dt / slow, 0.0)
        carried = np.abs(self._kp * (self._ref - self._q))
        little = np.maximum(0.5 * self._friction, 0.01 * self._usable)
        at_rest = energy < REST * ENERGY and bool((carried <= little).all())
        if self.share <= 0.0 and (at_rest or self._total > LONGEST + LAST):
            self.phase = "done"

    def _energy(self) -> float:
        """Kinetic energy of the arm's mean motion over the last moments [J].

        A joint that stands still may flicker by a count.
        """
        self._recent.append((self._age, self._q))
        while len(self._recent) > 2 and self._recent[1][0] <= self._age - LOOK + 1e-9:
            self._recent.popleft()
        began, q = self._recent[0]
        passed = self._age - began
        way = self._q - q
        way -= np.clip(way, -self._count, self._count)
        return self._points.walk(self._q, way / passed)[2] if passed > 0.0 else 0.0

    def _is_blind_to_some(self) -> bool:
        """Whether a joint is lost, or all are."""
        return bool((self._silence > PATIENCE).any())

    def _enter(self, phase: Phase) -> None:
        """Begin a phase with clean clocks."""
        self.phase, self._age, self._way = phase, 0.0, 0.0
        self._history.clear()
        self._recent.clear()

    def _gravity(self) -> Array:
        """Holding torques (n,) [N·m] at the last good positions."""
        return np.asarray(self._model.gravity(self._q), dtype=np.float64)

    def _leash(self, ref: Array, gravity: Array) -> Array:
        """Keep the reference where the servos can answer for it."""
        # What goals no longer carry by themselves, the reference has to.
        lift = np.maximum(self._usable - self.share * np.abs(gravity), 0.0)
        share = DRAG if self._is_blind_to_some() else PRESS
        press = np.maximum(share * margin(self._servos, gravity), 2.0 * self._friction)
        press *= self.share
        above = np.where(gravity > 0.0, lift, press) / self._kp
        below = np.where(gravity > 0.0, press, lift) / self._kp
        return self._q + np.clip(ref - self._q, -below, above)

    def _limit(self, gravity: Array) -> Array:
        """Torque limits (n,) [N·m] for the present reference."""
        wanted = np.abs(self.share * gravity + self._kp * (self._ref - self._q))
        limit = np.maximum(self.share * SUPPORT * np.abs(gravity), wanted)
        spare = np.where(self._loose, self.share, 1.0) * margin(self._servos, gravity)
        return np.minimum(limit + spare, self._usable)

    def _has_arrived(self, gravity: Array, idle: Flags, lost: Flags) -> bool:
        """At the rest pose; or hanging: no joint has more to carry than its friction."""
        if self.phase == "rest" and self._rest is not None:
            return bool((np.abs(self._rest - self._ref) < ARRIVED)[~lost].all())
        return bool((idle | (np.abs(gravity) < 1.5 * self._friction)).all())

    def _is_still(self, place: Array, speed: float, dt: float) -> bool:
        """Whether no point has moved a tenth of the commanded way within half a second."""
        self._way += speed * dt
        self._history.append((self._age, place, self._way))
        while len(self._history) > 1 and self._history[1][0] <= self._age - WINDOW:
            self._history.popleft()
        age, old, way = self._history[0]
        if age > self._age - WINDOW + 1e-9:
            return False
        moved = float(np.sqrt(((place - old) ** 2).sum(axis=1)).max())
        return moved < STILL * (self._way - way)

"""Bringing an arm down without dropping it: goals and limits, tick by tick, from positions alone.

``push = max(0.1 usable, 2 τ_f, 0.3 |g|)`` is the torque a joint may press with, beyond its weight.

- `rest`: toward a rest pose, ``u = 4/s (q_rest − ref)``, if there is one;
- `down`: the arm descends its own potential, ``u = −40/s g / k_p``; joints at a limit drop out;
- `ramp`: the limits fall from 1.1 |g| to nothing within 3 s, and wait while anything moves.

Where positions no longer arrive, the arm of the model takes the place of the real one: it is where
its goals are. What would have been sent to it is sent, down the path that it would have taken.

``ref ← q + clip(ref + dt s u − q)``, where s keeps every point of the arm below 0.8 of the speed
allowed, and the clip is (usable − |g|)/k_p where it lifts and push/k_p where it presses. Then
``goal = ref + g/k_p`` and ``limit = max(1.1 |g|, |g + k_p (ref − q)|) + push``.
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
#: Rates of the two descents [1/s], and how long they take to fade in [s].
TO_REST, DOWN, FADE = 4.0, 40.0, 0.3
#: Distance at which a joint counts as arrived at the rest pose [rad].
ARRIVED = 0.02
#: Standing still: no point moved this share of its commanded way within this time [s].
STILL, WINDOW = 0.1, 0.5
#: Share of the speed allowed at which an arm whose limits fall does not rest after all.
SLIP = 0.6
#: Least share of the weight that goals carry after that.
LEAST_SUPPORT = 0.3
#: Share of its margin with which a joint presses downward: gently on what is in the way, and harder
#: where one is lost that the others have to drag along, lest they stop short and slide later.
PRESS, DRAG = 0.3, 0.5
#: Time in which the limits fall [s].
RAMP = 3.0
#: Holding torque over gravity.
SUPPORT = 1.1
#: After this long without any position the descent goes blind; a joint silent for as long is left
#: alone [s].
PATIENCE = 0.2
#: Longest descent before the limits fall wherever the arm is [s].
LONGEST = 60.0
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
        share: Share of the weight that the limits still carry in `ramp`, 1 to 0.
        blind: Whether no position has come for so long that the model's take their place.
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
            servos: Its servos (`kp`, `torque`, `friction`), n entries.
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
        self._points = Points(model) if points is None else points
        self._rest = None if rest is None else np.asarray(rest, dtype=np.float64)
        self._q = np.array(q, dtype=np.float64)
        self._silence = np.zeros_like(self._q)
        self.share = self._support = 1.0
        self.blind = False
        gravity = self._gravity()
        start = self._q if goal is None else np.asarray(goal) - gravity / self._kp
        self._ref = self._leash(start, gravity)
        self._last = (self._ref + gravity / self._kp, self._limit(gravity))
        self.phase: Phase = "down" if rest is None else "rest"
        self._age = self._total = 0.0
        self._history: deque[tuple[float, Array, float]] = deque()
        self._way = 0.0
        self._before: Array | None = None

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
        if self.phase == "done":
            return None
        dt = min(max(dt, 0.0), LONGEST_TICK)
        good = np.isfinite(q) & ok
        self._silence = np.where(good, 0.0, self._silence + dt)
        self._q = np.where(good, q, self._q)
        if good.any():
            if self.blind:
                # What carried the model may be far from where the arm is.
                self.blind, self._ref = False, self._q.copy()
            self._last = self._advance(dt, good, self._silence > PATIENCE)
        elif self._silence.min() > PATIENCE:
            self.blind = True
            if self.phase != "ramp":
                self._q = np.clip(self._ref, self._model.lower, self._model.upper)
            self._last = self._advance(dt, ~good, good)
        return None if self.share <= 0.0 else self._last

    def _advance(self, dt: float, good: Flags, lost: Flags) -> tuple[Array, Array]:
        """Goals and limits for new positions of some joints; lost ones keep their goal."""
        gravity = self._gravity()
        self._age += dt
        self._total += dt
        if self.phase in {"rest", "down"}:
            goal, limit = self._descend(dt, gravity, lost)
        else:
            goal, limit = self._ramp(dt, gravity, good)
        return np.where(lost, self._last[0], goal), limit

    def _descend(self, dt: float, gravity: Array, lost: Flags) -> tuple[Array, Array]:
        """Phases `rest` and `down`."""
        if self.phase == "rest" and self._rest is not None:
            u = TO_REST * (self._rest - self._ref)
        else:
            u = -DOWN * gravity / self._kp
        outward = (u < 0.0) & (self._q <= self._model.lower) | (u > 0.0) & (
            self._q >= self._model.upper
        )
        u = np.where(outward | lost, 0.0, u)
        place, velocity = self._points.walk(self._q, u)
        fastest = float(np.sqrt((velocity**2).sum(axis=1)).max())
        most = float(np.abs(u).max())
        scale = min(1.0, self._age / FADE)
        scale *= min(1.0, 0.8 * self._speed / max(fastest, 1e-9), JOINT_SPEED / max(most, 1e-9))
        self._ref = self._leash(self._ref + dt * scale * u, gravity)
        if self._has_arrived(gravity, outward, lost) or self._is_still(place, fastest * scale, dt):
            self._enter("down" if self.phase == "rest" else "ramp")
        if self._total > LONGEST:
            self._enter("ramp")
        return self._ref + self._support * gravity / self._kp, self._limit(gravity)

    def _ramp(self, dt: float, gravity: Array, good: Flags) -> tuple[Array, Array]:
        """Limits fall while nothing moves; an arm that starts to fall is caught."""
        place = self._points(self._q)
        if self._before is not None and good.all() and dt > 0.0:
            velocity = (place - self._before) / dt
            fastest = velocity[np.argmax((velocity**2).sum(axis=1))]
            size = float(np.sqrt(fastest @ fastest))
            down = float(np.asarray(self._model.gravity_vector) @ fastest) >= 0.0
            if size > SLIP * self._speed and down:
                # It did not rest, it leaned, or its servos carry more than believed: go on down
                # with the support under which it began to move.
                self.share = self._support = max(self.share, LEAST_SUPPORT)
                self._ref = self._q.copy()
                self._enter("down")
                return self._ref + self._support * gravity / self._kp, self._limit(gravity)
            if size < 0.5 * self._speed or not down:
                self.share -= dt / RAMP
        else:
            self.share -= dt / RAMP
        self._before = place if good.all() else None
        return self._release(gravity)

    def _release(self, gravity: Array) -> tuple[Array, Array]:
        """Goals and limits that carry a share of the weight."""
        share = max(self.share, 0.0)
        if share <= 0.0:
            self.phase = "done"
        return self._q + share * gravity / self._kp, share * SUPPORT * np.abs(gravity)

    def _enter(self, phase: Phase) -> None:
        """Begin a phase with clean clocks."""
        self.phase, self._age, self._way, self._before = phase, 0.0, 0.0, None
        self._history.clear()

    def _gravity(self) -> Array:
        """Holding torques (n,) [N·m] at the last good positions."""
        return np.asarray(self._model.gravity(self._q), dtype=np.float64)

    def _leash(self, ref: Array, gravity: Array) -> Array:
        """Keep the reference where the servos can answer for it."""
        lift = np.maximum(self._usable - np.abs(gravity), 0.0) / self._kp
        share = DRAG if (self._silence > PATIENCE).any() else PRESS
        press = np.maximum(share * margin(self._servos, gravity), 2.0 * self._friction) / self._kp
        above = np.where(gravity > 0.0, lift, press)
        below = np.where(gravity > 0.0, press, lift)
        return self._q + np.clip(ref - self._q, -below, above)

    def _limit(self, gravity: Array) -> Array:
        """Torque limits (n,) [N·m] for the present reference."""
        wanted = np.abs(self._support * gravity + self._kp * (self._ref - self._q))
        limit = np.maximum(SUPPORT * np.abs(gravity), wanted) + margin(self._servos, gravity)
        return np.minimum(limit, self._usable)

    def _has_arrived(self, gravity: Array, outward: Flags, lost: Flags) -> bool:
        """At the rest pose; or hanging: no joint has more to carry than its friction."""
        if self.phase == "rest" and self._rest is not None:
            return bool((np.abs(self._rest - self._ref) < ARRIVED)[~lost].all())
        idle = outward | lost | (np.abs(gravity) < 1.5 * self._friction)
        return bool(idle.all())

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

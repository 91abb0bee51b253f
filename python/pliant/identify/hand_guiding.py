"""Hand guiding: the arm feels weightless and rests when released; k_p need not be exact.

The arm first swings a little. The mean of the leads that move it up and down is lead₀, which
carries it at gravity g₀; half their difference is its friction ρ. Both are in rad and independent
of k_p. Then the goals follow the arm with backlash-like play. Per joint:

    anchor = clip(anchor, q̂ − w, q̂ + w)                         moves only when dragged by its
    play goal   = anchor + lead₀ + c (g(q̂) − g₀) + b_f ρ tanh(v/v₀) + c_low b_d d v
    w      = w₀ (1 − 0.9 tanh |v|/v₀) + ½ (c_high − c_low) |g − g₀|

[c_low, c_high] is the interval of the compliance 1/k_p. The play w grows by the possible error of
the lead, so a wrong k_p can let the arm sag within the play but cannot make it drift. Whenever the
arm rests after a motion, its lead is right within ρ; that narrows the interval and the play.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pliant._core import ConfigError, Model, Payload, Servos
from pliant._validation import format_value, instance, number, vector
from pliant.identify._excitation import Excitation
from pliant.identify._segments import find_segments, first_moments, payload_rows
from pliant.identify.procedure import ServoCommand
from pliant.identify.servos import widen_swing

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from pliant.identify._segments import Segment
    from pliant.identify.procedure import Steps

    Array = NDArray[np.float64]

#: Factor by which a stiffness may be wrong in either direction: if known, and if not.
KNOWN, UNKNOWN = 1.1, 2.2
#: Fed-forward shares of friction and damping, and share of the delay for prediction.
FRICTION, DAMPING, PREDICTION = 0.8, 0.8, 0.9
#: Speed at which the friction feed-forward saturates [rad/s], and time constant of the speed [s].
SLOW, FILTER = 0.05, 0.02
#: Share of its play that a moving joint loses.
MOVING = 0.9
#: Time without motion beyond a count until the arm counts as at rest [s]; least motion [rad].
REST, MOTION = 0.4, 5e-4
#: Period of the first swing [s], and number of swings.
SWING, TURNS = 2.6, 1.75
#: Error of the lead from the swing, as a share of the friction that it averages out.
AVERAGED = 0.15
#: Motion time in which the play shrinks to its value learnt at rest [s].
SHRINK = 0.5
#: Least play at rest: in rad, in encoder counts, and as a share of the friction ρ.
MIN_PLAY, COUNTS, FRICTION_SHARE = 2e-3, 1.5, 0.15
#: Largest speed of the goals [rad/s].
SLEW = 3.0


class HandGuiding:
    """Makes an arm weightless for hand guiding; call `step` once per tick.

    Args:
        model: The arm.
        servos: Assumed servo table; None for the model's. With `stiffness_known=True` k_p is
            assumed right within 10 %, else within a factor of 2.
        rate: Control rate [Hz] if `step` gets no `dt`.
        delay: Time from the reading to the arrival of the goal [s].
        payload: Payload in addition to the model's: a `pliant.Payload` or (mass, com).
        swing: Size of the first swing [rad], without the part that friction takes.
        torque_share: Torque allowed on top of gravity, as a share of the usable torque. A hand must
            overcome this torque if the arm resists.

    Attributes:
        ready: True once the first swing is over; do not touch the arm before.
        play: Play of each joint in this tick (n,) [rad].

    Raises:
        ConfigError: There is no servo table, or `payload` is invalid.
        OutOfRangeError: A number is out of range. TypeError: `model` or `servos` is of the wrong
            type.

    Example:
        >>> guiding = pliant.HandGuiding(arm.model, arm.servos)
        >>> for tick in pliant.Loop(arm, guiding, rate=100.0):
        ...     tick.step()
    """

    def __init__(
        self,
        model: Model,
        servos: Servos | None = None,
        *,
        rate: float = 100.0,
        delay: float = 0.0,
        payload: Payload | tuple[float, ArrayLike] | None = None,
        swing: float = 0.04,
        torque_share: float = 0.3,
    ) -> None:
        known = instance(model, Model, "model").servos
        table = known if servos is None else instance(servos, Servos, "servos")
        if table is None:
            raise ConfigError("HandGuiding needs a servo table: pass servos=pliant.Servos(…)")
        rate, delay = (
            number(rate, "rate", 10.0, 1000.0, "Hz"),
            number(delay, "delay", 0.0, 0.5, "s"),
        )
        swing = number(swing, "swing", 0.01, 0.3, "rad")
        torque_share = number(torque_share, "torque_share", 0.05, 1.0)
        n = self._n = model.n
        self._model, self._period, self._delay, self._share = model, 1.0 / rate, delay, torque_share
        self._dt = self._period
        self._table, self._swing = table, swing
        self._rig = Excitation(
            model,
            table,
            self._dt,
            stiffness_uncertainty=KNOWN if table.stiffness_known else UNKNOWN,
        )
        self._torque, self._count = self._rig.torque, self._rig.count
        self._damping = self._rig.damping + self._rig.kv + self._rig.back_emf
        self._stiffness_factor = KNOWN if table.stiffness_known else UNKNOWN
        self._moments = np.zeros(4)
        if payload is not None:
            load = as_payload(payload)
            self._moments = first_moments(load.mass, load.com)
        self._total_moments = self._moments.copy()
        if model.payload is not None:
            self._total_moments += first_moments(model.payload.mass, model.payload.com)
        self._first_swing: Steps[Array] | None = None
        self.ready = False
        self.play = np.full(n, MIN_PLAY)

    @property
    def stiffness(self) -> Array:
        """Interval of k_p after all rests so far (2, n) [N·m/rad]."""
        if not self.ready:
            return np.array(
                [self._rig.kp / self._stiffness_factor, self._rig.kp * self._stiffness_factor]
            )
        return np.array([1.0 / self._high, 1.0 / self._low])

    def reset(self, q: ArrayLike) -> None:
        """Restart at q (n,) [rad] with a swing; all learnt values are cleared."""
        q = self._positions(q)
        # The first tick may be early or late, with a period that the rig would reject.
        period = min(max(self._dt, 1e-3), 0.1)
        self._rig = Excitation(
            self._model, self._table, period, stiffness_uncertainty=self._stiffness_factor
        )
        self._rig.extra_torque = payload_rows(self._model, q) @ self._moments
        self._first_swing, self.ready = self._swing_procedure(q), False
        self._command = next(self._first_swing)

    def step(self, q: ArrayLike, *, dt: float | None = None) -> ServoCommand:
        """Return goals and torque limits for measured positions q (n,) [rad].

        The first call resets to q. The swing keeps the `dt` of its first tick.

        Args:
            q: Measured positions (n,) [rad].
            dt: Time since the last step [s], at most 1; None: 1/rate.

        Raises:
            ShapeError: q is not n finite positions; nothing has changed.
            OutOfRangeError: `dt` is out of range, or the first swing would leave the position
                limits.
            ServoError: A joint does not follow the first swing.
        """
        q = self._positions(q)
        self._dt = self._period if dt is None else number(dt, "dt", 1e-6, 1.0, "s")
        if self._first_swing is None:
            self.reset(q)
        elif self.ready:
            self._command = self._follow(q)
        else:
            try:
                self._command = self._first_swing.send(q)
            except StopIteration:
                self._finish_swing(q)
        return self._command

    def _swing_procedure(self, q: Array) -> Steps[Array]:
        """Swing slowly, return to the start, and rest."""
        rig, home = self._rig, q
        _, q = yield from widen_swing(rig, q, self._swing)
        for _ in range(round(REST / rig.period)):
            q = yield from rig.send(
                q, home + rig.gravity_lead(home), rig.limits(home), np.zeros(self._n)
            )
        return q

    def _finish_swing(self, q: Array) -> None:
        """Compute the carrying lead, the friction, and the interval of 1/k_p from the swing."""
        rig, n = self._rig, self._n
        self._low, self._high = (
            1.0 / (self._stiffness_factor * rig.kp),
            self._stiffness_factor / rig.kp,
        )
        middle = 0.5 * (self._low + self._high)
        base = self._holding(q)
        rows = [segment for record in rig.records for segment in find_segments(rig, record)]
        # A joint that did not swing uses the table, with its full uncertainty: g_0 = lead_0 = 0.
        self._lead, self._rub = np.zeros(n), rig.friction * middle
        swung = np.zeros(n, dtype=bool)
        for i in range(n):
            sides = [
                [s for s in rows if s.joint == i and s.direction == side] for side in (1.0, -1.0)
            ]
            if not all(sides):
                continue
            up, down = (
                np.mean([s.drive - middle[i] * (self._load(s) - base[i]) for s in side])
                for side in sides
            )
            speed = np.mean([abs(s.speed) for side in sides for s in side])
            self._lead[i], half = 0.5 * (up + down), 0.5 * (up - down)
            swung[i] = True
            self._rub[i] = max(half - middle[i] * self._damping[i] * speed, 0.3 * half, 0.0)
        error = AVERAGED * self._rub + 0.5 * self._count + MOTION
        load = np.where(swung & (np.abs(base) > 0.0), base, np.nan)
        self._narrow((self._lead - error) / load, (self._lead + error) / load)
        self._gravity = np.where(swung, base, 0.0)
        self._min_play = np.maximum(
            np.maximum(MIN_PLAY, COUNTS * self._count), FRICTION_SHARE * self._rub
        )
        self._goal, self._filtered_q, self._speed = self._command.goal.copy(), q.copy(), np.zeros(n)
        carried = self._lead + 0.5 * (self._low + self._high) * (base - self._gravity)
        # A joint that swung rests in the middle of its friction band; another keeps its goal.
        self._anchor = np.where(swung, q, self._goal - carried)
        self._excess = np.maximum(np.abs(self._anchor - q) - self._min_play, 0.0)
        self._rest_at, self._learnt, self._still, self._moved = q, q, 0.0, False
        self.ready = True

    def _follow(self, q: Array) -> ServoCommand:
        """Return goals that follow the arm."""
        self._estimate(q)
        ahead = q + PREDICTION * self._delay * self._speed
        gravity = self._holding(ahead)
        self._narrow_at_rest(q)
        change = gravity - self._gravity
        lead = self._lead + 0.5 * (self._low + self._high) * change
        uncertainty = 0.5 * (self._high - self._low) * np.abs(change)
        pace = np.tanh(self._speed / SLOW)
        # No goal moves at rest; a correction learnt at rest takes effect with the motion.
        self._excess = self._excess * (1.0 - np.abs(pace) * min(self._dt / SHRINK, 1.0))
        self.play = self._min_play * (1.0 - MOVING * np.abs(pace)) + uncertainty + self._excess
        self._anchor = np.clip(self._anchor, ahead - self.play, ahead + self.play)
        helping = FRICTION * self._rub * pace + DAMPING * self._low * self._damping * self._speed
        goal = self._anchor + lead + helping
        goal = np.clip(goal, self._model.lower + lead, self._model.upper + lead)
        max_change = SLEW * self._dt
        self._goal = self._goal + np.clip(goal - self._goal, -max_change, max_change)
        needed = np.maximum(1.1 * np.abs(gravity), self._rig.kp * np.abs(lead))
        limit = np.minimum(self._torque, needed + self._share * self._torque)
        return ServoCommand(self._goal.copy(), limit)

    def _narrow_at_rest(self, q: Array) -> None:
        """At rest after a motion, narrow the interval of 1/k_p; the goal does not move."""
        if (np.abs(q - self._rest_at) > np.maximum(1.1 * self._count, MOTION)).any():
            self._moved |= bool((np.abs(q - self._learnt) > 3.0 * self._min_play).any())
            self._rest_at, self._still = q, 0.0
            return
        self._still += self._dt
        if self._still < REST or not self._moved:
            return
        self._moved, self._learnt = False, q
        change = self._holding(q) - self._gravity
        before, uncertainty = (
            self._low + self._high,
            0.5 * (self._high - self._low) * np.abs(change),
        )
        lead, band = self._goal - q, self._rub + self._min_play
        moved = np.where(np.abs(change) > 0.0, change, np.nan)
        self._narrow((lead - self._lead - band) / moved, (lead - self._lead + band) / moved)
        # The anchor compensates the change of the lead, so that the goal stays.
        self._anchor += 0.5 * (before - self._low - self._high) * change
        self._excess = np.maximum(self._excess, uncertainty)

    def _narrow(self, one: Array, other: Array) -> None:
        """Intersect the interval of 1/k_p with these ends (n,), NaN for none.

        If the intersection is empty (a hand leans on the arm, a payload), the interval stays.
        """
        low = np.maximum(self._low, np.fmin(one, other))
        high = np.minimum(self._high, np.fmax(one, other))
        is_valid = low < high
        self._low, self._high = (
            np.where(is_valid, low, self._low),
            np.where(is_valid, high, self._high),
        )

    def _load(self, segment: Segment) -> float:
        """Return the torque that holds the arm in a segment with the given payload [N·m]."""
        return segment.gravity + float(segment.payload @ self._total_moments)

    def _estimate(self, q: Array) -> None:
        """Update the filtered speed, from readings with a hysteresis of one count."""
        filtered = np.clip(self._filtered_q, q - self._count, q + self._count)
        rate = (filtered - self._filtered_q) / self._dt
        self._speed = self._speed + (rate - self._speed) * self._dt / (FILTER + self._dt)
        self._filtered_q = filtered

    def _holding(self, q: Array) -> Array:
        """Return the torques that hold the arm with its payload (n,) [N·m]."""
        gravity = np.asarray(self._model.gravity(q))
        if self._moments[0] > 0.0:
            gravity = gravity + payload_rows(self._model, q) @ self._moments
        return gravity

    def _positions(self, q: ArrayLike) -> Array:
        return vector(q, self._n, "q", "rad")


def as_payload(value: Payload | tuple[float, ArrayLike]) -> Payload:
    """Convert a payload, or its mass [kg] and centre (3,) [m] in the tool frame, to a `Payload`.

    Raises:
        ConfigError: The value is neither.
    """
    if isinstance(value, Payload):
        return value
    if not isinstance(value, tuple | list) or len(value) != 2:
        raise ConfigError(
            "payload must be a Payload, or mass [kg] and centre [m] as in (0.3, (0, 0, 0.05)), "
            f"got {format_value(value)}"
        )
    return Payload(*value)

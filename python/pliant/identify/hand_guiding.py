"""Hand guiding: the arm feels weightless and rests when released; k_p need not be exact.

k_p [N·m/rad] is the stiffness of the servos. The arm first moves each joint a little up and down.
The lead (goal minus position, [rad]) differs between the two directions: its mean lead₀ holds the
joint against the gravity torque g₀ [N·m], and half the difference is the friction ρ [rad]. Both are
measured, without the assumed k_p. Then the goals follow the arm with a play w [rad], like a drive
with backlash. For each joint with predicted position q̂ and filtered speed v:

    anchor = clip(anchor, q̂ − w, q̂ + w)
    goal   = anchor + lead₀ + c (g(q̂) − g₀) + b_f ρ tanh(v/v₀) + c_low b_d d v
    w      = w₀ (1 − 0.9 tanh |v|/v₀) + ½ (c_high − c_low) |g − g₀|

with gravity torque g, viscous damping d [N·m·s/rad], the shares b_f, b_d = 0.8 of friction and
damping that are fed forward, v₀ = 0.05 rad/s, and the least play w₀ of the joint (at least 2 mrad).
[c_low, c_high] is the interval of possible compliances 1/k_p [rad/(N·m)], and c its middle. The
play covers the possible error of the lead: with a wrong k_p the arm can sag within the play, but
not drift. When the arm rests after a motion, the error of its lead is at most ρ + w₀; this
narrows the interval, and with it the play.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pliant._core import (
    Command,
    ConfigError,
    HandGuidingLaw,
    Model,
    Payload,
    ServoError,
    Servos,
)
from pliant._validation import format_value, instance, number, vector
from pliant.identify._excitation import Excitation
from pliant.identify._segments import all_segments, first_moments, payload_rows
from pliant.identify.servos import widen_swing

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from pliant._typing import Array, Mask
    from pliant.identify._segments import Segment
    from pliant.identify.procedure import Steps


#: Factor by which the assumed stiffness may be wrong in either direction [1], with
#: `stiffness_known` True and False.
KNOWN_STIFFNESS_FACTOR, UNKNOWN_STIFFNESS_FACTOR = 1.1, 2.2
#: Bounds of the ratio of measured to assumed stiffness in `HandGuiding.capture_gravity` [1].
CAPTURE_RANGE = (0.3, 3.0)
#: Gravity torque above which `HandGuiding.capture_gravity` measures the stiffness of a joint, in
#: units of its friction.
MIN_CAPTURE_LOAD = 3.0
#: Mean lead of a joint above which its weight must explain the lead, in units of its friction.
MIN_LEAD = 3.0
#: Amplitude of the joints in the initial oscillation [rad].
SWING = 0.04
#: Torque with which a joint can resist a hand, as a share of the maximum torque [1].
TORQUE_SHARE = 0.3
#: Time for which the arm rests after the initial oscillation [s].
REST_TIME = 0.4
#: Value of `HandGuiding.play`, the backlash between arm and goal, until `ready` is True [rad].
INITIAL_PLAY = 2e-3


class HandGuiding:
    """Makes an arm weightless for hand guiding; call `step` once per tick.

    Args:
        model: The arm.
        servos: Assumed servo parameters; None: those of the model. The true stiffness may differ by
            10 % with `stiffness_known=True`, else by a factor of 2.2.
        rate: Control rate [Hz] if `step` gets no `dt`.
        delay: Time from reading the positions to the arrival of the goal at the servos [s].
        payload: Payload in addition to the payload of the model: a `pliant.Payload`, or mass [kg]
            and centre of mass (3,) [m].

    Raises:
        ConfigError: There are no servo parameters, or `payload` is invalid.
        OutOfRangeError: A number is out of range.
        TypeError: `model` or `servos` has the wrong type.

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
    ) -> None:
        known = instance(model, Model, "model").servos
        table = known if servos is None else instance(servos, Servos, "servos")
        if table is None:
            raise ConfigError("HandGuiding needs a servo table: pass servos=pliant.Servos(…)")
        rate, delay = (
            number(rate, "rate", 10.0, 1000.0, "Hz"),
            number(delay, "delay", 0.0, 0.5, "s"),
        )
        self._n = model.n
        self._model, self._period, self._delay = model, 1.0 / rate, delay
        self._dt = self._period
        self._table = table
        self._stiffness_factor = (
            KNOWN_STIFFNESS_FACTOR if table.stiffness_known else UNKNOWN_STIFFNESS_FACTOR
        )
        self._rig = self._excitation(self._dt)
        self._damping = self._rig.damping + self._rig.kv + self._rig.back_emf
        own = np.zeros(4)
        if model.payload is not None:
            own = first_moments(model.payload.mass, model.payload.com)
        self._own_moments, self._payload = own, model.payload
        self._set_moments(own)
        if payload is not None:
            load = as_payload(payload)
            total = own + first_moments(load.mass, load.com)
            self.set_payload(total[0], total[1:] / max(total[0], 1e-9))
        #: Torque that holds the arm: `ratio` times the gravity torque plus `offset`, (2, n).
        self._captured = np.array([np.ones(self._n), np.zeros(self._n)])
        self._first_swing: Steps[Array] | None = None
        self._law: HandGuidingLaw | None = None

    @property
    def ready(self) -> bool:
        """True once the initial oscillation is over; do not touch the arm before."""
        return self._law is not None

    @property
    def play(self) -> Array:
        """Backlash w (n,) [rad] between joints and goals, as in the module's docstring."""
        return np.full(self._n, INITIAL_PLAY) if self._law is None else self._law.play

    @property
    def payload(self) -> Payload | None:
        """Payload, with that of the model; None: none."""
        return self._payload

    def set_payload(self, mass: float, com: ArrayLike = (0.0, 0.0, 0.0)) -> None:
        """Set the payload, with that of the model, from the next `reset` on.

        `pliant.Loop` calls it with the load that was measured when torque was switched on, unless
        the payload differs from that of the model.

        Args:
            mass: Mass [kg], at least that of the model's payload; 0 for none.
            com: Centre of mass (3,) in the tool frame [m].

        Raises:
            OutOfRangeError, ShapeError, ConfigError: An argument is invalid; nothing has changed.
        """
        payload = Payload(mass, com)
        number(payload.mass, "mass", float(self._own_moments[0]), 1e6, "kg")
        self._payload = payload
        self._set_moments(first_moments(payload.mass, payload.com))

    def _set_moments(self, total: Array) -> None:
        self._total_moments, self._moments = total, total - self._own_moments

    @property
    def stiffness(self) -> Array:
        """Lower and upper bounds of the servo stiffness, as known so far (2, n) [N·m/rad]."""
        if self._law is not None:
            return self._law.stiffness
        factor = self._stiffness_factor
        return np.array([self._rig.kp / factor, self._rig.kp * factor])

    def reset(self, q: ArrayLike) -> None:
        """Restart at positions q (n,) [rad] with the initial oscillation; all results are lost."""
        q = self._positions(q)
        # Clip the period: a very early or late first tick gives one that `Excitation` rejects.
        period = min(max(self._dt, 1e-3), 0.1)
        self._rig = self._excitation(period)
        ratio, offset = self._captured
        held = ratio * self._holding_torque(q) + offset
        self._rig.extra_torque = held - np.asarray(self._model.gravity(q))
        self._first_swing, self._law = self._swing_procedure(q), None
        self._command = next(self._first_swing)

    def capture_gravity(self, q: ArrayLike, goal: ArrayLike) -> Array:
        """Measure how the arm is held, while goals hold it still, for the initial oscillation.

        With a wrong k_p or an unknown load the arm would otherwise sink or rise as it begins. Takes
        effect with the next `reset`. `pliant.Loop` calls it with what the arm measured when torque
        was switched on, unless the stiffness of the servos is known.

        Args:
            q: Joint positions (n,) [rad].
            goal: Goals that hold the arm there (n,) [rad].

        Returns:
            Stiffness of the joints (n,) [N·m/rad] at which gravity alone explains the goals. A
            joint whose gravity torque is small keeps the assumed one.

        Raises:
            ShapeError: `q` or `goal` is not n finite numbers; nothing has changed.
        """
        q, goal = self._positions(q), vector(goal, self._n, "goal", "rad")
        kp, needed = self._rig.kp, self._holding_torque(q)
        held = kp * (goal - q)
        resolution = np.maximum(self._rig.friction, kp * self._rig.count)
        is_loaded = np.abs(needed) > MIN_CAPTURE_LOAD * resolution
        ratio = np.ones(self._n)
        low, high = CAPTURE_RANGE
        ratio[is_loaded] = np.clip(held[is_loaded] / needed[is_loaded], 1.0 / high, 1.0 / low)
        self._captured = np.array([ratio, held - ratio * needed])
        return kp / ratio

    def step(self, q: ArrayLike, *, dt: float | None = None) -> Command:
        """Return goals and torque limits for measured positions q (n,) [rad].

        The first call starts the initial oscillation, with its `dt` as control period.

        Args:
            q: Measured positions (n,) [rad].
            dt: Time since the last step [s], at most 1; None: 1/rate.

        Raises:
            ShapeError: q is not n finite numbers; nothing has changed.
            OutOfRangeError: `dt` is out of range, or the initial oscillation would leave the
                position limits.
            ServoError: A joint does not follow the initial oscillation, or neither its weight nor a
                wrong k_p explains the goals that hold it.
        """
        q = self._positions(q)
        self._dt = self._period if dt is None else number(dt, "dt", 1e-6, 1.0, "s")
        if self._first_swing is None:
            self.reset(q)
        elif self._law is not None:
            self._command = self._law.step(q, dt=self._dt)
        else:
            try:
                self._command = self._first_swing.send(q)
            except StopIteration:
                self._finish_swing(q)
        return self._command

    def _excitation(self, period: float) -> Excitation:
        factor = self._stiffness_factor
        return Excitation(
            self._model, self._table, period, stiffness_uncertainty=factor, opposing=True
        )

    def _swing_procedure(self, q: Array) -> Steps[Array]:
        """Oscillate all joints slowly, return to the start and rest; return the last positions."""
        rig, home = self._rig, q
        _, q = yield from widen_swing(rig, q, SWING)
        for _ in range(round(REST_TIME / rig.period)):
            q = yield from rig.send(
                q, home + rig.gravity_lead(home), rig.limits(home), np.zeros(self._n)
            )
        return q

    def _finish_swing(self, q: Array) -> None:
        """Compute the holding lead and the friction of each joint [rad]; start the control law."""
        rig, n = self._rig, self._n
        factor = self._stiffness_factor
        middle = 0.5 * (1.0 / (factor * rig.kp) + factor / rig.kp)
        base = self._holding_torque(q)
        rows = all_segments(rig)
        # Joints that did not move steadily get the friction of the servo parameters, as a lead at
        # the largest stiffness: feed-forward above their true friction would make them oscillate.
        lead, friction = np.zeros(n), rig.friction / (factor * rig.kp)
        swung = np.zeros(n, dtype=bool)
        for i in range(n):
            sides = [
                [s for s in rows if s.joint == i and s.direction == side] for side in (1.0, -1.0)
            ]
            if not all(sides):
                continue
            up, down = (
                np.mean([s.drive - middle[i] * (self._segment_load(s) - base[i]) for s in side])
                for side in sides
            )
            speed = np.mean([abs(s.speed) for side in sides for s in side])
            lead[i], half = 0.5 * (up + down), 0.5 * (up - down)
            swung[i] = True
            friction[i] = max(half - middle[i] * self._damping[i] * speed, 0.3 * half, 0.0)
        self._check_leads(lead, friction, base, swung)
        self._law = HandGuidingLaw(
            self._model,
            self._table,
            q=q,
            goal=self._command.goal,
            swung=swung.tolist(),
            lead=lead,
            friction=friction,
            damping=self._damping,
            stiffness_error=factor,
            delay=self._delay,
            torque_share=TORQUE_SHARE,
            payload_moments=self._moments.tolist(),
        )

    def _check_leads(self, lead: Array, friction: Array, holding: Array, swung: Mask) -> None:
        """Raise `ServoError` if a joint needs a lead that neither its load nor k_p explains.

        Args:
            lead: Measured leads (n,) [rad].
            friction: Measured friction, as leads (n,) [rad].
            holding: Torques that hold the arm according to model and payload (n,) [N·m].
            swung: Joints whose lead was measured (n,).
        """
        factor = self._stiffness_factor
        ends = [holding / (share * self._rig.kp) for share in (1.0 / factor, factor)]
        low, high = np.min(ends, axis=0), np.max(ends, axis=0)
        # The play of a joint at rest covers a smaller excess.
        excess = np.maximum(low - lead, lead - high) - friction - self._rig.count - INITIAL_PLAY
        is_wrong = swung & (excess > 0.0) & (np.abs(lead) > MIN_LEAD * friction)
        for i in np.flatnonzero(is_wrong):
            raise ServoError(
                f"goal and position of joint {self._model.joint_names[i]} differ by "
                f"{lead[i]:.3f} rad at rest, where its weight explains {low[i]:.3f} to "
                f"{high[i]:.3f} rad: is there a load that the model lacks? State it (payload=, or "
                "robot.payload in the arm's file) or take it off; otherwise k_p or zero are wrong: "
                "identify_servos measures k_p"
            )

    def _segment_load(self, segment: Segment) -> float:
        """Return the gravity torque of a segment's joint, with all payloads [N·m]."""
        return segment.gravity + float(segment.payload @ self._total_moments)

    def _holding_torque(self, q: Array) -> Array:
        """Return the torques that hold the arm at q, with all payloads (n,) [N·m]."""
        gravity = np.asarray(self._model.gravity(q))
        if self._moments.any():
            gravity = gravity + payload_rows(self._model, q) @ self._moments
        return gravity

    def _positions(self, q: ArrayLike) -> Array:
        return vector(q, self._n, "q", "rad")


def as_payload(value: Payload | tuple[float, ArrayLike]) -> Payload:
    """Return a `Payload` unchanged, or create it from mass [kg] and centre [m] in the tool frame.

    Raises:
        ConfigError: The value is neither a `Payload` nor a pair (mass, centre).
    """
    if isinstance(value, Payload):
        return value
    if not isinstance(value, tuple | list) or len(value) != 2:
        raise ConfigError(
            "payload must be a Payload, or mass [kg] and centre [m] as in (0.3, (0, 0, 0.05)), "
            f"got {format_value(value)}"
        )
    return Payload(*value)

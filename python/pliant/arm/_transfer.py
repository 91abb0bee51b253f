"""Transfer of the weight of a standing arm to its servos while torque comes on.

The lead of a joint is goal minus position [rad]; a servo turns it into torque. In the balance, the
first phase, torque limits bring the falling arm to rest. In the second phase, the leads shrink.
"""

from __future__ import annotations

import math
from collections import deque
from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np

from pliant._core import SUPPORT, ServoError, ServoFaultError, ServoTimeoutError, torque_margin
from pliant.arm._io import RAMP_TIME
from pliant.arm._startup import CLEAR_WEIGHT, LEAD_FACTOR, full_lead, unit_load

if TYPE_CHECKING:
    from pliant._core import ArmPoints
    from pliant._typing import Array, Mask
    from pliant.arm._io import ArmIO


#: Minimum loop rate of the transfer [Hz].
LOOP_RATE = 250.0
#: The balance begins once the tool has sunk by `SINK` or risen by `RISE` [m], each plus half an
#: encoder step of the joint that moves the tool most.
SINK, RISE = 0.0003, 0.005
#: First value and bounds of the estimated load at the tool [kg], and time constants of this
#: estimate as it increases and decreases [s].
FIRST_LOAD, LEAST_LOAD, LARGEST_LOAD, LOAD_TIME, UNLOAD_TIME = 0.1, 0.02, 0.5, 0.02, 0.15
#: Lower bound of the norm of the joint torques that hold 1 kg at the tool, in the estimate of the
#: load [N·m].
MIN_WEIGHT = 0.1
#: Shortest trial of the leads of a known stiffness [s]. They do not hold the arm if a joint rises
#: by `TRIAL_RISE` or sinks by `TRIAL_SINK` [rad], or by `TRIAL_STEPS` encoder steps or
#: `TRIAL_SHARE` of its lead if these are larger.
TRIAL_TIME, TRIAL_RISE, TRIAL_SINK, TRIAL_STEPS, TRIAL_SHARE = 0.15, 0.004, 0.008, 2.5, 0.1
#: Share of the disturbance that is then ascribed to the weight, not to the stiffness.
WEIGHT_SHARE = 0.5
#: The observer pole is `POLE_DELAY` over the delay of the loop, at most `MAX_POLE` [1/s].
POLE_DELAY, MAX_POLE = 1.0, 45.0
#: Assumed ratio of disturbance to position error before the first reading [1/s²]. A larger ratio
#: finds an unknown load earlier, but takes an encoder step of a joint at rest for a fall.
FIRST_DISTURBANCE = 3e3
#: Weight of the last period in the mean loop period, and longest period that is averaged [s].
PERIOD_SHARE, MAX_PERIOD = 0.2, 0.1
#: Time constant with which the largest sum of period and delay decays [s]. The observer's poles
#: depend on it, because poles for a mean period are unstable if some periods are much longer.
FORGET_TIME = 0.5
#: Bounds on the torque of the balance beyond the weight: largest load at the tool [kg], share of
#: the weight, and ratio to friction. They keep a period that lasts too long from throwing the arm.
BOUND_LOAD, BOUND_SHARE, BOUND_FRICTION = 0.6, 0.6, 2.0
#: Ratio of the poles of the position control to that of the observer.
CONTROL_SHARE = 0.4
#: The balance takes `MIN_BALANCE` to `MAX_BALANCE` [s]. It ends once all joints were slower than
#: `STILL_SPEED` [rad/s] and within `STILL_AWAY` [rad] of the start for `STILL_TIME` [s].
MIN_BALANCE, MAX_BALANCE, STILL_SPEED, STILL_AWAY, STILL_TIME = 0.2, 1.5, 0.02, 0.01, 0.1
#: Time constant of the mean torque of the balance [s]. Below `LIGHT` times friction, the sign of
#: this torque is unknown.
TORQUE_TIME, LIGHT = 0.1, 2.0
#: Time constant [s] and largest speed [rad/s] of shrinking leads; a smaller lead than `MIN_LEAD`
#: counts as zero [rad].
SHRINK_TIME, SHRINK_SPEED, MIN_LEAD = 0.4, 0.15, 0.002
#: Smallest change of a position that is not rounding [rad], and largest encoder step that is
#: estimated from such changes [rad].
MIN_CHANGE, MAX_COUNT = 1e-6, 0.006
#: Displacement above which a joint counts as sinking [rad]; two encoder steps if these are larger.
SINKING = 0.002
#: The lead of a joint counts as found if the joint sinks at a torque of
#: ``(1 + FOUND_SHARE) τ + FOUND_FRICTION f`` or more, with the torque τ of the balance and the
#: friction f, or at `USABLE_SHARE` of the usable torque if that is less.
FOUND_FRICTION, FOUND_SHARE, USABLE_SHARE = 2.5, 0.1, 0.98
#: Longest time for which the lead of a sinking joint stays constant until this torque is reached
#: [s], and the speed at which the lead shrinks afterwards [rad/s].
MAX_WAIT, SLOW_SHRINK_SPEED = 0.3, 0.02
#: Largest increase of a lead when it is found, to its value before the joint began to sink [rad].
MAX_BACK = 0.005
#: Time in which the torque limit of a joint that continues to sink rises from zero to the maximum
#: of the servo [s].
LIMIT_RISE = 0.1
#: Time in which limits of joints that had torque rise to their holding torque [s]; displaced joints
#: return only afterwards.
SETTLE_TIME = 0.2
#: Return of a joint to its first position: gain [1/s] and largest speed [rad/s] of its goal. The
#: goal waits while the joint is faster than `RETURNING` [rad/s].
RETURN_GAIN, RETURN_SPEED, RETURNING = 8.0, 0.1, 0.03
#: Time constant of the mean position, which also limits the return of a joint [s]: a return by the
#: present position alone would increase the oscillation of an arm on its servos.
MEAN_TIME = 0.3
#: Share of friction by which the torque of a lead that still raises its joint is reduced at last.
RAISED_SHARE = 0.5
#: A joint has returned within `RETURNED` [rad] (at least 0.6 encoder steps) of its first position.
#: Leads stop shrinking after `MAX_TIME` [s]; joints may return for another `RETURN_TIME` [s].
RETURNED, MAX_TIME, RETURN_TIME = 1.5e-4, 5.0, 1.0
#: Time without a position of a joint after which the arm gets goals and limits that hold it at
#: rest, and time after which the weight transfer ends with an error [s].
STALE, MAX_SILENCE = 0.03, 0.5
#: Time without a position after which a servo may get its limit only while others answer [s]: a
#: drive withholds the goals from a servo that may have restarted, see `Port.write`.
NO_GOALS = 0.08
#: Assumed time constant with which these goals brake the joints [s].
BRAKE_TIME = 0.03
#: Motion of a joint against a clear weight with which the transfer ends [rad].
AGAINST_WEIGHT = 0.15


def transfer_weight(
    io: ArmIO, points: ArmPoints, start_q: Array, taken: Mask, rate: float
) -> Array:
    """Transfer the weight of a standing arm to its servos, and find the leads that hold it.

    If the stiffness of the servos is known, the leads that it gives are tried first. If they do not
    hold the arm, the stiffness is not known, and `io.servos` says so from then on. Torque limits
    then balance the arm, also with an unknown load, whose mass is `io.load` from then on, and the
    leads are measured, see `_WeightTransfer`.

    Args:
        io: Read and write access to the arm, with torque on.
        points: Points of the arm, with the inertia of its rotors.
        start_q: Joint positions before torque on (n,) [rad].
        taken: Mask (n,) of joints whose present goals and limits already hold them.
        rate: Rate of the arm's own loops [Hz]; the transfer uses at least `LOOP_RATE`.

    Returns:
        Leads that hold the joints (n,) [rad]; NaN for joints that rest on an object.

    Raises:
        ServoTimeoutError: A joint was silent for 0.5 s; meanwhile the arm got goals and limits that
            hold it at rest.
        ServoError: A joint has moved against its weight, as with a wrong sign; the arm is held
            where it is, with all torque.
    """
    return _WeightTransfer(io, points, start_q, taken, rate).run()


class _DisturbanceObserver:
    """Motion of the joints, and the acceleration that the model does not explain.

    The model of each joint is ``ẍ = u + d`` with a known input u [rad/s²] and an unknown constant
    d. The estimate is for the time of the last reading; `predict` extrapolates it. The gains are
    those of the critically damped filter of third order (Brookner 1998, 2.4), or those of least
    squares over all readings since the start at rest with d unknown, whichever are larger.

    Attributes:
        x, v, d: Displacement (n,) [rad], speed (n,) [rad/s] and disturbance (n,) [rad/s²].
        step: Encoder steps (n,) [rad].
    """

    def __init__(self, time: float, step: Array) -> None:
        """Start at rest at `time` [s]; `step` are the encoder steps (n,) [rad]."""
        self.x, self.v, self.d = np.zeros(step.size), np.zeros(step.size), np.zeros(step.size)
        self._time, self.step = time, step
        self._begin, self._squares = time, 0.0
        self._inputs: deque[tuple[float, Array]] = deque([(time, np.zeros(step.size))])

    def send(self, time: float, u: Array) -> None:
        """Store the input u (n,) [rad/s²] that is sent at `time` [s]."""
        self._inputs.append((time, u))

    def update(self, time: float, x: Array, pole: float) -> None:
        """Correct the estimate by displacements x (n,) [rad] measured at `time` [s].

        `pole` is the pole of the estimation error [1/s].
        """
        dt = time - self._time
        if dt <= 0.0:
            return
        self.x, self.v = self.predict(time)
        self._time = time
        while len(self._inputs) > 1 and self._inputs[1][0] <= time:
            self._inputs.popleft()
        # The quantized reading agrees with every position within half an encoder step.
        error = x - self.x
        error = error - np.clip(error, -0.5 * self.step, 0.5 * self.step)
        z = np.exp(-pole * dt)
        passed = time - self._begin
        path = 0.5 * passed**2  # displacement per disturbance
        self._squares += path**2
        first = path / (self._squares + FIRST_DISTURBANCE**-2)
        self.x = self.x + max(path * first, 1.0 - z**3) * error
        self.v = self.v + max(passed * first, 1.5 * (1.0 - z**2) * (1.0 - z) / dt) * error
        self.d = self.d + max(first, (1.0 - z) ** 3 / dt**2) * error

    def predict(self, time: float) -> tuple[Array, Array]:
        """Return displacement [rad] and speed [rad/s] (n,) extrapolated to `time` [s]."""
        x, v, at = self.x, self.v, self._time
        ends = [*(sent for sent, _ in self._inputs), time][1:]
        for (_, u), end in zip(self._inputs, ends, strict=True):
            if (dt := min(end, time) - at) > 0.0:
                x, v, at = x + dt * v + 0.5 * dt**2 * (u + self.d), v + dt * (u + self.d), at + dt
        return x, v


class _WeightTransfer:
    """Transfer of the weight of a standing arm to its servos, and measurement of the leads.

    The lead of a joint is goal minus position. With a large lead, a servo exerts its torque limit,
    whatever its stiffness. Torque limits and signs of the leads first follow

    ``τ = w - M (d + 2 ω v + ω² x)``

    with the model's weight w and inertia M, the displacement x from the first position, its speed v
    and the disturbance d of a `_DisturbanceObserver`. Until the tool moves, τ is w. When the arm
    stands still, τ holds it with its load. Then the leads shrink: a joint begins to sink at the
    lead that just holds it. A joint that does not sink rests on an object. Finally, limits get
    the margin of `torque_margin`, and joints that sank return slowly.
    """

    def __init__(
        self, io: ArmIO, points: ArmPoints, start_q: Array, taken: Mask, rate: float
    ) -> None:
        """Prepare the transfer; send nothing. The arguments are those of `transfer_weight`."""
        self._io, self._start, self._taken = io, start_q, taken
        io.load = 0.0
        self._rate = max(rate, LOOP_RATE)
        self._period = self._slowest = 1.0 / self._rate
        servos = io.servos
        self._kp, self._usable = np.asarray(servos.kp), np.asarray(servos.max_torque)
        self._friction = np.asarray(servos.friction)
        self._assumed_step = np.asarray(servos.encoder_step)
        self._least_change = np.full(start_q.size, np.inf)
        self._weight = io.gravity()
        self._tool = np.asarray(io.model.jacobian(start_q))[:3]
        self._bare_inertia = points.inertia(start_q)
        self._load_weight = unit_load(io.model, start_q)
        extra = BOUND_LOAD * self._load_weight
        beyond = BOUND_SHARE * np.abs(self._weight) + BOUND_FRICTION * self._friction
        self._bounds = (
            np.maximum(self._weight + np.minimum(extra, 0.0) - beyond, -self._usable),
            np.minimum(self._weight + np.maximum(extra, 0.0) + beyond, self._usable),
        )
        self._set_load(FIRST_LOAD)
        self._first = io.limit
        # Joints with torque on already hold positions and do not exert the torque of the balance.
        self._follows = ~taken
        self._heard = self._tick = io.clock.now()
        self._observer = _DisturbanceObserver(
            self._heard - io.delay(self._heard), self._assumed_step
        )
        self._x, self._v = np.zeros(start_q.size), np.zeros(start_q.size)
        # Time for which the leads of a known stiffness have held the joints [s].
        self._tried = 0.0
        # Leads that were found to hold the joints (n,) [rad]; NaN before.
        self._found = np.full(start_q.size, np.nan)

    def run(self) -> Array:
        """Run the transfer; return the leads as `transfer_weight` does."""
        try:
            return self._transfer()
        except _AgainstWeightError as error:
            # The weight of the model has the wrong sign there: no lead and all torque hold best.
            lead = np.where(error.joints, 0.0, self._weight / self._kp)
            with suppress(ServoError):
                self._io.send(self._io.q + lead, self._usable)
            raise ServoError(str(error)) from None
        except BaseException:
            # A descent follows, and starts from the goals last sent.
            with suppress(ServoError):
                self._hold()
            raise

    def _hold(self) -> None:
        """Send goals and limits that hold the joints near their last positions for a while.

        Without readings, the torque limits of the balance would accelerate the arm; a lead that is
        not larger than needed lets the stiffness of the servos hold it.
        """
        io, taken = self._io, self._taken
        torque = np.clip(self._weight - self._inertia @ self._observer.d, *self._bounds)
        lead = np.where(np.isfinite(self._found), self._found, torque / self._kp)
        limit = np.minimum(SUPPORT * np.abs(torque) + 2.0 * self._friction, self._usable)
        # A higher limit would lift a joint whose servo got no goal of this method: it still has the
        # large lead of the balance.
        now, times = io.clock.now(), io.positions.time[io.joints.chain]
        is_silent = (now - times > NO_GOALS) & (times.max() - times > STALE)
        kept = np.minimum(limit, np.maximum(io.limit, np.abs(torque)))
        limit = np.where(is_silent, kept, limit)
        io.send(np.where(taken, io.goal, io.q + lead), np.where(taken, io.limit, limit))
        # Pass the braking to the observer, which would otherwise assume the torques of the balance.
        now = io.clock.now()
        _, v = self._observer.predict(now)
        self._observer.send(now, -self._observer.d - np.where(self._follows, v / BRAKE_TIME, 0.0))

    def _step(self) -> float:
        """Wait for the next period and read all joints; return the time since the last reading."""
        io, clock, before = self._io, self._io.clock, self._io.q
        while True:
            self._tick = max(self._tick + 1.0 / self._rate, clock.now())
            clock.wait_until(self._tick)
            if (ok := io.sample()).all():
                break
            # No balance without positions: a sinking joint cannot be told from a rising one.
            if clock.now() - self._heard > MAX_SILENCE:
                raise ServoTimeoutError(
                    f"no position of {_joint_names(io, ~ok)} for {MAX_SILENCE:g} s while torque "
                    "came on: check their power, cable and id"
                )
            if clock.now() - self._heard > STALE:
                self._hold()
            else:
                io.send(io.goal, io.limit)
        if names := io.without_torque():
            raise ServoFaultError(
                f"the torque of {', '.join(names)} went off again while torque came on: look at "
                "plug and power supply"
            )
        self._check_direction()
        # Encoder steps may be coarser than assumed.
        change = np.abs(io.q - before)
        change = np.where(change > MIN_CHANGE, change, np.inf)
        self._least_change = np.minimum(self._least_change, change)
        seen = np.where(np.isfinite(self._least_change), self._least_change, 0.0)
        self._observer.step = np.maximum(self._assumed_step, np.minimum(seen, MAX_COUNT))
        now = clock.now()
        dt, self._heard = now - self._heard, now
        self._slowest = max(io.delay(now) + dt, self._slowest * math.exp(-dt / FORGET_TIME))
        # A slow bus lengthens the period; a long silence must not, so bound it.
        self._period += PERIOD_SHARE * (min(dt, MAX_PERIOD) - self._period)
        return dt

    def _check_direction(self) -> None:
        """Check that no joint has moved far against its weight.

        Raises:
            _AgainstWeightError: Joints have.
        """
        is_clear = self._follows & (np.abs(self._weight) > CLEAR_WEIGHT * self._friction)
        risen = (self._io.q - self._start) * np.sign(self._weight)
        against = is_clear & (risen > AGAINST_WEIGHT)
        if against.any():
            raise _AgainstWeightError(self._io, against, risen)

    def _control(self) -> Array:
        """Return the torques (n,) [N·m] that bring the joints to rest at their first positions."""
        io, observer, now = self._io, self._observer, self._heard
        age = io.delay(now)
        pole = min(POLE_DELAY / max(age + self._period, self._slowest), MAX_POLE)
        observer.update(now - age, io.q - self._start, pole)
        self._x, self._v = observer.predict(now)
        load = self._load_of(-self._inertia @ observer.d)
        change = min(max(load, LEAST_LOAD), LARGEST_LOAD) - self._load
        time = LOAD_TIME if change > 0.0 else UNLOAD_TIME
        self._set_load(self._load + min(self._period / time, 1.0) * change)
        omega = CONTROL_SHARE * pole
        back = observer.d + 2.0 * omega * self._v + omega**2 * self._x
        back = np.where(self._follows, back, 0.0)
        return np.clip(self._weight - self._inertia @ back, *self._bounds)

    def _load_of(self, torque: Array) -> float:
        """Return the load at the tool [kg] that holding `torque` (n,) [N·m] explains best."""
        weight = self._load_weight
        return float(weight @ torque) / max(float(weight @ weight), MIN_WEIGHT**2)

    def _set_load(self, load: float) -> None:
        """Compute the inertia matrix with a load at the tool [kg]."""
        self._load = load
        self._inertia = self._bare_inertia + load * self._tool.T @ self._tool
        self._inverse = np.linalg.inv(self._inertia)

    def _is_moving(self) -> bool:
        """Return True if the tool has sunk or risen by more than encoder steps explain."""
        lever = self._load_weight / max(float(np.linalg.norm(self._io.model.gravity_vector)), 1e-9)
        height, step = lever @ self._x, 0.5 * np.abs(lever * self._observer.step).max()
        return not -SINK - step <= height <= RISE + step

    def _apply(self, goal: Array, torque: Array, limit: Array) -> None:
        """Send goals and limits (n,), but not to joints in `taken`; pass torques to the observer.

        `torque` are the torques (n,) [N·m] that the joints are assumed to exert.
        """
        io, taken = self._io, self._taken
        io.send(np.where(taken, io.goal, goal), np.where(taken, io.limit, limit))
        self._observe(torque)

    def _observe(self, torque: Array) -> None:
        """Pass the torques (n,) [N·m] to the observer.

        Joints whose torque was on before `enable` are assumed to stand still (u = -d).
        """
        u = self._inverse @ (torque - self._weight)
        self._observer.send(self._heard, np.where(self._follows, u, -self._observer.d))

    def _balance(self) -> Array:
        """Bring the joints to rest by their torque limits; return torques that hold them (n,)."""
        torque, passed, still = self._weight, 0.0, 0.0
        mean, moves = torque.copy(), False
        # Additional torque limit below friction: it holds a joint in place without lifting it.
        spare = 0.5 * self._friction
        while passed < MIN_BALANCE or (still < STILL_TIME and passed < MAX_BALANCE):
            goal = self._start + full_lead(torque, self._kp)
            self._apply(goal, torque, np.abs(torque) + spare)
            dt = self._step()
            passed += dt
            torque = self._control()
            # Do not balance an arm that rests on an object: it would bounce.
            moves = moves or self._is_moving()
            torque = torque if moves else self._weight
            mean += min(dt / TORQUE_TIME, 1.0) * (torque - mean)
            calm = np.abs(self._v).max() < STILL_SPEED and np.abs(self._x).max() < STILL_AWAY
            still = still + dt if calm else 0.0
        self._io.load = max(self._load_of(mean - self._weight), 0.0)
        return mean

    def _transfer(self) -> Array:
        """Do the work of `run`."""
        io, weight = self._io, self._weight
        if not self._taken.all():
            if io.servos.stiffness_known and not self._holds():
                io.servos, self._tried = io.servos.replace(stiffness_known=False), 0.0
                self._observer.d = WEIGHT_SHARE * self._observer.d
            weight = weight if io.servos.stiffness_known else self._balance()
        return self._shrink(weight)

    def _holds(self) -> bool:
        """Try the leads of the assumed stiffness; return False as soon as a joint moves."""
        limit = np.abs(self._weight) + torque_margin(self._io.servos, self._weight)
        limit = np.minimum(limit, self._usable)
        lead = self._weight / self._kp
        while self._tried < TRIAL_TIME or (
            np.abs(self._v).max() > STILL_SPEED and self._tried < MAX_BALANCE
        ):
            self._apply(self._start + lead, self._weight, limit)
            self._tried += self._step()
            self._control()
            risen = (self._io.q - self._start) * np.sign(self._weight)
            least = np.maximum(TRIAL_STEPS * self._observer.step, TRIAL_SHARE * np.abs(lead))
            rises = risen > np.maximum(TRIAL_RISE, least)
            sinks = -risen > np.maximum(TRIAL_SINK, least)
            if (self._follows & (rises | sinks)).any():
                return False
        return True

    def _shrink(self, weight: Array) -> Array:
        """Shrink the leads until they just hold the joints; return them (n,) [rad].

        `weight` is the torque that holds each joint (n,) [N·m]. Leads of a known stiffness do not
        shrink.
        """
        io, servos, kp, usable = self._io, self._io.servos, self._kp, self._usable
        taken, start_q = self._taken, self._start
        up = np.sign(weight)
        enough = FOUND_FRICTION * self._friction + (1.0 + FOUND_SHARE) * np.abs(weight)
        enough = np.minimum(enough, USABLE_SHARE * usable)
        margin = torque_margin(servos, weight)
        lead = np.where(taken, io.goal - start_q, full_lead(weight, kp))
        found = np.where(taken, lead, np.nan)
        # If the torque may have either sign, the stiffness at lead 0 holds the joint.
        light = ~taken & (np.abs(weight) < LIGHT * self._friction)
        lead, found = np.where(light, 0.0, lead), np.where(light, 0.0, found)
        if servos.stiffness_known:
            lead = np.where(taken, lead, weight / kp)
            found = lead
        carrying, late = lead, np.zeros(start_q.size, dtype=bool)
        more, pull, waited = np.zeros((3, start_q.size))
        before, mean, passed = io.q, io.q, self._tried
        while True:
            dt = self._step()
            passed += dt
            q, torque = io.q, self._control()
            step = self._observer.step
            sinking, returned = np.maximum(SINKING, 2.0 * step), np.maximum(RETURNED, 0.6 * step)
            mean = mean + min(dt / MEAN_TIME, 1.0) * (q - mean)
            sunk = (start_q - q) * up
            shrinking = np.isnan(found) & (lead != 0.0)
            # The torque limit exceeds the weight, but the joint sinks: its lead is too small.
            carried = (sunk > sinking) & (torque * up > enough)
            late = late | (shrinking & ~carried & (passed > MAX_TIME))
            held = shrinking & (carried | late)
            # Increase the lead to its value before the joint began to sink.
            back = np.minimum(np.abs(carrying - lead), MAX_BACK)
            lead = np.where(held, lead + up * back, lead)
            found = np.where(held, lead, found)
            sinks = shrinking & ~held & (sunk > sinking)
            waited = np.where(sinks, waited + dt, 0.0)
            speed = np.minimum(np.abs(lead) / SHRINK_TIME, SHRINK_SPEED)
            speed = np.where(sinks, np.where(waited > MAX_WAIT, SLOW_SHRINK_SPEED, 0.0), speed)
            left = up * np.maximum(up * lead - speed * dt, 0.0)
            carrying = np.where(sunk > returned, carrying, lead)
            lead = np.where(shrinking & ~held, left, lead)
            lead = np.where(np.isnan(found) & (np.abs(lead) < MIN_LEAD), 0.0, lead)
            # A joint that sank and has lead 0 needs no lead: the stiffness of its servo holds it.
            found = np.where(np.isnan(found) & (lead == 0.0) & (sunk > 0.5 * sinking), 0.0, found)
            known = np.isfinite(found) | (lead == 0.0)
            # Raise the limit of a joint that continues to sink although its lead is known.
            falls = known & (sunk > 2.0 * sinking) & ((before - q) * up > 0.0)
            more += np.where(falls, usable * dt / LIMIT_RISE, 0.0)
            firm = np.abs(weight) + margin + more
            limit = np.where(known, firm, np.maximum(torque * up, 0.0) + 0.5 * self._friction)
            rise = min(passed / SETTLE_TIME, 1.0) * np.maximum(firm - self._first, 0.0)
            limit = np.minimum(np.where(taken, self._first + rise, limit), usable)
            # Smaller of present and mean displacement; 0 if their signs differ.
            away = np.where(
                (q - start_q) * (mean - start_q) > 0.0,
                np.sign(start_q - q) * np.minimum(np.abs(start_q - q), np.abs(start_q - mean)),
                0.0,
            )
            returning = np.isfinite(found) & (np.abs(away) > returned)
            speed = np.clip(RETURN_GAIN * away, -RETURN_SPEED, RETURN_SPEED)
            waits = np.sign(away) * self._v > RETURNING
            if passed > SETTLE_TIME:
                pull += np.where(returning & ~waits, speed * dt, 0.0)
            goal = start_q + lead + pull
            # Anti-windup: a larger lead would not increase the torque.
            largest = np.maximum(LEAD_FACTOR * limit / kp, np.abs(lead))
            goal = np.clip(goal, q - largest, q + largest)
            pull = goal - start_q - lead
            self._found = found
            io.send(goal, limit)
            self._observe(up * np.minimum(torque * up, limit))
            before = q
            arrived = not returning.any() or passed > MAX_TIME + RETURN_TIME
            if passed >= RAMP_TIME and bool(known.all()) and arrived:
                break
        # A lead that still raises a joint overcomes its friction too: it would raise it further.
        held = io.goal - io.q
        excess = RAISED_SHARE * self._friction / np.maximum(np.abs(weight), self._friction)
        rises = np.isfinite(found) & ((q - mean) * held > returned * np.abs(held))
        if rises.any():
            held = np.where(rises, (1.0 - excess) * held, held)
            io.send(io.q + held, limit)
        io.ramp_limits(limit)
        return np.where(np.isfinite(found) & ~late, held, np.nan)


class _AgainstWeightError(Exception):
    """Joints have moved against their weight: mask `joints` (n,)."""

    def __init__(self, io: ArmIO, joints: Mask, risen: Array) -> None:
        names = io.model.joint_names
        found = [f"{names[i]} by {risen[i]:.2f} rad" for i in np.flatnonzero(joints)]
        super().__init__(
            f"as torque came on, {', '.join(found)} went against the weight of the model: the sign "
            "or zero of the servo is wrong (`pliant servos doctor ARM --watch` shows the direction "
            "of each joint), or a hand lifted the arm"
        )
        self.joints = joints


def _joint_names(io: ArmIO, joints: Mask) -> str:
    return ", ".join(io.model.joint_names[i] for i in np.flatnonzero(joints))

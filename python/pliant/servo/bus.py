"""Bus of all servos of an arm, on one or several ports, in SI units."""

from __future__ import annotations

import math
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from pliant._core import (
    BusCycle,
    BusStatus,
    ConfigError,
    JointReadings,
    OutOfRangeError,
    ServoCodec,
    ServoError,
    ShapeError,
)
from pliant.drive import Clock, ServoStatus
from pliant.servo import _enable as sequences
from pliant.servo._device import Device
from pliant.servo._handshake import ServoInfo, identify, other_ids
from pliant.servo._port import Port, StatusPoller
from pliant.servo._transactions import check_reply_timeout
from pliant.servo.spec import ServoSpec, check_specs, servos_from_units
from pliant.servo.transport import BusError, RustypotTransport, drop_port

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from numpy.typing import ArrayLike

    from pliant._core import Servos
    from pliant._typing import Array, Mask
    from pliant.servo._transactions import Received, TransactionGuard
    from pliant.servo.models.base import Protocol as Wire
    from pliant.servo.transport import Transport


#: Largest difference of the joint angles that two servos of one joint measure; above it, a fault is
#: reported [rad].
MAX_DISAGREEMENT = 0.1
#: Largest difference of the times of two readings that are compared [s]: a joint moves on while one
#: of its servos is silent.
MAX_SKEW = 0.05


def align_secondaries(joints: Sequence[Sequence[Device]]) -> None:
    """Set the zero of each joint's second servo so that both servos measure the same joint angle.

    Raises:
        ServoError: The count of the second servo would wrap around within the joint's range.
    """
    for first, *secondaries in joints:
        for secondary in secondaries:
            if first.position is not None and secondary.position is not None:
                q = first.angle(first.position)
                zero = secondary.position - secondary.units.sign * q / secondary.units.count
                secondary.units = replace(secondary.units, zero=zero)
                secondary.set_range()
                secondary.configure()


def check_agreement(joint: Sequence[Device]) -> None:
    """Set or clear the fault of a joint whose two servos disagree about its angle.

    While one of them is silent, the fault stays as it is.
    """
    read = [(d.angle(position), d.time) for d in joint if (position := d.position) is not None]
    angles, times = zip(*read, strict=True) if read else ((0.0,), (0.0,))
    if max(times) - min(times) > MAX_SKEW:
        return
    difference = max(angles) - min(angles)
    joint[0].fault(
        "secondaries",
        difference > MAX_DISAGREEMENT,
        f"its two servos disagree by {difference:.2f} rad and work against each other: check the "
        "sign of the secondary in the file, then the horns of both",
    )


#: Time limit for reading all servos with retries, in control periods, or in `reply_timeout_min` if
#: that is longer.
BUDGET = 3.0


class ServoBus(BusCycle):
    """Reads and writes all servos of an arm: goals in rad, torque limits in N·m.

    Limits are clamped to the largest value that the servo's registers allow, and goals to the
    joint's range. Goals go to enabled joints only. EEPROM is never written.

    Args:
        specs: One `ServoSpec` per joint, grippers included; all vectors (n,) have this order.
        baudrate: Baud rate [bit/s], one value or a mapping by port.
        rate: Control rate [Hz], which determines timeouts and the time for retries.
        reply_timeout_min: Minimum reply timeout [s], at most 1; use more on a busy computer.
        speed: Largest speed of every joint [rad/s], for the servos' speed registers; None: the
            no-load speed.
        transport: Function ``(port, baudrate, protocol) -> Transport`` that opens a port; default:
            rustypot.
        clock: Clock of the readings and of an arm on this bus; default: the system clock.

    Attributes:
        names: Joint names.
        specs: Joints and their servos.
        found: Identification of each servo, read at open.

    Raises:
        ConfigError: The specs contradict each other.

    Example:
        >>> chain = ServoBus([ServoSpec(name="pan", model="STS3215-7.4V", id=1, port="COM3")])
        >>> chain.open()
        >>> chain.enable(chain.read().position, [0.5])
        >>> chain.write([0.1], [0.5])
    """

    #: True: `enable` has an argument `lead`, see `pliant.drive.Drive`.
    accepts_lead = True

    def __init__(
        self,
        specs: Iterable[ServoSpec],
        *,
        baudrate: int | Mapping[str, int] = 1_000_000,
        rate: float = 100.0,
        reply_timeout_min: float = 0.010,
        speed: float | None = None,
        transport: Callable[[str, int, Wire], Transport] = RustypotTransport,
        clock: Clock | None = None,
    ) -> None:
        """Check that the specs fit together; `open` opens the ports."""
        self.specs = check_specs(specs)
        self.names = tuple(spec.name for spec in self.specs)
        self.n = len(self.specs)
        if not rate > 0.0:
            raise ConfigError(f"rate must be above 0 Hz, got {rate!r}")
        ports = dict.fromkeys(spec.port for spec in self.specs)
        rates = dict.fromkeys(ports, baudrate) if isinstance(baudrate, int) else dict(baudrate)
        if missing := ports.keys() - rates.keys():
            raise ConfigError(f"no baud rate for {', '.join(sorted(missing))}")
        self._baudrate, self._cycle, self._speed = rates, 1.0 / rate, speed
        self._reply_timeout_min = check_reply_timeout(reply_timeout_min)
        self._budget = max(BUDGET * self._cycle, BUDGET * self._reply_timeout_min)
        self._transport, self.clock = transport, clock
        #: Servos that `reopen` has not reached yet.
        self._silent: list[Device] = []
        #: True while `BusCycle` makes requests.
        self._has_usual_cycles = False
        self._reset()
        self._port_of: dict[int, Port] = {}
        self._ports: list[Port] = []
        #: Ports with servos that have a bus watchdog.
        self._watched_ports: list[Port] = []
        self._pool: ThreadPoolExecutor | None = None
        self._watchdog = 0.0
        # For a `closed_copy`, per path: longest delay of a reply [s], latency of the adapter [s],
        # and an id without a servo.
        self._lines: dict[str, tuple[float, float, int]] = {}
        self.found: tuple[ServoInfo, ...] = ()

    # Methods that open and close the bus.

    def open(self) -> None:
        """Open the ports, identify every servo, and read all joints once.

        Raises:
            ServoError: A port cannot be opened, or a servo cannot be driven; the message gives
                cause and remedy. The ports are closed again.
        """
        if self._ports:
            return
        self._reset()
        try:
            for path in dict.fromkeys(spec.port for spec in self.specs):
                self._open_port(path)
            self.found = self.identify()
            if len(self._ports) > 1:
                self._pool = ThreadPoolExecutor(len(self._ports), "pliant-bus")
            self._read_first()
            self._start_usual_cycles()
        except BaseException:
            self.close()
            raise

    @property
    def outlives_program(self) -> bool:
        """True if another process can drive the servos after the end of the program.

        This requires real time, and serial ports without a `transport` of your own.
        """
        is_real = self.clock is None or bool(getattr(self.clock, "real_time", False))
        return is_real and self._transport is RustypotTransport

    def closed_copy(self) -> ServoBus:
        """Return a closed bus of the identified servos, for `reopen` in another process."""
        copy = ServoBus(
            self.specs,
            baudrate=self._baudrate,
            rate=1.0 / self._cycle,
            reply_timeout_min=self._reply_timeout_min,
            speed=self._speed,
        )
        copy._joints, copy._devices = self._joints, self._devices
        copy._doubled = self._doubled
        copy._poller, copy.found = self._poller, self.found
        copy._lines = {
            port.path: (port.guard.response_delay, port.guard.latency, port.guard.unused_id)
            for port in self._ports
        }
        return copy

    def __getstate__(self) -> dict[str, Any]:
        """Return the state to pickle of a `closed_copy`; `reopen` makes the codec again."""
        return {name: value for name, value in self.__dict__.items() if name != "_codec"}

    def reopen(self) -> tuple[Array, Array]:
        """Open the ports of a `closed_copy` after the program has ended with torque on.

        The servos are not identified again, so that a servo that has gone missing does not prevent
        the descent of the others. `write` sends goals to the servos whose torque is on. Torque does
        not change. `disable` restores the registers that the ended program found.

        A servo that does not answer counts as `enabled`. Called again while the ports are open,
        this method asks only these servos, once each.

        Returns:
            Goals [rad] and torque limits [N·m] (n,) in the servos; NaN for a joint without torque
            or without an answer.

        Raises:
            ServoError: A port cannot be opened, for example because a program still uses it; or
                servos do not answer, and the others have no torque.
        """
        if self._ports:
            self._silent = sequences.resume(self._silent, self._port_of, self._budget, 0.0)
            return self._commands()
        for device in self._devices:
            # A torque off before the program's last torque on must not be repeated.
            device.is_off_requested, device.torque_unknown = False, True
        self._attach()
        try:
            for path, (response_delay, latency, unused_id) in self._lines.items():
                port = self._open_port(path)
                port.guard.response_delay, port.guard.unused_id = response_delay, unused_id
                port.latency = port.guard.latency = latency
                port.guard.expect_late_replies()
            if len(self._ports) > 1:
                self._pool = ThreadPoolExecutor(len(self._ports), "pliant-bus")
            self._silent = sequences.resume(
                self._devices, self._port_of, self._budget, sequences.RESUME_TIME
            )
            if self._silent and not any(device.enabled for device in self._devices):
                # Keep their torque: it may hold the arm.
                names = ", ".join(device.name for device in self._silent)
                others = len(self._silent) < len(self._devices)
                raise ServoError(
                    f"no answer from {names}: torque may be on"
                    + (" there, it is off in all other servos" if others else "")
                )
            self._start_usual_cycles()
        except BaseException:
            self.close()
            raise
        return self._commands()

    def _commands(self) -> tuple[Array, Array]:
        """Return goals [rad] and limits [N·m] (n,) last written; NaN for joints not driven."""
        goals, limits = np.full(self.n, np.nan), np.full(self.n, np.nan)
        for i, joint in enumerate(self._joints):
            if all(device.enabled for device in joint):
                goals[i] = joint[0].angle(joint[0].goal or 0)
                limits[i] = abs(joint[0].units.torque(joint[0].limit))
        return goals, limits

    def drop_ports(self) -> None:
        """Release the ports in a forked process; the parent alone then keeps them open."""
        for port in self._ports:
            drop_port(port.path)

    def close(self) -> None:
        """Close the ports; the servos hold their last goal and limit.

        Servos that did not confirm torque off, or whose registers were not restored then, are asked
        once more before.
        """
        self.end_cycles()
        self._has_usual_cycles = False
        try:
            sequences.finish_disable(self._devices, self._port_of, self._budget)
        finally:
            for port in self._ports:
                port.close()
            self._ports, self._watched_ports, self._port_of = [], [], {}
            if self._pool is not None:
                self._pool.shutdown()
                self._pool = None

    def __enter__(self) -> ServoBus:
        """Open the ports as `open` does, and return this bus."""
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        """Close the ports; torque stays as it is."""
        self.close()

    def identify(self) -> tuple[ServoInfo, ...]:
        """Identify and check every servo, and read its torque ceiling, position limits and gain.

        Raises:
            ServoError: A servo is missing, is another model, or cannot be driven.
        """
        self._check_open()
        errors: list[str] = []
        found: list[ServoInfo] = []
        for port in self._ports:
            try:
                found += identify(port)
            except ServoError as error:
                errors.append(str(error))
        for device in self._devices:
            device.configure()
        if errors:
            raise ServoError("\n".join(errors))
        order = {name: i for i, name in enumerate(self.names)}
        return tuple(sorted(found, key=lambda f: order[f.joint]))

    # Parameters and state of the servos; methods that read and write in every control cycle.

    @property
    def servos(self) -> Servos:
        """Servo parameters for a controller, with gains and torque ceilings read from servos."""
        first = [joint[0] for joint in self._joints]
        ceilings = [min(device.ceiling for device in joint) for joint in self._joints]
        return servos_from_units([d.units for d in first], [d.gain for d in first], ceilings)

    @property
    def stiffness_known(self) -> Mask:
        """Mask (n,) of joints whose stiffness k_p was identified on this arm (`ServoSpec.kp`)."""
        return np.array([spec.kp is not None for spec in self.specs])

    @property
    def gains(self) -> dict[str, int]:
        """Gain register of each joint's first servo as read at open, by joint name."""
        return {s.name: joint[0].gain for s, joint in zip(self.specs, self._joints, strict=True)}

    def other_ids(self) -> dict[str, list[int]]:
        """Ping the ids up to 20 that no joint has; return those that answer, by path of the port.

        Raises:
            BusError: A port is gone.
        """
        self._check_open()
        found = {}
        for port in self._ports:
            port.guard.start_cycle()
            found[port.path] = other_ids(port)
        return found

    @property
    def overload(self) -> Array:
        """Share of the usable torque above which overload protection acts (n,); ∞: never.

        For Feetech servos the share follows from the register Overload Torque.
        """
        shares = []
        for first, *_ in self._joints:
            share = float("inf") if first.overload is None else first.overload
            shares.append(share * first.units.full / max(first.ceiling, 1))
        return np.array(shares)

    @property
    def temperature_limit(self) -> Array:
        """Temperatures (n,) at which the servos switch off [°C], as read at open; inf before."""
        return np.array([min(d.temperature_limit for d in joint) for joint in self._joints])

    @property
    def stall_current(self) -> Array:
        """Current at the stall torque (n,) [A]; NaN for servos that do not limit their current."""
        return np.array([s.row.stall_current * len(s.servos) for s in self.specs])

    @property
    def enable_errors(self) -> dict[str, str]:
        """Error texts about servos that `enable` rejects: faulty, out of range, or too hot."""
        texts: dict[str, str] = {}
        for device in self._devices:
            text = sequences.hardware_error(device) or sequences.range_error(device)
            if text := text or ("" if device.torque_on else device.heat()):
                texts.setdefault(device.spec.name, text)
        return texts

    @property
    def counters(self) -> dict[str, int]:
        """Event counters since open by name, summed over all ports.

        Counters of requests are `transactions`, `retries`, `timeouts`, `corrupt` (invalid replies),
        `stale` (late or implausible replies), `drains` (waits for a silent line) and `refused`.
        Counters of servos are `mismatches`, registers that did not read back as written; `alerts`,
        errors that appeared in a status byte, even briefly; and `trips` of bus watchdogs.
        """
        kinds = ("mismatches", "alerts", "trips")
        total = {kind: sum(getattr(device, kind) for device in self._devices) for kind in kinds}
        total["transactions"] = sum(guard.transactions for guard in self._guards)
        for guard in self._guards:
            for name, value in asdict(guard.counters).items():
                total[name] = total.get(name, 0) + value
        return total

    @property
    def enabled(self) -> Mask:
        """Mask (n,) of joints with torque on, switched on by this program or before open.

        A servo whose torque is unknown counts as on.
        """
        return np.array(
            [
                all(d.enabled or d.torque_on or d.torque_unknown for d in joint)
                for joint in self._joints
            ]
        )

    @property
    def torque_unknown(self) -> Mask:
        """Mask (n,) of joints whose torque is unknown.

        A servo has not answered since the end of the program that used it, or has not confirmed
        that its torque is off.
        """
        return np.array([any(d.torque_unknown for d in joint) for joint in self._joints])

    @property
    def unrestored(self) -> Mask:
        """Mask (n,) of joints whose RAM registers were not restored at torque off.

        They keep the torque limits and speeds of this program until the supply is cut.
        """
        return np.array([any(d.is_unrestored for d in joint) for joint in self._joints])

    @property
    def orders(self) -> tuple[Array, Array]:
        """Goals [rad] and torque limits [N·m] (n,), at open, of joints whose torque was already on.

        NaN for joints whose torque was off at open, or that this program has enabled since.
        """
        goals, limits = np.full(len(self._joints), np.nan), np.full(len(self._joints), np.nan)
        for i, joint in enumerate(self._joints):
            stored_command = [d.stored_command for d in joint if d.torque_on and not d.enabled]
            if len(stored_command) == len(joint) and stored_command[0] is not None:
                goal, limit = stored_command[0]
                goals[i], limits[i] = joint[0].angle(goal), abs(joint[0].units.torque(limit))
        return goals, limits

    @property
    def refusing(self) -> Mask:
        """Mask (n,) of joints known to reject goals.

        Their bus watchdog has tripped, or their goal repeatedly did not read back as written.
        """
        return np.array([any(d.is_refusing for d in joint) for joint in self._joints])

    # `BusCycle` has the methods `read`, `write` and `poll_status`. While nothing needs attention,
    # they make the requests themselves; otherwise they call those that follow.

    def _start_usual_cycles(self) -> None:
        """Let `BusCycle` make the requests if one request reads all joints."""
        first, *others = self._ports
        can_start = not others and not self._doubled
        self._has_usual_cycles = can_start and first.start_usual_cycles(self, self._budget)

    def _read_each(self) -> JointReadings:
        """Read all joints, port by port or in parallel; see `read`."""
        if not self._ports:
            self._check_open()
        found: JointReadings | list[int]
        if self._pool is None:
            found = self._ports[0].read(self._budget)
        else:
            accepted = self._pool.map(lambda port: port.read(self._budget), self._ports)
            # Several ports return indices: only a single port returns `JointReadings`.
            found = [i for of_port in accepted if isinstance(of_port, list) for i in of_port]
        if isinstance(found, JointReadings) and not self._doubled:
            return found
        return self._readings(found)

    def _finish_read(
        self, found: Received | OSError, has_status: bool, times: tuple[float, float]
    ) -> JointReadings:
        """Return the readings of all joints after a request that needs attention.

        Args:
            found: The replies, or the error of the port.
            has_status: True if the request was for the status registers too.
            times: Time of the request on the clocks of timeouts and of readings [s].
        """
        return self._readings(self._ports[0].finish_read(found, times, has_status=has_status))

    def _readings(self, found: JointReadings | list[int]) -> JointReadings:
        """Return the readings of all joints, given them or the indices of the servos read."""
        self._check_ports()
        for joint in self._doubled:
            check_agreement(joint)
        return found if isinstance(found, JointReadings) else self._codec.joints(found)

    def _write_each(
        self, goal: ArrayLike, limit: ArrayLike, velocity: ArrayLike | None = None
    ) -> None:
        """Send a command port by port; see `write`."""
        if not self._ports:
            self._check_open()
        command = (goal, limit, velocity, self._speed or 0.0)
        try:
            for port in self._ports:
                try:
                    port.write(command)
                except BusError:
                    # The port counts the error, and the servos keep the values written last.
                    continue
        except (ShapeError, OutOfRangeError):
            # Raise an error that names the joint.
            self._vector(goal, "goal")
            self._vector(limit, "limit", unit="N·m")
            if velocity is not None:
                self._vector(velocity, "velocity", unit="rad/s", unlimited=True)
            raise
        self._check_ports()
        if self._has_usual_cycles:
            self._ports[0].start_usual_writes(self, self._speed or 0.0)

    def _finish_write(self, error: OSError) -> None:
        """Note that a packet could not be sent because of this error of the port."""
        with suppress(BusError):
            self._ports[0].finish_write(error)
        self._check_ports()

    def _poll_each(self) -> ServoStatus | None:
        """Read status registers of one servo; see `poll_status`."""
        if not self._ports:
            self._check_open()
        try:
            status = self._poller.step(self._port_of)
        except BusError:
            status = None
        for port in self._watched_ports:
            try:
                port.clear_watchdogs(port.devices)
            except BusError:
                continue
        self._check_ports()
        if self._has_usual_cycles:
            self._poller.start_usual_polls(self)
        return status

    def _check_ports(self) -> None:
        """Report the ports that are gone, see `_report_lost_ports`."""
        for port in self._ports:
            if port.guard.is_gone:
                self._report_lost_ports()

    # Methods that switch torque on and off.

    def enable(self, goal: ArrayLike, limit: ArrayLike, lead: ArrayLike | None = None) -> None:
        """Switch torque on in the present pose, with the present positions plus `lead` as goals.

        Torque limits and goals are written and checked before torque comes on, and the positions
        afterwards. A joint whose torque is on already keeps it, and gets `goal` as its goal.

        Args:
            goal: Expected joint positions (n,) [rad].
            limit: First torque limits (n,) [N·m].
            lead: First goal minus position (n,) [rad] of joints without torque; None: 0. With it, a
                joint holds its weight immediately.

        Raises:
            ShapeError, ConfigError: A vector is not (n,), not finite or negative.
            ServoError: A servo has a fault, a joint is not near `goal`, moved, or did not confirm.
                The servos switched on are switched off again.
        """
        self._check_open()
        goals, limits = self._vector(goal, "goal"), self._vector(limit, "limit", unit="N·m")
        leads = [0.0] * len(goals) if lead is None else self._vector(lead, "lead")
        speed = self._speed or 0.0
        sequences.enable(self._devices, self._port_of, goals, limits, leads, max_speed=speed)
        if self._watchdog:
            self.watchdog(self._watchdog)

    def disable(self, names: Sequence[str] | None = None) -> None:
        """Switch torque off, by default of all joints; after a failure, continue with the others.

        RAM registers get their initial values again; `unrestored` tells where this failed. `close`
        tries once more where torque off or the registers were not confirmed.

        Raises:
            ServoError: Joints did not confirm that torque is off; the message names them.
        """
        self._check_open()
        sequences.disable(self._select(names), self._port_of)

    def reboot(self, name: str) -> None:
        """Restart the servos of a joint, which clears latched faults; torque is then off.

        Raises:
            ServoError: The servo cannot reboot over the bus, or did not answer afterwards.
        """
        self._check_open()
        sequences.reboot(self._select([name]), self._port_of)

    def watchdog(self, seconds: float) -> None:
        """Set the bus watchdog (Protocol 2.0): servos stop after this bus silence [s]; 0 is off.

        Raises:
            ServoError: A servo did not confirm the new watchdog time.
        """
        self._check_open()
        self._watchdog = seconds
        silent = [name for port in self._ports for name in port.set_watchdog(seconds, self._budget)]
        if silent:
            raise ServoError(f"{', '.join(silent)} did not confirm the bus watchdog")

    def _report_lost_ports(self) -> None:
        """Set a fault for each joint of a port that is gone; other joints can still be driven.

        Raises:
            BusError: All ports are gone.
        """
        gone = [port for port in self._ports if port.guard.is_gone]
        if len(gone) == len(self._ports):
            gone[0].guard.check_port()
        for port in gone:
            for device in port.devices:
                device.fault("port", True, f"its port {port.path} is gone: is it plugged in?")

    def _reset(self) -> None:
        """Create new devices, counters and status poller; discard all state read from servos."""
        #: Servos of each joint, the primary servo first.
        status = BusStatus([0.0] * sum(len(spec.servos) for spec in self.specs))
        self._joints = [
            [Device(spec, i, number, sign, status) for number, sign in spec.servos]
            for i, spec in enumerate(self.specs)
        ]
        self._devices = [device for joint in self._joints for device in joint]
        self._doubled = [joint for joint in self._joints if len(joint) > 1]
        self._silent = []
        self._poller = StatusPoller(self._joints)
        #: Guards of the ports opened since, also of those closed again.
        self._guards: list[TransactionGuard] = []
        self._attach()

    def _attach(self) -> None:
        """Create the codec of all servos; keep their last readings."""
        self._codec = ServoCodec(len(self._devices), self.n)
        for i, device in enumerate(self._devices):
            device.attach(self._codec, i)

    def _open_port(self, path: str) -> Port:
        devices = [device for device in self._devices if device.spec.port == path]
        port = Port(
            path,
            devices,
            baudrate=self._baudrate[path],
            cycle=self._cycle,
            reply_timeout_min=self._reply_timeout_min,
            open_transport=self._transport,
            clock=time.perf_counter if self.clock is None else self.clock.now,
        )
        self._ports.append(port)
        if port.has_watchdog:
            self._watched_ports.append(port)
        self._guards.append(port.guard)
        self._port_of.update({id(device): port for device in devices})
        return port

    def _read_first(self) -> None:
        """Read all servos once; set the zero of second servos from the first servo of the joint."""
        for device in self._devices:
            port = self._port_of[id(device)]
            port.guard.start_cycle()
            try:
                reply = port.guard.read(device.id, *device.family.read)
            except BusError as error:
                error.raise_if_gone()
                raise ServoError(
                    f"{device.spec.name} (id {device.id}) was identified, and then gave no "
                    f"position: {error}; check plug and cable"
                ) from error
            device.accept(reply)
        align_secondaries(self._joints)

    def _select(self, names: Sequence[str] | None) -> list[Device]:
        if names is None:
            return self._devices
        unknown = [name for name in names if name not in self.names]
        if unknown:
            raise ConfigError(f"no joint {unknown[0]!r}; there are: {', '.join(self.names)}")
        return [device for device in self._devices if device.spec.name in names]

    def _vector(
        self, value: ArrayLike | None, name: str, *, unit: str = "", unlimited: bool = False
    ) -> list[float]:
        """Validate and return a vector (n,) of finite numbers; with `unlimited`, inf is allowed.

        If `unit` is given, every number must be at least 0, and the error message contains the
        unit.
        """
        array = np.asarray(value, dtype=np.float64)
        if array.shape != (self.n,):
            raise ShapeError(f"{name} has shape {array.shape}, expected ({self.n},)")
        numbers: list[float] = array.tolist()
        for joint, number in zip(self.names, numbers, strict=True):
            if math.isnan(number) if unlimited else not math.isfinite(number):
                needed = "a number" if unlimited else "finite"
                raise ConfigError(f"{name} of {joint} is not {needed}: {numbers}")
        if unit and (least := min(numbers)) < 0.0:
            joint = self.names[numbers.index(least)]
            raise ConfigError(f"{name} of {joint} is {least:g} {unit}, at least 0 is needed")
        return numbers

    def _check_open(self) -> None:
        if not self._ports:
            raise ServoError(
                "the bus is not open: use the arm or the bus in a `with` statement, or call open() "
                "first"
            )

"""Emulated servos behind serial ports, with an interface for tests."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, Self

from pliant._core import ConfigError
from pliant.emulator.device import Device
from pliant.emulator.faults import Faults
from pliant.emulator.log import Log
from pliant.emulator.serial_line import SerialLine
from pliant.emulator.server import Clock, Server
from pliant.emulator.servo import BIT_HEAT, BIT_OVERLOAD, BIT_VOLTAGE
from pliant.emulator.simulation import Simulation
from pliant.emulator.timing import Timing

if TYPE_CHECKING:
    import threading
    from collections.abc import Sequence

    from pliant.emulator.motion import Physics
    from pliant.emulator.servo import Servo

_CONDITIONS = {"overload": BIT_OVERLOAD, "heat": BIT_HEAT, "voltage": BIT_VOLTAGE}


class Emulator:
    """Emulated servos on one or several pseudo-terminals.

    Use it as a context manager, or `start` and `stop` it. Its methods may be called from any
    thread.

    Args:
        devices: The servos; `Device(..., port="name")` puts one on a port of its own.
        physics: Physics of the shafts; by default each servo alone with its `load`.
        timing: Latencies of the wire; default without.
        faults: Injected faults; default without.
        clock: `real`: physics follows the wall clock. `steps`: time advances only by `advance`
            and, with wire timing, by the duration of transactions.
        baud: Speed of all servos without a `baud_rate` of their own [bit/s].
        log: Longest log [transactions].

    Attributes:
        faults, log: Of all ports.
        world: Servos, physics and clock.
        lines: The wires by port name; `lines["main"].feed(...)` needs no port.

    Raises:
        ConfigError: No devices, an unknown clock, or a speed that a servo does not support.

    Example:
        >>> with Emulator([Device("STS3215", id=1)]) as bus:
        ...     host = rustypot.Sts3215PyController(bus.port, 1_000_000, 0.1)
    """

    def __init__(
        self,
        devices: Sequence[Device],
        *,
        physics: Physics | None = None,
        timing: Timing | None = None,
        faults: Faults | None = None,
        clock: Clock = "real",
        baud: int = 1_000_000,
        log: int = 20_000,
    ) -> None:
        if not devices:
            raise ConfigError("an emulator needs at least one Device")
        if clock not in {"real", "steps"}:
            raise ConfigError(f"clock is 'real' or 'steps', got {clock!r}")
        self.timing, self.faults = timing or Timing(), faults or Faults()
        self.log, self._clock = Log(log), clock
        built = [(device.port, device.build(baud)) for device in devices]
        self.world = Simulation([servo for _, servo in built], physics)
        self.lines = {
            name: SerialLine(
                [servo for port, servo in built if port == name],
                name=name,
                timing=self.timing,
                faults=self.faults,
                log=self.log,
            )
            for name in dict.fromkeys(port for port, _ in built)
        }
        self._server = Server(self.world, self.lines, clock)

    # Start, stop and time.

    def start(self) -> Self:
        """Open the ports and start to answer.

        Raises:
            ServoError: It runs already, or the system has no pseudo-terminals.
        """
        self._server.start()
        return self

    def stop(self) -> None:
        """Close the ports; the log stays.

        Raises:
            ServoError: The emulator's thread had died; the cause is attached.
        """
        self._server.stop()

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def port(self) -> str:
        """Path of the first port; it stays the same when the port is pulled and put back."""
        return next(iter(self.ports.values()))

    @property
    def ports(self) -> dict[str, str]:
        """Paths of all ports by name.

        Raises:
            ServoError: The emulator is not running.
        """
        return self._server.paths()

    @property
    def lag(self) -> float:
        """Time dropped because the computer was too slow for the physics [s]."""
        return self._server.lag

    @property
    def late(self) -> float:
        """Largest latency of a reply due to a busy computer, under the real clock [s]."""
        return self._server.late

    @property
    def time(self) -> float:
        """Time of the emulated world [s]."""
        return self.world.time

    def sync(self) -> None:
        """Wait until everything the host has written so far has been acted on.

        Raises:
            ServoError: The emulator's thread does not respond.
        """
        self._server.sync()

    def advance(self, seconds: float) -> None:
        """Advance the clock `steps`, after all bytes of the host so far have been processed.

        Raises:
            ConfigError: The clock is real, or the time is not a number.
        """
        if self._clock != "steps":
            raise ConfigError("the real clock cannot be advanced: use Emulator(..., clock='steps')")
        self.sync()
        with self._server.lock:
            self.world.advance(seconds)
        self._server.wake()

    # Test interface.

    @property
    def servos(self) -> list[Servo]:
        """All servos, in the order given."""
        return self.world.servos

    def servo(self, id: int) -> Servo:
        """Return the first servo with this id.

        Raises:
            ConfigError: No servo has it.
        """
        return self.world.servo(id)

    def unplug(self, id: int) -> None:
        """Disconnect a servo: no replies and no torque."""
        with self._each(id) as servo:
            servo.plugged = False

    def plug(self, id: int) -> None:
        """Reconnect a servo: it boots, torque off, RAM at its initial values."""
        with self._each(id) as servo:
            servo.plugged = True
            servo.power_up()

    def reboot(self, id: int) -> None:
        """Restart one servo, as after a glitch of its supply."""
        with self._each(id) as servo:
            servo.power_up()

    def brown_out(self) -> None:
        """Interrupt the supply briefly: every servo restarts."""
        with self._server.lock:
            for servo in self.servos:
                servo.power_up()

    def supply(self, volts: float) -> None:
        """Set the supply of all servos [V]; outside a servo's limits it latches or reports."""
        with self._server.lock:
            for servo in self.servos:
                servo.supply = float(volts)

    def trip(self, id: int, condition: Literal["overload", "heat", "voltage"]) -> None:
        """Simulate an overload, overheating or a wrong voltage of a servo.

        Raises:
            ConfigError: No such condition or servo.
        """
        if condition not in _CONDITIONS:
            raise ConfigError(f"no condition {condition!r}; there are {', '.join(_CONDITIONS)}")
        with self._each(id) as servo:
            servo.trip(_CONDITIONS[condition])

    def stick(self, id: int, register: str, value: int | None) -> None:
        """Make a register read a fixed value; None ends that."""
        with self._each(id) as servo:
            servo.table[register]
            servo.stuck.pop(register, None)
            if value is not None:
                servo.stuck[register] = value

    def short(self, shorted: bool = True, port: str | None = None) -> None:
        """Short the line so that no data pass, or end that."""
        with self._server.lock:
            for name, line in self.lines.items():
                if port in {None, name}:
                    line.dead = shorted

    def echo(self, echoing: bool = True, port: str | None = None) -> None:
        """Make the adapter echo requests, as half-duplex ones without suppression do."""
        with self._server.lock:
            for name, line in self.lines.items():
                if port in {None, name}:
                    line.echo = echoing

    def hum(self, noisy: bool = True, port: str | None = None) -> None:
        """Start or stop continuous noise to the host, a few bytes every 5 ms."""
        with self._server.lock:
            for name, line in self.lines.items():
                if port in {None, name}:
                    line.noisy = noisy
        self._server.wake()

    def pull(self, port: str | None = None) -> None:
        """Pull the adapter: the host's open port fails and its path is gone; servos keep power."""
        self._server.hang_up(port)

    def put_back(self, port: str | None = None) -> None:
        """Put the adapter back: the same path opens again."""
        self._server.put_back(port)

    def _each(self, id: int) -> _Locked:
        return _Locked(self._server.lock, self.servo(id))


class _Locked:
    """Access to a servo with the emulator's thread locked out."""

    def __init__(self, lock: threading.RLock, servo: Servo) -> None:
        self._lock, self._servo = lock, servo

    def __enter__(self) -> Servo:
        self._lock.acquire()
        return self._servo

    def __exit__(self, *_: object) -> None:
        self._lock.release()

"""Class `Emulator`: emulated servos behind pseudo-terminals, and methods for tests."""

from __future__ import annotations

from contextlib import contextmanager
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
    from collections.abc import Iterator, Mapping, Sequence

    from pliant.emulator.motion import Physics
    from pliant.emulator.servo import Servo

_CONDITIONS = {"overload": BIT_OVERLOAD, "heat": BIT_HEAT, "voltage": BIT_VOLTAGE}


class Emulator:
    """Emulated servos on one or several pseudo-terminals.

    Use it as a context manager, or `start` and `stop` it. Its methods may be called from any
    thread.

    Args:
        devices: The servos; `Device(..., port="name")` puts a servo on another port.
        physics: Physics of the shafts; by default each servo moves independently with its `load`.
        timing: Latencies of serial line and adapter; none by default.
        faults: Injected faults; none by default.
        clock: `real`: emulated time follows the wall clock. `steps`: it advances only by calls of
            `advance` and, with wire timing, by the duration of transactions.
        baud: Baud rate of all servos whose device sets no `baud_rate` [bit/s], or a mapping from
            ports to baud rates; servos on other ports keep their factory setting.
        log: Capacity of the log [transactions].

    Attributes:
        faults, log: Injected faults and log of all ports.
        world: Simulation of all servos, with physics and time.
        lines: The buses by port name; `lines["main"].feed(...)` works without a pseudo-terminal.

    Raises:
        ConfigError: No devices, an unknown clock, or a baud rate that a servo does not support.

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
        baud: int | Mapping[str, int] = 1_000_000,
        log: int = 20_000,
    ) -> None:
        if not devices:
            raise ConfigError("an emulator needs at least one Device")
        if clock not in {"real", "steps"}:
            raise ConfigError(f"clock is 'real' or 'steps', got {clock!r}")
        self.timing, self.faults = timing or Timing(), faults or Faults()
        self.log, self._clock = Log(log), clock
        rates = dict.fromkeys((d.port for d in devices), baud) if isinstance(baud, int) else baud
        built = [(device.port, device.build(rates.get(device.port))) for device in devices]
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

    # Methods that start and stop the emulator, and that read or advance its time.

    def start(self) -> Self:
        """Open the ports and start to answer requests; return this emulator.

        Raises:
            ServoError: The emulator runs already, or the system has no pseudo-terminals.
        """
        self._server.start()
        return self

    def stop(self) -> None:
        """Close the ports; the log of transactions can still be read.

        Raises:
            ServoError: The emulator's thread had ended with an error, which is attached as cause.
        """
        self._server.stop()

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def port(self) -> str:
        """Path of the first port; unplugging and replugging the adapter does not change it."""
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
        """Time that the emulation skipped because the computer was too slow [s]."""
        return self._server.lag

    @property
    def max_latency(self) -> float:
        """Largest delay of a reply by a busy computer so far [s]; 0 with the clock `steps`."""
        return self._server.max_latency

    @property
    def time(self) -> float:
        """Emulated time since the start [s]."""
        return self.world.time

    def sync(self) -> None:
        """Wait until the servos have processed all bytes that the host has written so far.

        Raises:
            ServoError: The emulator's thread does not respond.
        """
        self._server.sync()

    def advance(self, seconds: float) -> None:
        """Let the servos process the bytes that the host has written, then advance the time.

        Args:
            seconds: Emulated time to add [s].

        Raises:
            ConfigError: The clock is not `steps`, or `seconds` is negative or not finite.
        """
        if self._clock != "steps":
            raise ConfigError("the real clock cannot be advanced: use Emulator(..., clock='steps')")
        self.sync()
        with self._server.lock:
            self.world.advance(seconds)
        self._server.wake()

    # Methods for tests: access to servos, and failures of servos, supply and bus.

    @property
    def servos(self) -> list[Servo]:
        """All servos, in the order of the devices."""
        return self.world.servos

    def servo(self, id: int) -> Servo:
        """Return the first servo with this id.

        Raises:
            ConfigError: No servo has this id.
        """
        return self.world.servo(id)

    def unplug(self, id: int) -> None:
        """Disconnect a servo from bus and supply: it neither replies nor exerts torque."""
        with self._locked(id) as servo:
            servo.plugged = False

    def plug(self, id: int) -> None:
        """Reconnect a servo to bus and supply: it boots with torque off and initial RAM values."""
        with self._locked(id) as servo:
            servo.plugged = True
            servo.power_up()

    def reboot(self, id: int) -> None:
        """Restart one servo, as after a brief interruption of its supply."""
        with self._locked(id) as servo:
            servo.power_up()

    def brown_out(self) -> None:
        """Interrupt the supply briefly: every servo restarts."""
        with self._server.lock:
            for servo in self.servos:
                servo.power_up()

    def supply(self, volts: float) -> None:
        """Set the supply voltage of all servos [V]; they report a voltage outside their limits."""
        with self._server.lock:
            for servo in self.servos:
                servo.supply = float(volts)

    def trip(self, id: int, condition: Literal["overload", "heat", "voltage"]) -> None:
        """Simulate an overload, overheating or a wrong voltage of a servo.

        Raises:
            ConfigError: The condition is unknown, or no servo has this id.
        """
        if condition not in _CONDITIONS:
            raise ConfigError(f"no condition {condition!r}; there are {', '.join(_CONDITIONS)}")
        with self._locked(id) as servo:
            servo.trip(_CONDITIONS[condition])

    def stick(self, id: int, register: str, value: int | None) -> None:
        """Make a register of servo `id` always read as `value`; None ends this fault."""
        with self._locked(id) as servo:
            servo.table[register]
            servo.stuck.pop(register, None)
            if value is not None:
                servo.stuck[register] = value

    def short(self, shorted: bool = True) -> None:
        """Short-circuit the lines of all ports, so that no data pass; False ends the fault."""
        self._set_lines("dead", shorted)

    def echo(self, echoing: bool = True) -> None:
        """Make the adapters of all ports echo requests, as half-duplex ones may; False ends it."""
        self._set_lines("echo", echoing)

    def hum(self, noisy: bool = True) -> None:
        """Start (True) or stop continuous noise from all ports to the host, 3 bytes every 5 ms."""
        self._set_lines("noisy", noisy)
        self._server.wake()

    def pull(self, port: str | None = None) -> None:
        """Unplug the adapter of a port: the host's open port fails, and its path vanishes.

        The servos keep their power. `port` is the name of the port; None: all ports.
        """
        self._server.hang_up(port)

    def put_back(self, port: str | None = None) -> None:
        """Plug the adapter of a port in again: the host can open the same path as before.

        `port` is the name of the port; None: all ports.
        """
        self._server.put_back(port)

    @contextmanager
    def _locked(self, id: int) -> Iterator[Servo]:
        """Yield the servo with this id; meanwhile, the emulator's thread does not change it."""
        servo = self.servo(id)
        with self._server.lock:
            yield servo

    def _set_lines(self, attribute: str, value: bool) -> None:
        """Set an attribute of all buses."""
        with self._server.lock:
            for line in self.lines.values():
                setattr(line, attribute, value)

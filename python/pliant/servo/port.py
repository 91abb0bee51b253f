"""All servos on one serial port: their readings and their one write packet per family."""

from __future__ import annotations

import time
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING

from pliant.servo.guard import Guard
from pliant.servo.transport import BusError, RustypotTransport
from pliant.servo.wire import wire_time

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from pliant.servo.device import Device
    from pliant.servo.guard import Reply
    from pliant.servo.models.row import Block
    from pliant.servo.models.row import Protocol as Wire
    from pliant.servo.transport import Transport

#: A servo that said nothing in so many cycles running is left alone for that many, so that one dead
#: servo does not cost a timeout in each of them.
MISSES, PROBE = 3, 8
#: A servo silent for longer may have restarted, with its torque off [s], or so many cycles.
RESTART, RESTART_CYCLES = 0.1, 3.0
#: Share of a cycle that a further request to all servos may take.
ASK_ALL = 0.2
#: One unit of the bus watchdog [s], its largest number, and how often setting it is tried.
WATCHDOG_UNIT, MOST_WATCHDOG, ROUNDS = 0.02, 127, 4


class Port:
    """One open serial port and its servos.

    Args:
        path: Serial port.
        devices: The servos on it.
        baudrate: Bits per second.
        cycle: Control period [s].
        patience: Least time to wait for an answer [s].
        open_transport: ``(path, baudrate, protocol) -> Transport``.
        clock: The time that readings carry.

    Attributes:
        guard: All transactions go through it.
        watchdog: Bus watchdog of the servos that have one [units of 20 ms]; 0 is off.
        latency: The adapter's latency timer [s]; None where it has none.
    """

    def __init__(
        self,
        path: str,
        devices: Sequence[Device],
        *,
        baudrate: int,
        cycle: float,
        patience: float,
        open_transport: Callable[[str, int, Wire], Transport] = RustypotTransport,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        """Open the port.

        Raises:
            ServoError: It cannot be opened.
            ImportError: The extra `servo` is missing.
        """
        self.path, self.devices = path, tuple(devices)
        protocol = self.devices[0].family.protocol
        self.highest = 253 if protocol == "p1" else 252
        self.latency = latency_timer(path)
        self._io = open_transport(path, baudrate, protocol)
        ids = {device.id for device in self.devices}
        self.guard = Guard(
            self._io,
            protocol,
            baudrate=baudrate,
            latency=self.latency or 0.001,
            cycle=cycle,
            patience=patience,
            absent=max(set(range(self.highest + 1)) - ids),
            stamp=clock,
        )
        self._baudrate, self._cycle = baudrate, cycle
        self._restart = max(RESTART, RESTART_CYCLES * cycle)
        self.watchdog = 0
        self._is_armed = False
        self._misses: dict[int, int] = {}
        self._silent: dict[int, int] = {}

    @property
    def heard(self) -> list[Device]:
        """Servos that are not left alone for their silence."""
        return [device for device in self.devices if device.id not in self._silent]

    def can_ask_all(self) -> bool:
        """Whether one request reads a byte of all servos, within a fifth of a cycle."""
        family = self.devices[0].family
        if not family.sync_read or family.status != "p2" or self.guard.gone:
            return False
        wire = wire_time(
            "p2", "sync_read", len(self.devices), 1, baudrate=self._baudrate, turn=self.guard.turn
        )
        return wire + (self.latency or 0.0) < ASK_ALL * self._cycle

    def close(self) -> None:
        """Let go of the port; the servos keep their last goal and limit."""
        self._io.close()

    def read(self, budget: float) -> set[int]:
        """Read all servos, id by id where one request for all fails.

        Args:
            budget: Time after which nothing is tried again [s].

        Returns:
            Ids whose reading was taken in.

        Raises:
            BusError: The port is gone.
        """
        self.guard.begin(budget)
        replies: dict[int, Reply] = {}
        for group in _groups(self.heard, lambda d: (d.family.sync_read, d.family.read)):
            replies |= self._together(group) if group[0].family.sync_read else self._alone(group)
        replies |= self._probe()
        taken = set()
        for device in self.devices:
            reply = replies.get(device.id)
            if reply is None:
                continue
            self._misses.pop(device.id, None)
            silent = reply.time - device.time > self._restart
            if device.enabled and silent and not self._look(device):
                continue
            if device.accept(reply):
                taken.add(device.id)
            else:
                self.guard.counters.stale += 1
        return taken

    def _look(self, device: Device) -> bool:
        """Read whether a servo's torque is on after a silence; False where it did not say.

        One that has restarted gets no goals any more: on some they would switch its torque on. One
        whose bus watchdog has tripped refuses them until that is cleared.
        """
        try:
            device.note(self.guard.read(device.id, device.family.block("torque_enable")))
            if self._is_armed and "watchdog" in device.family.registers:
                device.note(self.guard.read(device.id, device.family.block("watchdog")))
        except BusError as error:
            _pass_on(error)
            return False
        self.revive([device])
        return True

    def revive(self, devices: Iterable[Device]) -> None:
        """Clear tripped watchdogs and arm them again; retry a failed write in the next cycle.

        Raises:
            BusError: The port is gone.
        """
        for device in devices:
            if not device.tripped:
                continue
            address = device.family.registers["watchdog"].address
            try:
                for units in dict.fromkeys((0, self.watchdog)):
                    self.guard.write(device.id, address, bytes([units]))
            except BusError as error:
                _pass_on(error)
            else:
                device.tripped = False

    def set_watchdog(self, seconds: float, budget: float) -> list[str]:
        """Set the bus watchdog of the servos that have one, tripped or not.

        By packets that need no answer, so that a line that is silent for now costs little; then it
        is read back.

        Args:
            seconds: Silence after which they stop; 0 is never.
            budget: Time for each of `ROUNDS` tries [s].

        Returns:
            Names of the servos that did not confirm.

        Raises:
            BusError: The port is gone.
        """
        self.watchdog = min(MOST_WATCHDOG, ceil(seconds / WATCHDOG_UNIT)) if seconds > 0.0 else 0
        left = [d for d in self.devices if "watchdog" in d.family.registers]
        self._is_armed = self._is_armed or bool(left and self.watchdog)
        for _ in range(ROUNDS):
            if not left:
                break
            self.guard.begin(budget)
            ids, block = [d.id for d in left], left[0].family.block("watchdog")
            try:
                for units in dict.fromkeys((0, self.watchdog)):
                    self.guard.sync_write(ids, block.address, [bytes([units])] * len(ids))
            except BusError as error:
                _pass_on(error)
            answered = [device for device in left if self._reads(device, block)]
            left = [d for d in left if d not in answered or d.watchdog != self.watchdog]
            if not answered:
                break
        if not left and not self.watchdog:
            self._is_armed = False
        return [device.name for device in left]

    def write(self, packets: Sequence[tuple[Device, int, int, int]]) -> None:
        """Send goal, limit and speed cap registers, by sync writes for each kind of servo.

        Args:
            packets: Servo, goal, limit and speed cap.

        Raises:
            BusError: The port is gone, or did not take the packet.
        """
        for group in _groups(packets, lambda p: p[0].family.write):
            family = group[0][0].family
            ids = [device.id for device, *_ in group]
            for names in family.write:
                data = [device.packet(names, *values) for device, *values in group]
                self.guard.sync_write(ids, family.registers[names[0]].address, data)
            for device, goal, limit, _ in group:
                device.sent(goal, limit)

    def _reads(self, device: Device, block: Block) -> bool:
        """Take a block in; False where it did not come."""
        try:
            device.note(self.guard.read(device.id, block, again=False))
        except BusError as error:
            _pass_on(error)
            return False
        return True

    def _together(self, group: Sequence[Device]) -> dict[int, Reply]:
        """One request for all; where it fails, one by one, with the culprit last."""
        try:
            return self.guard.sync_read([device.id for device in group], *group[0].family.read)
        except BusError as error:
            _pass_on(error)
            culprit = error.id
        return self._alone(group, last=culprit, again=False)

    def _alone(
        self, group: Sequence[Device], *, last: int | None = None, again: bool = True
    ) -> dict[int, Reply]:
        """Ask each servo by itself; who says nothing is left alone for a while.

        The one that was heard of the longest ago comes first, so that nobody is left over in every
        cycle whose time runs out.
        """
        replies = {}
        missed = []
        for device in sorted(group, key=lambda device: (device.id == last, device.time)):
            self.guard.counters.retries += not again
            try:
                reply = self.guard.read(device.id, *device.family.read, again=again)
            except BusError as error:
                _pass_on(error)
                if error.reason == "timeout":
                    missed.append(device.id)
            else:
                replies[device.id] = reply
        # Where the whole line is silent nobody is singled out.
        for number in missed if replies else ():
            self._misses[number] = self._misses.get(number, 0) + 1
            if self._misses[number] >= MISSES:
                self._silent[number] = PROBE
        return replies

    def _probe(self) -> dict[int, Reply]:
        """Ask one of the silent servos whose turn it is."""
        for number in self._silent:
            self._silent[number] -= 1
        due = [device for device in self.devices if self._silent.get(device.id, 1) <= 0]
        for device in due[:1]:
            self._silent[device.id] = PROBE
            try:
                reply = self.guard.read(device.id, *device.family.read, again=False)
            except BusError as error:
                _pass_on(error)
            else:
                del self._silent[device.id]
                return {device.id: reply}
        return {}


def latency_timer(path: str) -> float | None:
    """Latency timer of an FTDI adapter [s], None for adapters without one (Linux).

    The driver holds short answers back for as long; 16 ms unless someone has set it to 1.
    """
    name = Path(path).resolve().name
    file = Path("/sys/bus/usb-serial/devices") / name / "latency_timer"
    try:
        return int(file.read_text(encoding="ascii")) / 1000.0
    except (OSError, ValueError):
        return None


def _groups(items: Iterable, key: Callable) -> list[list]:  # type: ignore[type-arg]
    """Items with equal keys together, in order of first appearance."""
    found: dict[object, list] = {}  # type: ignore[type-arg]
    for item in items:
        found.setdefault(key(item), []).append(item)
    return list(found.values())


def _pass_on(error: BusError) -> None:
    """Raise what no next servo can change."""
    if error.reason == "gone":
        raise error

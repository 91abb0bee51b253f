"""All servos on one serial port: reads, and one write packet per servo family."""

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

#: A servo that is silent for this many cycles is skipped for `PROBE` cycles, so that a dead servo
#: does not cost a timeout in every cycle.
MISSES, PROBE = 3, 8
#: Silence after which a servo may have restarted, with its torque off: [s], and cycles.
RESTART, RESTART_CYCLES = 0.1, 3.0
#: Largest share of a cycle for one more request to all servos.
ASK_ALL = 0.2
#: Unit of the bus watchdog [s], its largest value, and number of tries to set it.
WATCHDOG_UNIT, MOST_WATCHDOG, ROUNDS = 0.02, 127, 4


class Port:
    """One open serial port and its servos.

    Args:
        path: Serial port.
        devices: The servos on it.
        baudrate: Bits per second.
        cycle: Control period [s].
        patience: Minimum reply timeout [s].
        open_transport: ``(path, baudrate, protocol) -> Transport``.
        clock: Clock of the readings.

    Attributes:
        guard: Guard of all transactions.
        watchdog: Bus watchdog of the servos that have one [units of 20 ms]; 0: off.
        latency: The adapter's latency timer [s]; None: no such timer.
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
        """Servos that are not skipped for their silence."""
        return [device for device in self.devices if device.id not in self._silent]

    def can_ask_all(self) -> bool:
        """Return True if one request reads a byte of all servos within a fifth of a cycle."""
        family = self.devices[0].family
        if not family.sync_read or family.status != "p2" or self.guard.gone:
            return False
        wire = wire_time(
            "p2", "sync_read", len(self.devices), 1, baudrate=self._baudrate, turn=self.guard.turn
        )
        return wire + (self.latency or 0.0) < ASK_ALL * self._cycle

    def close(self) -> None:
        """Close the port; the servos hold their last goal and limit."""
        self._io.close()

    def read(self, budget: float) -> set[int]:
        """Read all servos with one request; if it fails, read them one by one.

        Args:
            budget: Time after which there are no retries [s].

        Returns:
            Ids of the servos with an accepted reading.

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
        """Read after a silence whether a servo's torque is on; return False without an answer.

        A servo that has restarted gets no goals any more, because on some models they would switch
        torque on. A servo with a tripped watchdog rejects goals until the watchdog is cleared.
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
        """Clear tripped watchdogs and arm them again; a failed write is retried in the next cycle.

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
        """Set the bus watchdog of all servos that have one, tripped or not.

        The packets need no reply, so a temporarily silent line costs little time. The value is then
        read back.

        Args:
            seconds: Silence after which servos stop [s]; 0: never.
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
        """Send goal, limit and speed cap registers with sync writes, one per kind of servo.

        Args:
            packets: Servo, goal, limit and speed cap.

        Raises:
            BusError: The port is gone, or rejected the packet.
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
        """Read and store a block; return False without an answer."""
        try:
            device.note(self.guard.read(device.id, block, again=False))
        except BusError as error:
            _pass_on(error)
            return False
        return True

    def _together(self, group: Sequence[Device]) -> dict[int, Reply]:
        """Read all servos with one request; on failure one by one, the failed one last."""
        try:
            return self.guard.sync_read([device.id for device in group], *group[0].family.read)
        except BusError as error:
            _pass_on(error)
            culprit = error.id
        return self._alone(group, last=culprit, again=False)

    def _alone(
        self, group: Sequence[Device], *, last: int | None = None, again: bool = True
    ) -> dict[int, Reply]:
        """Read each servo by itself; a silent one is skipped for some cycles.

        The servo with the oldest reading comes first, so that no servo misses every cycle that runs
        out of time.
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
        # If the whole line is silent, do not count it against single servos.
        for number in missed if replies else ():
            self._misses[number] = self._misses.get(number, 0) + 1
            if self._misses[number] >= MISSES:
                self._silent[number] = PROBE
        return replies

    def _probe(self) -> dict[int, Reply]:
        """Read one of the silent servos, in turn."""
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
    """Return the latency timer of an FTDI adapter [s]; None for other adapters (Linux).

    The driver holds short replies back for this time: 16 ms by default, 1 ms if configured.
    """
    name = Path(path).resolve().name
    file = Path("/sys/bus/usb-serial/devices") / name / "latency_timer"
    try:
        return int(file.read_text(encoding="ascii")) / 1000.0
    except (OSError, ValueError):
        return None


def _groups(items: Iterable, key: Callable) -> list[list]:  # type: ignore[type-arg]
    """Group items by key, in order of first appearance."""
    found: dict[object, list] = {}  # type: ignore[type-arg]
    for item in items:
        found.setdefault(key(item), []).append(item)
    return list(found.values())


def _pass_on(error: BusError) -> None:
    """Raise an error that also affects all other servos."""
    if error.reason == "gone":
        raise error

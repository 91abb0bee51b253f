"""All servos on one serial port: readings, write packets, and polling of status registers."""

from __future__ import annotations

import sys
import time
from contextlib import suppress
from math import ceil, inf
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pliant._core import JointReadings
from pliant.drive import ServoStatus
from pliant.servo._transactions import (
    BITS_PER_BYTE,
    RELAXED_FACTOR,
    GroupReplies,
    Reply,
    TransactionGuard,
    wire_time,
)
from pliant.servo.transport import BusError, RustypotTransport

if sys.platform != "win32":
    from pliant._core import ServoGroup

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence

    from pliant._core import BusCycle, SerialPort
    from pliant.servo._device import Device
    from pliant.servo._transactions import Received
    from pliant.servo.models.base import Block
    from pliant.servo.models.base import Protocol as Wire
    from pliant.servo.transport import Command, Transport

#: A servo that is silent for `MAX_MISSES` cycles is skipped for `PROBE_TIME` [s], but for at most
#: `PROBE_CYCLES` cycles, because it costs a timeout in each cycle in which it is read.
MAX_MISSES, PROBE_TIME, PROBE_CYCLES = 3, 0.08, 8
#: After a time without readings, a servo may have restarted with torque off. The time is the longer
#: of `RESTART` [s] and `RESTART_CYCLES` control periods.
RESTART, RESTART_CYCLES = 0.1, 3.0
#: Largest speed cap [rad/s] with which a servo that may have restarted gets goals: that of the
#: fastest joint in a descent.
RESTART_SPEED = 1.0
#: Largest share of a control period that reading the status registers of all servos may take, by
#: a request for their torque state or by longer readings.
STATUS_SHARE = 0.2
#: Register Bus Watchdog: its unit [s], its largest value, and the number of tries to set it.
WATCHDOG_UNIT, MAX_WATCHDOG, WATCHDOG_TRIES = 0.02, 127, 4


class Group:
    """Servos whose registers one request can read, or one packet can write.

    Attributes:
        devices: The servos.
        last: Last of the servos.
        family: Family of the servos.
        ids: Ids of the servos.
        sync_read: True if one request can read all of them.
        read: Blocks of a reading, see `Family.read`.
        write_blocks: Block of each packet of a command.
        indices: Indices of the servos in the codec.
        core: `ServoGroup` of the core, which sends a request and converts the registers in one
            call; None if the transport does not support it.
        read_with_status: Blocks of a reading that contains the status registers too; empty: they
            are read separately.
        is_plain: True if the shortest block of a reading contains no status register.
    """

    def __init__(self, devices: Sequence[Device], serial: SerialPort | None = None) -> None:
        self.devices, self.family = devices, devices[0].family
        self.last = devices[-1]
        self.ids = [device.id for device in devices]
        self.indices = [device.index for device in devices]
        self.sync_read, self.read = self.family.sync_read, self.family.read
        self.write_blocks = self.family.write_blocks
        self.read_with_status = self.family.read_with_status
        self.is_plain = not self.family.layout(self.family.read[0]).has_status
        self.core: ServoGroup | None = None
        if serial is not None:
            self.core = ServoGroup(serial, devices[0].codec, self.indices, self.ids)


class Port:
    """One open serial port and its servos.

    Args:
        path: Path of the serial port.
        devices: The servos on this port.
        baudrate: Baud rate [bit/s].
        cycle: Control period [s].
        reply_timeout_min: Minimum reply timeout [s].
        open_transport: Function ``(path, baudrate, protocol) -> Transport`` that opens the port.
        clock: Function that returns the time for readings [s].

    Attributes:
        guard: Requests with timeouts, retries and rejection of late replies.
        watchdog: Time of the bus watchdog, for servos that have one [units of 20 ms]; 0 if off.
        latency: Latency timer of the USB adapter [s]; None without a timer.
        has_watchdog: True if a servo has a bus watchdog.
    """

    def __init__(
        self,
        path: str,
        devices: Sequence[Device],
        *,
        baudrate: int,
        cycle: float,
        reply_timeout_min: float,
        open_transport: Callable[[str, int, Wire], Transport] = RustypotTransport,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        """Open the port.

        Raises:
            ServoError: The port cannot be opened.
            ImportError: The extra `servo` is missing.
        """
        self.path, self.devices = path, tuple(devices)
        protocol = self.devices[0].family.protocol
        self.highest = 253 if protocol == "p1" else 252
        self.latency = latency_timer(path)
        self._io = open_transport(path, baudrate, protocol)
        self._serial: SerialPort | None = getattr(self._io, "serial", None)
        ids = {device.id for device in self.devices}
        self.guard = TransactionGuard(
            self._io,
            protocol,
            baudrate=baudrate,
            latency=self.latency or 0.001,
            cycle=cycle,
            reply_timeout_min=reply_timeout_min,
            unused_id=max(set(range(self.highest + 1)) - ids),
            sample_clock=clock,
        )
        self._baudrate, self._cycle, self._clock = baudrate, cycle, clock
        self._restart = max(RESTART, RESTART_CYCLES * cycle)
        self._probe_cycles = min(PROBE_CYCLES, max(1, round(PROBE_TIME / cycle)))
        self.watchdog = 0
        self._is_armed = False
        #: Number of missed readings of each silent servo, by its id.
        self.misses: dict[int, int] = {}
        self._silent: dict[int, int] = {}
        self.has_watchdog = any("watchdog" in device.family.registers for device in devices)
        self._read_groups = self._grouped(self.devices)
        # The group of all servos, if its readings and its status can be read with one request.
        first, *others = self._read_groups
        has_one = first.sync_read and first.is_plain and first.read_with_status and not others
        self._only_group = first if has_one else None
        self._status, self._seen = self.devices[0].bus_status, -1
        # Groups of the servos that get commands, and True if these are all servos.
        self._write_groups: list[Group] = []
        self._drives_all = False
        # Servos with torque on that get no goals, because they are silent.
        self._withheld: list[Device] = []

    @property
    def responsive(self) -> list[Device]:
        """Servos that are not skipped at present for missing replies."""
        return [device for device in self.devices if device.id not in self._silent]

    def can_read_all(self) -> bool:
        """Return True if one request reads a byte of all servos in `STATUS_SHARE` of a cycle.

        Return False if the servos do not support it, or the port is gone.
        """
        family = self.devices[0].family
        if not family.sync_read or family.status != "p2" or self.guard.is_gone:
            return False
        wire = wire_time(
            "p2",
            "sync_read",
            len(self.devices),
            1,
            baudrate=self._baudrate,
            response_delay=self.guard.response_delay,
        )
        return wire + (self.latency or 0.0) < STATUS_SHARE * self._cycle

    def close(self) -> None:
        """Close the port; the servos hold their last goal and limit."""
        self._io.close()

    def read(self, budget: float) -> JointReadings | list[int]:
        """Read all servos with one request; if it fails, read them one by one.

        Args:
            budget: Time after which the port stops retrying [s].

        Returns:
            Indices of the servos whose reading was received and is plausible; none if the port is
            gone. The readings of the joints instead, if no reading needs attention and all servos
            of the bus are on this port and in one group.
        """
        accepted: list[int] = []
        try:
            self.guard.start_cycle(budget)
            for group in self._grouped(self.responsive) if self._silent else self._read_groups:
                if group.sync_read:
                    readings = self._read_group(group, accepted)
                    if readings is not None:
                        return readings
                else:
                    self._read_each(group, accepted)
            if self._silent:
                self._probe(accepted)
        except BusError:
            return []
        return accepted

    def finish_read(
        self, found: Received | OSError, times: tuple[float, float], *, has_status: bool
    ) -> list[int]:
        """Evaluate the result of a request to all servos that `BusCycle.read` has made.

        Args:
            found: The replies, or the error of the port.
            times: Time of the request on the clocks of timeouts and of readings [s].
            has_status: True if the request was for the status registers too.

        Returns:
            Indices of the servos whose reading was received and is plausible.
        """
        group = self._only_group
        assert group is not None, "the request was for this group"
        accepted: list[int] = []
        block = (group.read_with_status if has_status else group.read)[0]
        try:
            try:
                replies = self.guard.finish_sync_read(group.ids, block, times, found)
            except BusError as error:
                self._read_again(group, error, accepted)
            else:
                self._note_found(group, replies, accepted)
        except BusError:
            return []
        return accepted

    def finish_write(self, error: OSError) -> None:
        """Note that `BusCycle.write` has failed with this error of the port.

        Raises:
            BusError: The port is gone, or takes no bytes.
        """
        (group,) = self._write_groups
        self.guard.finish_sync_write(len(group.ids), group.write_blocks, error)

    def start_usual_cycles(self, bus: BusCycle, budget: float) -> bool:
        """Let `bus` read all servos with one request while nothing needs attention.

        `budget` is the time after which a cycle makes no further request [s]. Return False if the
        servos or the port do not support it.
        """
        group = self._only_group
        if group is None or group.core is None or self.has_watchdog or budget == inf:
            return False
        blocks = group.read[0], group.read_with_status[0]
        plain, with_status = (
            self.guard.request_times("sync_read", len(group.ids), block.size)[1] for block in blocks
        )
        numbers = (
            *(*blocks[0], *blocks[1], plain, with_status),
            *(group.last.index, self._restart, budget),
        )
        bus.set_reading(self.guard, self._status, group.core, self.misses, numbers)
        return True

    def start_usual_writes(self, bus: BusCycle, max_speed: float) -> None:
        """Let `bus` send commands to all servos with one packet per block, if it can.

        `max_speed` is the upper bound of the speeds [rad/s].
        """
        if not self._drives_all or self._withheld or len(self._write_groups) != 1:
            return
        (group,) = self._write_groups
        if group.core is None:
            return
        size = group.write_blocks[-1].size
        timeout = self.guard.request_times("sync_write", len(group.ids), size)[1]
        numbers = timeout, timeout * RELAXED_FACTOR, max_speed
        bus.set_writing(group.core, group.write_blocks, numbers, self._status.torque_changes)

    def _grouped(self, devices: Iterable[Device]) -> list[Group]:
        """Return the devices in groups; one sync read, or single reads, read a group."""
        groups = _groups(
            devices, lambda device: (device.family.sync_read, device.family.read), self._serial
        )
        for group in groups:
            read, with_status = group.family.read, group.read_with_status
            longer = len(group.ids) * (with_status[0].size - read[0].size) if with_status else 0
            if longer * BITS_PER_BYTE / self._baudrate > STATUS_SHARE * self._cycle:
                group.read_with_status = ()
        return groups

    def _accept(self, replies: Sequence[tuple[Device, Reply]], accepted: list[int]) -> None:
        """Pass readings to their servos; add the indices of plausible ones to `accepted`."""
        silent = [d for d, r in replies if d.enabled and r.time - d.time > self._restart]
        unknown = self._check_restart(silent) if silent else set()
        for device, reply in replies:
            if device.id in unknown:
                continue
            self.misses.pop(device.id, None)
            if device.accept(reply):
                accepted.append(device.index)
            else:
                self.guard.counters.stale += 1

    def _check_restart(self, devices: Sequence[Device]) -> set[int]:
        """Read torque state and watchdog of servos that were silent.

        A restarted servo gets no more goals, because a goal switches torque on in some models. A
        tripped watchdog is cleared, because the servo rejects goals until then.

        Returns:
            Ids of the servos without a reply.
        """
        unknown = self._note_registers(devices, "torque_enable")
        if self._is_armed:
            # All servos of the port have Protocol 2.0, and a watchdog.
            unknown |= self._note_registers(devices, "watchdog")
        self.clear_watchdogs([device for device in devices if device.id not in unknown])
        return unknown

    def _note_registers(self, devices: Sequence[Device], name: str) -> set[int]:
        """Read a register of these servos, with one request if possible, and note its values.

        The servos are of one `Group` of readings, so that all have the register at one address.
        Behind an adapter with a latency timer, a request per servo would take longer than a command
        may be old.

        Returns:
            Ids of the servos without a reply.
        """
        silent: set[int] = set()
        family = devices[0].family
        block = family.block(name)
        if family.sync_read and len(devices) > 1:
            try:
                block, answers, time = self.guard.sync_read([d.id for d in devices], block)
            except BusError as error:
                error.raise_if_gone()
            else:
                for device, (data, status) in zip(devices, answers, strict=True):
                    device.note(Reply(block, data, status, time))
                return silent
        for device in devices:
            try:
                device.note(self.guard.read(device.id, block))
            except BusError as error:
                error.raise_if_gone()
                silent.add(device.id)
        return silent

    def clear_watchdogs(self, devices: Iterable[Device]) -> None:
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
                error.raise_if_gone()
            else:
                device.tripped = False

    def set_watchdog(self, seconds: float, budget: float) -> list[str]:
        """Set the bus watchdog of all servos that have one, tripped or not.

        The value is written with packets without reply, which cost little time if servos are
        silent, and is then read back.

        Args:
            seconds: Bus silence after which servos stop [s]; 0: never.
            budget: Time for each of `WATCHDOG_TRIES` tries [s].

        Returns:
            Names of the servos that did not confirm the new value.

        Raises:
            BusError: The port is gone.
        """
        self.watchdog = min(MAX_WATCHDOG, ceil(seconds / WATCHDOG_UNIT)) if seconds > 0.0 else 0
        pending = [d for d in self.devices if "watchdog" in d.family.registers]
        self._is_armed = self._is_armed or bool(pending and self.watchdog)
        has_answer = False
        for _ in range(WATCHDOG_TRIES):
            if not pending:
                break
            self.guard.start_cycle(budget)
            ids, block = [d.id for d in pending], pending[0].family.block("watchdog")
            try:
                for units in dict.fromkeys((0, self.watchdog)):
                    self.guard.sync_write(ids, block.address, [bytes([units])] * len(ids))
            except BusError as error:
                error.raise_if_gone()
            answered = [device for device in pending if self._read_block(device, block)]
            pending = [d for d in pending if d not in answered or d.watchdog != self.watchdog]
            has_answer = has_answer or bool(answered)
            if not has_answer:
                break
        if not pending and not self.watchdog:
            self._is_armed = False
        return [device.name for device in pending]

    def write(self, command: Command) -> None:
        """Send goal, limit and speed cap registers to the servos with torque on.

        There is one packet per kind of servo and block of registers. The values for servos without
        torque are checked too. A silent servo may have restarted, and a goal switches its torque on
        except with Protocol 2.0: it gets its limit only, unless the speed cap in the same packet
        keeps it from jumping, as in a descent.

        Raises:
            ShapeError, OutOfRangeError: See `ServoCodec.encode`; nothing was sent.
            BusError: A packet could not be sent.
        """
        silent: list[Device] = []
        if self.misses:
            self.devices[0].codec.encode([], *command)
            silent = self._silent_devices(command)
        if self._seen != self._status.torque_changes or silent != self._withheld:
            self._seen, self._withheld = self._status.torque_changes, silent
            driven = [device for device in self.devices if device.enabled and device not in silent]
            self._drives_all = len(driven) == len(self.devices)
            self._write_groups = write_groups(driven, self._serial)
        if not self._drives_all:
            self.devices[0].codec.encode([], *command)
        for group in self._write_groups:
            if group.core is not None:
                self.guard.sync_encode(group.core, len(group.ids), group.write_blocks, command)
            else:
                goals, limits, _, *data = group.devices[0].codec.encode(group.indices, *command)
                self.send(group, goals, limits, data)
        for device in silent:
            _, (limit,), *_ = device.codec.encode([device.index], *command)
            register = device.family.registers["limit"]
            self.guard.sync_write([device.id], register.address, [register.encode(limit)])
            device.record_sent(device.goal, limit)

    def _silent_devices(self, command: Command) -> list[Device]:
        """Return the servos with torque on that may have restarted, and would jump to the goal."""
        if self.devices[0].family.protocol == "p2":
            return []
        oldest = self._clock() - self._restart
        silent = [d for d in self.devices if d.enabled and d.id in self.misses and d.time < oldest]
        if command[2] is None:
            return silent
        speed = np.asarray(command[2])
        return [d for d in silent if not (d.caps_speed and speed[d.joint] <= RESTART_SPEED)]

    def send(
        self, group: Group, goals: Sequence[int], limits: Sequence[int], data: Sequence[list[bytes]]
    ) -> None:
        """Send packets to servos of one kind, with one sync write per block, and record them.

        Args:
            group: The servos.
            goals: Values of their goal registers.
            limits: Values of their limit registers.
            data: Bytes for each servo, per block of `Family.write_blocks`.

        Raises:
            BusError: A packet could not be sent.
        """
        for block, items in zip(group.family.write_blocks, data, strict=False):
            self.guard.sync_write(group.ids, block.address, items)
        for device, goal, limit, packet in zip(group.devices, goals, limits, data[0], strict=True):
            device.record_sent(goal, limit, packet)

    def _read_block(self, device: Device, block: Block) -> bool:
        """Read a block of registers and store its values in the device; False: no reply came.

        After a lost reply to such a request, a reading of another length comes first: its reply
        proves that the lost one can no longer come.
        """
        try:
            if self.guard.may_get_late_reply(device.id, block):
                self.guard.read(device.id, *device.family.read, again=False)
            device.note(self.guard.read(device.id, block, again=False))
        except BusError as error:
            error.raise_if_gone()
            return False
        return True

    def _read_group(self, group: Group, accepted: list[int]) -> JointReadings | None:
        """Read several servos with one request; add the indices of plausible ones to `accepted`.

        If the request fails, read the servos one by one, the servo that failed last. The reading
        includes the status registers once `StatusPoller` has used the previous status of the last
        servo, and so of all. This saves a separate status request in each cycle.

        Returns:
            The readings of the joints, if none needs attention and the bus has no other servos.
        """
        decoder = None if self.misses else group.core
        blocks, is_usual, has_status = group.read, group.is_plain, False
        if group.read_with_status and not self._status.has_new(group.last.index):
            blocks, has_status = group.read_with_status, True
            is_usual = all(device.is_driven for device in group.devices)
        try:
            found = self.guard.sync_decode(
                group.ids, blocks, decoder, self._restart, usual=is_usual
            )
        except BusError as error:
            self._read_again(group, error, accepted)
            return None
        if has_status and not isinstance(found, GroupReplies):
            time = group.last.time
            for device in group.devices:
                device.note_command(time)
        if isinstance(found, JointReadings):
            return found
        self._note_found(group, found, accepted, has_decoder=decoder is not None)
        return None

    def _read_again(self, group: Group, error: BusError, accepted: list[int]) -> None:
        """Read servos one by one after the failure `error` of a request to all of them."""
        error.raise_if_gone()
        self._read_each(group, accepted, last=error.id, again=False)

    def _note_found(
        self,
        group: Group,
        found: GroupReplies | None,
        accepted: list[int],
        *,
        has_decoder: bool = True,
    ) -> None:
        """Store the readings of a group; add the indices of plausible readings to `accepted`.

        Args:
            group: The servos.
            found: Their replies; None: the core has stored all readings, and all are plausible.
            accepted: List to which the indices are added.
            has_decoder: True if the core has already decoded the replies; False: decode them here.
        """
        if found is None:
            accepted += group.indices
            return
        block, answers, notable, time = found
        if self.misses:
            replies = [Reply(block, data, status, time) for data, status in answers]
            self._accept(list(zip(group.devices, replies, strict=True)), accepted)
            return
        if not has_decoder:
            codec = group.devices[0].codec
            notable = codec.decode(group.indices, answers, block.address, time, self._restart)
        has_status = group.family.layout(block).has_status
        if not (notable or has_status):
            accepted += group.indices
            return
        results = dict(notable)
        silent = []
        for i, device in enumerate(group.devices):
            data, status = answers[i]
            result = results.get(i, True)
            if result is None:
                silent.append((device, Reply(block, data, status, time)))
            elif i in results and not device.check_reading(result, status, time):
                self.guard.counters.stale += 1
            else:
                accepted.append(device.index)
                if has_status:
                    device.note_status(Reply(block, data, status, time))
        self._accept(silent, accepted)

    def _read_each(
        self,
        group: Group,
        accepted: list[int],
        *,
        last: int | None = None,
        again: bool = True,
    ) -> None:
        """Read each servo with a separate request; add indices of plausible ones to `accepted`.

        The servo with the oldest reading comes first: a cycle that runs out of time then does not
        always miss the same servos. A servo that is silent repeatedly is skipped for some cycles.

        Args:
            group: The servos.
            accepted: List that gets the indices.
            last: Id of a servo to read last.
            again: True to retry after a failure.
        """
        replies = []
        missed = []
        for device in sorted(group.devices, key=lambda device: (device.id == last, device.time)):
            self.guard.counters.retries += not again
            try:
                family = device.family
                is_due = not self._status.has_new(device.index)
                blocks = (is_due and group.read_with_status) or family.read
                reply = self.guard.read(device.id, *blocks, again=again)
            except BusError as error:
                error.raise_if_gone()
                if error.reason == "timeout":
                    missed.append(device.id)
            else:
                replies.append((device, reply))
        # Count missing replies only if another servo replies: otherwise the line has failed.
        for number in missed if replies else ():
            self.misses[number] = self.misses.get(number, 0) + 1
            if self.misses[number] >= MAX_MISSES:
                self._silent[number] = self._probe_cycles
        self._accept(replies, accepted)

    def _probe(self, accepted: list[int]) -> None:
        """Read one servo that has been skipped for long enough, if there is one."""
        for number in self._silent:
            self._silent[number] -= 1
        due = [device for device in self.devices if self._silent.get(device.id, 1) <= 0]
        for device in due[:1]:
            self._silent[device.id] = self._probe_cycles
            # `ServoBus.read` notices a port that is gone.
            with suppress(BusError):
                reply = self.guard.read(device.id, *device.family.read, again=False)
                del self._silent[device.id]
                self._accept([(device, reply)], accepted)


def latency_timer(path: str) -> float | None:
    """Return the latency timer of an FTDI adapter [s]; None for other adapters and systems.

    The adapter delays short replies by this time: 16 ms by default, 1 ms if configured. Only Linux
    reports it.
    """
    name = Path(path).resolve().name
    file = Path("/sys/bus/usb-serial/devices") / name / "latency_timer"
    try:
        return int(file.read_text(encoding="ascii")) / 1000.0
    except (OSError, ValueError):
        return None


def _groups(
    devices: Iterable[Device], key: Callable[[Device], Hashable], serial: SerialPort | None
) -> list[Group]:
    """Return groups of the devices with equal keys, in the order in which the keys first appear."""
    groups: dict[Hashable, list[Device]] = {}
    for device in devices:
        groups.setdefault(key(device), []).append(device)
    return [Group(members, serial) for members in groups.values()]


def write_groups(devices: Iterable[Device], serial: SerialPort | None = None) -> list[Group]:
    """Return groups of the devices whose registers one packet can write, on the port `serial`."""
    return _groups(devices, lambda device: device.family.write, serial)


#: Topics of faults that move a servo to the front of the status readings.
URGENT_FAULTS = frozenset({"torque", "jump", "port"})
#: Number of control cycles per request for the torque state of the enabled servos of one port; the
#: ports take turns.
TORQUE_PERIOD = 3


class StatusPoller:
    """Reads status registers of all servos in turn, one block per cycle, servos with faults first.

    A servo whose last reading contained all its status registers is not read again.

    Args:
        joints: Servos of each joint.
    """

    def __init__(self, joints: Sequence[Sequence[Device]]) -> None:
        """Store the servos, and list their status blocks in the order of reading."""
        self._joints = joints
        self._devices = [device for joint in joints for device in joint]
        self._steps = [(d, block) for d in self._devices for block in d.family.status_blocks]
        self._reads_torque = any(d.family.status == "p2" for d in self._devices)
        self._reported: set[int] = set()
        self._is_repeat = False
        self._block_index = self._count = 0
        # Valid while the number of changes is `_seen`: servos with a fault, and statuses by joint.
        self._status, self._seen = self._devices[0].bus_status, -1
        self._doubtful: list[Device] = []
        self._statuses: dict[int, ServoStatus] = {}

    def step(self, ports: Mapping[int, Port]) -> ServoStatus | None:
        """Read one status block, and return the status of the servo's joint.

        Servos with a new alert or an urgent fault come first. So do servos whose goal or limit did
        not read back as written: a second reading distinguishes a lost packet from a rejected one.

        Returns:
            The status; None if no reply came, or if the torque state of a port's servos was
            requested instead.

        Raises:
            BusError: The port is gone.
        """
        if self._reads_torque:
            self._count += 1
            if self._count % TORQUE_PERIOD == 0 and self._check_torque(ports):
                return None
        if self._seen != self._status.changes:
            self._note_changes()
        chosen = self._choose() if self._doubtful or self._reported else None
        if chosen is None:
            self._is_repeat = False
            chosen = self._steps[self._status.next_step]
            self._status.next_step = (self._status.next_step + 1) % len(self._steps)
            device = chosen[0]
            if self._status.has_new(device.index):
                self._status.set_new(device.index, False)
                return self._status_of(device.joint)
        device, block = chosen
        guard = ports[id(device)].guard
        if guard.is_gone:
            return self._status_of(device.joint)
        try:
            device.note(guard.read(device.id, block))
        except BusError as error:
            error.raise_if_gone()
            return None
        status = self._status_of(device.joint)
        return status if device.faults or not self._is_undecided(device.joint) else None

    def _is_undecided(self, joint: int) -> bool:
        """Return True if a servo of the joint has an alert whose cause has not been read yet."""
        return bool(self._doubtful) and any(
            device.conditions and id(device) not in self._reported for device in self._joints[joint]
        )

    def start_usual_polls(self, bus: BusCycle) -> None:
        """Let `bus` return the statuses of the joints while there are no changes, if it can."""
        if self._seen != self._status.changes or self._doubtful or self._reported:
            return
        if not all(device.is_driven for device in self._devices):
            return
        devices = [device for device, _ in self._steps]
        statuses = tuple(self._status_of(device.joint) for device in devices)
        bus.set_polling([device.index for device in devices], statuses, self._seen)

    def _check_torque(self, ports: Mapping[int, Port]) -> bool:
        """Read with one request whether torque is on, for all enabled servos of one port.

        The ports take turns. Ports whose servos do not support such a request, or on which it takes
        too much of a cycle, are skipped.

        Returns:
            True if a request was made and did not show that a servo has lost its torque.
        """
        candidates = [port for port in dict.fromkeys(ports.values()) if port.can_read_all()]
        if not candidates:
            return False
        port = candidates[self._count // TORQUE_PERIOD % len(candidates)]
        enabled = [d for d in port.responsive if d.enabled]
        if not enabled:
            return False
        try:
            block = enabled[0].family.block("torque_enable")
            block, answers, time = port.guard.sync_read([d.id for d in enabled], block)
        except BusError as error:
            error.raise_if_gone()
            return True
        for device, (data, status) in zip(enabled, answers, strict=True):
            device.note(Reply(block, data, status, time))
        # False: the caller reads the status of a servo that lost its torque in the same cycle.
        return all(d.enabled for d in enabled)

    def _choose(self) -> tuple[Device, Block] | None:
        """Return a servo with a fault, and the block to read; None: the next servo in turn."""
        if self._reported:
            self._reported.intersection_update(map(id, self._doubtful))
        for device in self._doubtful:
            if device.has_suspect_register and not self._is_repeat:
                self._is_repeat = True
                blocks = device.family.stored_command_blocks
                self._block_index += 1
                return device, blocks[self._block_index % len(blocks)]
            is_urgent = bool(device.conditions) or not URGENT_FAULTS.isdisjoint(device.other_faults)
            if is_urgent and id(device) not in self._reported:
                self._reported.add(id(device))
                return device, device.family.status_blocks[0]
            if not is_urgent:
                self._reported.discard(id(device))
        return None

    def _note_changes(self) -> None:
        """Update the list of servos with faults or mismatches, and discard the cached statuses."""
        self._seen = self._status.changes
        self._statuses.clear()
        self._doubtful = [
            device
            for device in self._devices
            if device.conditions or device.other_faults or device.has_mismatch
        ]

    def _status_of(self, joint: int) -> ServoStatus:
        """Return the status of a joint; the same object as long as there are no changes."""
        if self._seen != self._status.changes:
            self._note_changes()
        status = self._statuses.get(joint)
        if status is None:
            status = self._statuses[joint] = self._new_status(joint)
        return status

    def _new_status(self, joint: int) -> ServoStatus:
        devices = self._joints[joint]
        first = devices[0]
        if len(devices) == 1:
            return ServoStatus(
                first.spec.name, first.voltage, first.temperature, first.faults, first.protections
            )
        volts = [d.voltage for d in devices if d.voltage is not None]
        temperatures = [d.temperature for d in devices if d.temperature is not None]
        return ServoStatus(
            first.spec.name,
            min(volts) if volts else None,
            max(temperatures) if temperatures else None,
            tuple(text for d in devices for text in d.faults),
            tuple(text for d in devices for text in d.protections),
        )

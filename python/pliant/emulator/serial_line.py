"""Half-duplex bus with its servos: converts request bytes to reply bytes, without a thread."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pliant.emulator import _protocol1, _protocol2
from pliant.emulator._x_series import XServo
from pliant.emulator.faults import ActiveFault, Faults, collide
from pliant.emulator.log import Log, Transaction
from pliant.emulator.packets import BROADCAST, Framer
from pliant.emulator.timing import Timing

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pliant.emulator.packets import Frame
    from pliant.emulator.servo import Servo

#: Largest relative difference of baud rates at which a servo understands the host.
BAUD_TOLERANCE = 0.03


@dataclass(frozen=True, slots=True)
class Delivery:
    """Bytes for the host, with their time of arrival.

    Attributes:
        after: Time from the request's first byte to the arrival [s]; None: just before the replies
            to the next request.
        data: The bytes.
        is_delayed: True if an injected fault delays the bytes, in addition to the bus latency.
    """

    after: float | None
    data: bytes
    is_delayed: bool = False


class SerialLine:
    """Half-duplex bus with its servos.

    Attributes:
        name: Name of the port.
        servos: All servos on the bus.
        dead: True if no data pass, as on a shorted line.
        echo: True if the adapter returns every request before the reply.
        noisy: True if the host receives noise bytes continuously.
        occupied: Time for which the transactions of the last `feed` keep the bus busy [s].
        answered: Time from the last `feed` to the arrival of its last reply, without replies that a
            fault delays [s].
        faults, timing, log: Injected faults, latencies and log of the bus.
    """

    def __init__(
        self,
        servos: Sequence[Servo],
        *,
        name: str = "main",
        timing: Timing | None = None,
        faults: Faults | None = None,
        log: Log | None = None,
    ) -> None:
        """Connect the servos to the bus; by default without latencies and faults."""
        self.servos, self.name = list(servos), name
        self.dead = self.echo = self.noisy = False
        self.occupied = self.answered = self._took = 0.0
        self.timing, self.faults = timing or Timing(), faults or Faults()
        self.log = Log() if log is None else log
        self._framer = Framer()

    def reset(self) -> None:
        """Discard an unfinished request, as servos do after a pause."""
        self._framer.reset()

    def feed(self, data: bytes, baud: int | None = None, now: float = 0.0) -> list[Delivery]:
        """Process bytes from the host and return the replies, in the order of sending.

        Args:
            data: Bytes from the host; a packet may be split over several calls.
            baud: Baud rate of the host [bit/s]; None matches every servo.
            now: Present time [s], for the log.
        """
        deliveries: list[Delivery] = []
        self.occupied = self.answered = 0.0
        for frame in self._framer.feed(data):
            # Each transaction starts when the previous one has left the bus.
            start, replies = self.occupied, self._transact(frame, baud, now)
            for reply in replies:
                after = None if reply.after is None else start + reply.after
                deliveries.append(Delivery(after, reply.data, reply.is_delayed))
                if after is not None and not reply.is_delayed:
                    self.answered = max(self.answered, after)
            self.occupied = start + self._took
        return deliveries

    def _transact(self, frame: Frame, baud: int | None, now: float) -> list[Delivery]:
        faults, fault_names = self.faults, list[str]()
        listening = [] if self.dead else self._listening(frame, baud)
        random_fault = faults.chance()
        if random_fault == "deaf":
            fault_names.append("deaf")
            listening = []
        for servo in list(listening) if faults.injected else ():
            if frame.id in {BROADCAST, servo.id} and faults.deaf(servo.id):
                fault_names.append(f"deaf {servo.id}")
                listening.remove(servo)
        slots = self._handle(listening, frame)
        has_random_fault = random_fault is not None and random_fault != "deaf" and bool(slots)
        faulty_index = faults.pick(len(slots)) if has_random_fault else -1
        packets: list[tuple[float, float, bytes]] = []
        delayed: list[Delivery] = []
        rate = baud or 1_000_000
        time = self.timing.span(len(frame.raw), rate)
        for index, slot in enumerate(slots):
            servo, packet = slot[0]
            for _, other in slot[1:]:
                packet = collide(packet, other)
            fault = faults.reply_fault(servo.id) if faults.injected else None
            if fault is None and index == faulty_index and random_fault is not None:
                fault = ActiveFault(random_fault)
            if self.timing.wire:
                time += self.timing.turnaround + self._pause(frame, index, servo)
            begin, time = time, time + self.timing.span(len(packet), rate)
            if fault is not None:
                fault_names.append(f"{fault.kind} {servo.id}")
                if fault.kind == "late":
                    after = None if fault.seconds is None else time + fault.seconds
                    delayed.append(Delivery(after, packet, is_delayed=True))
                packet = faults.damage(fault.kind, packet)
            if packet:
                packets.append((begin, time, packet))
        self._took = time
        writes = [write for servo in listening for write in servo.journal]
        for servo in listening:
            servo.journal.clear()
        names = _protocol1.NAMES if frame.protocol == 1 else _protocol2.NAMES
        name = names.get(frame.instruction, f"0x{frame.instruction:02x}")
        sent = tuple(data for _, _, data in packets)
        self.log.add(
            Transaction(
                now,
                self.name,
                frame.raw,
                name if frame.ok else f"broken {name}",
                frame.id,
                sent,
                tuple(fault_names),
                tuple(writes),
                time,
            )
        )
        if self.timing.off:
            prompt = [Delivery(0.0, b"".join(sent))] if sent else []
        else:
            prompt = [Delivery(when, part) for when, part in self.timing.deliveries(packets)]
        echoed = [Delivery(0.0, frame.raw)] if self.echo else []
        return echoed + prompt + delayed

    def _listening(self, frame: Frame, baud: int | None) -> list[Servo]:
        return [
            servo
            for servo in self.servos
            if servo.is_listening
            and servo.protocol == frame.protocol
            and (baud is None or abs(servo.baud - baud) <= BAUD_TOLERANCE * baud)
        ]

    @staticmethod
    def _handle(listening: list[Servo], frame: Frame) -> list[_protocol1.Slot]:
        if frame.protocol == 1:
            return _protocol1.handle(listening, frame)
        return _protocol2.handle([s for s in listening if isinstance(s, XServo)], frame)

    @staticmethod
    def _pause(frame: Frame, index: int, servo: Servo) -> float:
        """Return the delay of a servo before its reply [s]; `index` counts the replies from 0.

        In a fast read (Protocol 2.0) only the first servo delays its reply.
        """
        fast = {_protocol2.FAST_SYNC_READ, _protocol2.FAST_BULK_READ}
        chained = frame.protocol == 2 and frame.instruction in fast and index > 0
        return 0.0 if chained else servo.return_delay

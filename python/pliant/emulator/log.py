"""Log of all bytes on the wire, raw and decoded, for assertions after a run."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from pliant.emulator.control_tables import Table

#: Registers that carry a goal, a torque limit, and the torque switch, in every family.
GOALS = frozenset({"goal_position"})
LIMITS = frozenset({"torque_limit", "goal_current", "goal_pwm"})
SWITCH = "torque_enable"


@dataclass(frozen=True, slots=True)
class Write:
    """One write to one servo, done or rejected.

    Attributes:
        time: Emulator time [s].
        id: The servo's id at that time.
        instruction: `write`, `reg_write` (done at the action), `sync_write` or `bulk_write`.
        address: First byte.
        data: The bytes.
        enabled: True if torque was on before this write.
        error: 0 if accepted, else the family's error; a sync write is rejected without a reply.
    """

    time: float
    id: int
    instruction: str
    address: int
    data: bytes
    enabled: bool
    error: int
    _table: Table = field(repr=False)

    @property
    def values(self) -> dict[str, int]:
        """Registers written, by name, in the order of their addresses."""
        found: dict[str, int] = {}
        for register in self._table.span(self.address, len(self.data)):
            start = register.address - self.address
            if start >= 0 and start + register.size <= len(self.data):
                found[register.name] = register.decode(self.data[start : start + register.size])
        return found

    @property
    def eeprom(self) -> bool:
        """True if the write touches the EEPROM area."""
        return any(r.area == "eeprom" for r in self._table.span(self.address, len(self.data)))


@dataclass(frozen=True, slots=True)
class Transaction:
    """A request and its replies.

    Attributes:
        time: Emulator time of the request [s].
        port: Name of the port.
        request: Its bytes.
        instruction: Its name.
        id: Addressed servo; 254 is broadcast.
        replies: Bytes put on the wire towards the host, after faults.
        faults: Injected faults.
        writes: Writes of the request.
        duration: From the first byte of the request to the last of the replies, on the wire [s].
    """

    time: float
    port: str
    request: bytes
    instruction: str
    id: int
    replies: tuple[bytes, ...]
    faults: tuple[str, ...]
    writes: tuple[Write, ...]
    duration: float


class Log:
    """The last transactions, oldest first; older ones are dropped but counted.

    Attributes:
        count: Transactions since the start.
        faulty: Transactions with an injected fault.
        watch: Called with every transaction as it ends, for runs longer than the log; in the
            emulator's thread.
    """

    def __init__(self, longest: int = 20_000) -> None:
        """Keep at most `longest` transactions, about 1.5 kB each with seven servos."""
        self._kept: deque[Transaction] = deque(maxlen=longest)
        self.count = 0
        self.faulty = 0
        self.watch: Callable[[Transaction], None] | None = None

    def __len__(self) -> int:
        return len(self._kept)

    def __iter__(self) -> Iterator[Transaction]:
        return iter(list(self._kept))

    def __getitem__(self, index: int) -> Transaction:
        return self._kept[index]

    def add(self, transaction: Transaction) -> None:
        """Append a transaction."""
        self._kept.append(transaction)
        self.count += 1
        self.faulty += bool(transaction.faults)
        if self.watch is not None:
            self.watch(transaction)

    def clear(self) -> None:
        """Clear the log and its counters."""
        self._kept.clear()
        self.count = self.faulty = 0

    def writes(
        self, register: str | None = None, id: int | None = None, *, refused: bool | None = None
    ) -> list[Write]:
        """Return writes in order, filtered.

        Args:
            register: Only those that touch this register.
            id: Only those to this servo.
            refused: Only refused (True) or only done ones (False).
        """
        return [
            write
            for transaction in list(self._kept)
            for write in transaction.writes
            if (id is None or write.id == id)
            and (refused is None or bool(write.error) == refused)
            and (register is None or register in write.values)
        ]

    def eeprom_writes(self) -> list[Write]:
        """Return writes to the EEPROM area; there should be none outside set-up."""
        return [write for write in self.writes() if write.eeprom]

    def goals_while_disabled(self) -> list[Write]:
        """Return goals written while torque was off: at most those of an enable sequence."""
        return [w for w in self.writes() if not w.enabled and GOALS & w.values.keys()]

    def order(self, id: int) -> list[str]:
        """Return `limit`, `goal`, `torque on` and `torque off` of a servo as they were done.

        A block that carries several counts them limit first: the servo takes it as one. Repetitions
        in a row are one entry.
        """
        steps: list[str] = []
        for write in self.writes(id=id, refused=False):
            values = write.values
            now = ["limit"] if LIMITS & values.keys() else []
            now += ["goal"] if GOALS & values.keys() else []
            if SWITCH in values:
                now.append("torque on" if values[SWITCH] == 1 else "torque off")
            for step in now:
                if not steps or steps[-1] != step:
                    steps.append(step)
        return steps

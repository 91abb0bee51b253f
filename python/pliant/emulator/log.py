"""Log of all bytes on the emulated bus, raw and decoded, for assertions after a run."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from pliant.emulator.control_tables import Table

#: Names of the registers with position goal, torque limit and torque switch, in all families.
GOALS = frozenset({"goal_position"})
LIMITS = frozenset({"torque_limit", "goal_current", "goal_pwm"})
SWITCH = "torque_enable"


@dataclass(frozen=True, slots=True)
class Write:
    """One write to one servo, accepted or rejected.

    Attributes:
        time: Emulated time of the write [s].
        id: Id of the servo at that time.
        instruction: `write`, `reg_write` (executed by ACTION), `sync_write` or `bulk_write`.
        address: Address of the first byte.
        data: The bytes written.
        enabled: True if torque was on before this write.
        error: 0 if the servo accepted the write, else the error code of its protocol, also if the
            servo does not reply to this instruction.
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
        """Values of completely written registers by name, in order of address."""
        values: dict[str, int] = {}
        for register in self._table.span(self.address, len(self.data)):
            start = register.address - self.address
            if start >= 0 and start + register.size <= len(self.data):
                values[register.name] = register.decode(self.data[start : start + register.size])
        return values

    @property
    def eeprom(self) -> bool:
        """True if the write includes a byte of EEPROM."""
        return any(r.area == "eeprom" for r in self._table.span(self.address, len(self.data)))


@dataclass(frozen=True, slots=True)
class Transaction:
    """Request from the host and the replies to it.

    Attributes:
        time: Emulator time of the request [s].
        port: Name of the port.
        request: Bytes of the request.
        instruction: Name of the instruction in the request.
        id: Id of the addressed servo; 254 is broadcast.
        replies: Bytes of each reply as sent to the host, after faults.
        faults: Kind of each fault, and id of the affected servo.
        writes: Writes to registers that the request caused, accepted or rejected.
        duration: Time on the wire from the first byte of the request to the last reply byte [s].
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
    """Log of the last transactions, oldest first; older ones are dropped but counted.

    Attributes:
        count: Number of transactions since the start or `clear`.
        faulty: Number of transactions with an injected or random fault.
        watch: Function that the emulator's thread calls with every completed transaction, for runs
            that exceed the capacity of the log; None: no call.
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
        """Append a transaction, count it, and pass it to `watch`."""
        self._kept.append(transaction)
        self.count += 1
        self.faulty += bool(transaction.faults)
        if self.watch is not None:
            self.watch(transaction)

    def clear(self) -> None:
        """Remove all transactions and set the counters to 0."""
        self._kept.clear()
        self.count = self.faulty = 0

    def writes(
        self, register: str | None = None, id: int | None = None, *, refused: bool | None = None
    ) -> list[Write]:
        """Return the logged register writes in order, filtered.

        Args:
            register: Return only writes that contain this register.
            id: Return only writes to this servo.
            refused: True returns only rejected writes, False only accepted ones.
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
        """Return the logged writes to EEPROM; a correct host makes none after set-up."""
        return [write for write in self.writes() if write.eeprom]

    def goals_while_disabled(self) -> list[Write]:
        """Return the writes of goals while torque was off, such as the goal before torque on."""
        return [w for w in self.writes() if not w.enabled and GOALS & w.values.keys()]

    def order(self, id: int) -> list[str]:
        """Return the order in which servo `id` accepted limits, goals and torque switches.

        Entries are `limit`, `goal`, `torque on` and `torque off`; consecutive equal entries are
        merged. A block write of several of these yields them in this order.
        """
        steps: list[str] = []
        for write in self.writes(id=id, refused=False):
            values = write.values
            entries = ["limit"] if LIMITS & values.keys() else []
            entries += ["goal"] if GOALS & values.keys() else []
            if SWITCH in values:
                entries.append("torque on" if values[SWITCH] == 1 else "torque off")
            for step in entries:
                if not steps or steps[-1] != step:
                    steps.append(step)
        return steps

"""Rules that must hold on a bus, checked in the bytes that an emulator receives."""

from __future__ import annotations

import time
from array import array
from collections import Counter
from typing import TYPE_CHECKING

import numpy as np

from pliant.emulator.log import GOALS, LIMITS, SWITCH
from pliant.emulator.packets import Framer

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pliant.emulator import ArmEmulator, Servo, Transaction, Write

    Array = NDArray[np.float64]

#: Register that bounds each limit register.
CEILING = {
    "torque_limit": ("max_torque", "max_torque_limit"),
    "goal_current": ("current_limit",),
    "goal_pwm": ("pwm_limit",),
}


class Audit:
    """Checks every transaction of an emulated arm: `emulator.log.watch = Audit(emulator)`.

    Args:
        bus: The emulator.
        machine: True: times are the machine's instead of the emulator's.

    Attributes:
        broken: Number of violations of each rule, by its name.
        faults: Number of faults of each kind.
        transactions: Number of transactions.
    """

    def __init__(self, bus: ArmEmulator, *, machine: bool) -> None:
        self._bus, self._machine = bus, machine
        self._servos = {servo.id: servo for servo in bus.servos}
        self._phase: dict[int, str] = dict.fromkeys(self._servos, "off")
        self._pending: set[int] = set()
        self._truth = array("d")
        self._limits: dict[int, array[int]] = {id: array("i") for id in self._servos}
        self.broken: Counter[str] = Counter()
        self.faults: Counter[str] = Counter()
        self.transactions = 0

    def __call__(self, seen: Transaction) -> None:
        """Process one transaction."""
        self.transactions += 1
        for fault in seen.faults:
            self.faults[fault.partition(" ")[0]] += 1
        if "read" in seen.instruction:
            now = time.perf_counter() if self._machine else seen.time
            self._truth.extend((now, *self._bus.plant.q))
        if seen.instruction == "sync_write":
            self._sent(seen.request)
        for write in seen.writes:
            self._written(write)

    def report(self) -> dict[str, dict[str, int]]:
        """Return violations, faults and transactions so far."""
        broken = Counter(self.broken)
        broken["goal without torque on after it"] += len(self._pending)
        return {
            "broken": {rule: count for rule, count in broken.items() if count},
            "faults": dict(self.faults),
            "log": {"transactions": self.transactions},
        }

    def truth(self) -> Array:
        """Return the true joint angles at every read: rows (time [s], q (n,) [rad])."""
        return np.array(self._truth).reshape(-1, 1 + self._bus.plant.n)

    def limits(self) -> dict[int, list[float]]:
        """Return the torque [N·m] of every limit in a sync write, by id, lost ones included."""
        return {id: [self.torque(id, v) for v in sent] for id, sent in self._limits.items()}

    def units(self) -> dict[int, float]:
        """Return the torque of one count of each servo's limit register [N·m], by id."""
        return {id: self.torque(id, 1) for id in self._servos}

    def torque(self, id: int, register: int) -> float:
        """Return the torque at standstill of a limit register [N·m], by the emulator's tables."""
        servo = self._servos[id]
        if "goal_current" in servo.table:
            return register * servo.model.unit * servo.model.motor.torque_per_amp
        full = {"dxl1": 1023, "sts": 1000, "x": 885}[servo.model.family]
        return servo.stall * register / full

    def _sent(self, request: bytes) -> None:
        """Read limits and ceilings from a sync write, also if servos did not receive it."""
        for frame in Framer().feed(request):
            wide = 2 if frame.protocol == 2 else 1
            start = int.from_bytes(frame.params[:wide], "little")
            size = int.from_bytes(frame.params[wide : 2 * wide], "little")
            rest = frame.params[2 * wide :]
            for at in range(0, len(rest), 1 + size):
                servo = self._servos[rest[at]]
                data = rest[at + 1 : at + 1 + size]
                name = limit_of(servo)
                register = servo.table[name]
                offset = register.address - start
                if offset >= 0 and offset + register.size <= size:
                    value = register.decode(data[offset : offset + register.size])
                    self._limits[servo.id].append(value)
                    self._below(servo, name, value)

    def _below(self, servo: Servo, name: str, value: int) -> None:
        ceiling = next(servo.get(top) for top in CEILING[name] if top in servo.table)
        self.broken["limit above the ceiling"] += value > ceiling or value < 0

    def _written(self, write: Write) -> None:
        """Check the order: limit, goal, torque; no EEPROM; no goal while torque is off."""
        self.broken["EEPROM written"] += write.eeprom
        self.broken["write refused"] += bool(write.error)
        values = write.values
        if not write.enabled and self._phase[write.id] == "on":
            self._phase[write.id] = "off"
        if LIMITS & values.keys() and self._phase[write.id] == "off":
            self._phase[write.id] = "limit"
        if GOALS & values.keys():
            if self._phase[write.id] == "off":
                self.broken["goal before limit"] += 1
            if not write.enabled:
                self._pending.add(write.id)
            if self._phase[write.id] == "limit":
                self._phase[write.id] = "goal"
        if SWITCH in values:
            self._switched(write, values[SWITCH])

    def _switched(self, write: Write, value: int) -> None:
        if value == 0:
            self._phase[write.id] = "off"
            return
        self.broken["torque before goal"] += self._phase[write.id] not in {"goal", "on"}
        self._phase[write.id] = "on"
        self._pending.discard(write.id)


def limit_of(servo: Servo) -> str:
    """Return the register that limits the torque of a servo."""
    return next(n for n in ("torque_limit", "goal_current", "goal_pwm") if n in servo.table)

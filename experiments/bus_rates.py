"""Read and write rates of seven emulated servos: ``python -m experiments.bus_rates [cycles]``.

A cycle is one read and one write of all servos. The program prints for each servo family the
cycles per second with and without emulated transmission times, their ratio to the rate that the
transmission times allow, and the processor share of the host that controls an arm at 100 Hz.
"""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import tyro

import pliant
from experiments import command_line, markdown
from experiments.emulated_arm import FAMILIES, configuration, emulator
from pliant.arm import Arm
from pliant.config import factory
from pliant.emulator import Device, Emulator, EmulatorProcess, Timing
from pliant.loop import Loop
from pliant.servo import ServoBus, ServoSpec, wire_time

#: Number of servos, baud rate [bit/s], and duration of the run that controls the arm [s].
SERVOS, BAUD, CONTROLLED = 7, 1_000_000, 10.0
#: Emulated servo model of each family.
MODELS = {"sts": "STS3215-12V", "x": "XM540-W270", "p1": "EX-106+"}


@dataclass(frozen=True, kw_only=True)
class Rate:
    """Durations of a cycle with one read and one write of all servos.

    Attributes:
        wire: Transmission time of a cycle on the bus [s], including the servos' response delays.
        median, late: Median and 99th percentile of the measured duration of a cycle [s].
    """

    wire: float
    median: float
    late: float

    @property
    def ratio(self) -> float:
        """Ratio of the measured rate to the rate that the wire time allows."""
        return self.wire / self.median


def wire(model: str) -> float:
    """Return the time that a cycle of `SERVOS` servos of a model takes on the bus [s]."""
    family = ServoSpec(name="a", model=model, id=1, port="").row.family
    size = family.read[0].size
    if family.sync_read:
        read_time = wire_time(family.protocol, "sync_read", SERVOS, size, baudrate=BAUD)
    else:
        read_time = SERVOS * wire_time(family.protocol, "read", 1, size, baudrate=BAUD)
    writes = [
        wire_time(
            family.protocol,
            "sync_write",
            SERVOS,
            sum(family.registers[name].size for name in names),
            baudrate=BAUD,
        )
        for names in family.write
    ]
    return read_time + sum(writes)


def measure(family: str, cycles: int, *, is_timed: bool) -> Rate:
    """Measure `cycles` cycles that run as fast as possible.

    The emulator runs in a separate process. `is_timed` is True if its replies take as long as the
    transmission on a real bus.
    """
    model = MODELS[family]
    registers: dict[str, Any] = {"operating_mode": 5} if family == "x" else {}
    devices = [Device(model, id, return_delay_time=0, **registers) for id in range(1, SERVOS + 1)]
    with EmulatorProcess(Emulator, devices, timing=Timing(wire=is_timed)) as bus:
        specs = [ServoSpec(name=f"j{d.id}", model=model, id=d.id, port=bus.port) for d in devices]
        with ServoBus(specs, baudrate=BAUD, reply_timeout_min=0.05) as chain:
            limit = 0.2 * np.asarray(chain.servos.max_torque)
            goal = chain.read().position
            chain.enable(goal, limit)
            times = []
            for _ in range(cycles):
                begin = time.perf_counter()
                chain.read()
                chain.write(goal, limit)
                times.append(time.perf_counter() - begin)
            chain.disable()
    return Rate(
        wire=wire(model), median=float(np.median(times)), late=float(np.quantile(times, 0.99))
    )


def share(family: str, seconds: float) -> float:
    """Return the CPU time over the wall time of this process while it controls `arm7` at 100 Hz.

    The arm has emulated servos of the family, and the loop runs for `seconds` [s].
    """
    arm_config = configuration(family)
    with EmulatorProcess(emulator, family) as bus:
        chain = ServoBus(factory.servo_specs(arm_config, bus.ports), reply_timeout_min=0.05)
        arm = Arm(arm_config.model(), chain, comm_timeout=5.0, handle_signals=False)
        with chain:
            arm.enable()
            controller = pliant.Controller(arm.model, pliant.Settings.soft("y"), arm.servos)
            target = arm.model.forward_kinematics(arm.read().q)
            cpu_start, begin = time.process_time(), time.perf_counter()
            for tick in Loop(arm, controller, rate=100.0, duration=seconds, max_step_time=5.0):
                tick.write(controller.step(tick.q, target, dt=tick.dt))
            out = (time.process_time() - cpu_start) / (time.perf_counter() - begin)
            arm.disable_torque()
    return out


def main(cycles: tyro.conf.Positional[int] = 1000) -> None:
    """Print the measured rates of all servo families as a table.

    Args:
        cycles: Number of cycles per measurement.
    """
    columns = (
        "7 servos, 1 Mbit/s",
        "wire [Hz]",
        "timed [Hz]",
        "of the wire",
        "99 % [ms]",
        "untimed [Hz]",
        "processor at 100 Hz",
    )
    print(markdown.head(columns))
    for family in FAMILIES:
        with_times = measure(family, cycles, is_timed=True)
        without_times = measure(family, cycles, is_timed=False)
        rates = [
            f"{1.0 / with_times.wire:.0f}",
            f"{1.0 / with_times.median:.0f}",
            f"{with_times.ratio:.0%}",
        ]
        rates += [f"{1e3 * with_times.late:.1f}", f"{1.0 / without_times.median:.0f}"]
        print(
            markdown.row((MODELS[family], *rates, f"{share(family, CONTROLLED):.0%}")), flush=True
        )
    print(f"load of the machine: {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")


if __name__ == "__main__":
    command_line.start(main)

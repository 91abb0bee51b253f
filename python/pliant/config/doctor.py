"""Diagnosis of a configuration and its hardware, with remedies; nothing is written to servos."""

from __future__ import annotations

import contextlib
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from pliant._core import ArmPoints, Controller, PliantError, ServoError
from pliant.arm._checks import check_rest, outside, posture, setting
from pliant.config import factory
from pliant.config._toml import toml_key
from pliant.config.schema import servos, zeros
from pliant.drive import MonotonicClock
from pliant.loop import LatenessHistogram
from pliant.servo import ServoBus, wire_time
from pliant.servo._port import latency_timer

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pliant._core import Model
    from pliant._typing import Array
    from pliant.config.schema import Config
    from pliant.servo._handshake import ServoInfo

Level = Literal["good", "note", "bad"]
#: Largest acceptable latency timer of an FTDI adapter [s].
MAX_LATENCY_TIMER = 0.0015
#: Number of timed readings of all joints.
CYCLES = 200
#: Duration of the test of the loop's clock [s].
CLOCK_TEST_TIME = 1.0
#: Largest acceptable 99.9th percentile of the lateness of control cycles, as a share of the control
#: period [1].
MAX_LATENESS = 0.2
#: Task axes of the check whether the servos can hold the arm; for n < 3 joints, the first n axes.
ANY_TASK = "xyz"


@dataclass(frozen=True)
class Diagnosis:
    """One finding of the diagnosis.

    Attributes:
        level: `good`, `note` (works, could be better), or `bad` (must be fixed).
        about: Part of the system that the finding concerns.
        text: Description of the finding and its remedy.
    """

    level: Level
    about: str
    text: str


def examine(config: Config) -> Iterator[Diagnosis]:
    """Yield the findings on files, ports, servos and this machine.

    After a `bad` finding, checks that depend on the faulty part are skipped.
    """
    try:
        model = config.model()
        zeros(config)
    except PliantError as error:
        yield Diagnosis("bad", "files", str(error))
        return
    yield Diagnosis("good", "files", f"{model.name}: {model.n} joints, {model.base} to {model.tip}")
    yield from _model(config, model)
    yield _clock(config.loop.rate)
    if config.backend == "sim":
        yield Diagnosis("note", "bus", "backend 'sim' has none")
        return
    try:
        drive = factory.make_drive(config, model)
    except (PliantError, ImportError) as error:
        yield Diagnosis("bad", "ports", str(error))
        return
    assert isinstance(drive, ServoBus)
    if config.backend == "bus":
        yield from _ports(drive)
    try:
        drive.open()
    except (ServoError, ImportError) as error:
        for line in str(error).splitlines():
            yield Diagnosis("bad", "servos", line)
        return
    try:
        yield from _servos(drive.found)
        yield from _gains(drive, config)
        yield from _sense(drive, model)
        yield _cycle(drive, config)
        yield from _other_servos(drive)
    finally:
        drive.close()


def _model(config: Config, model: Model) -> Iterator[Diagnosis]:
    """Check the rest pose, limits, settings and weight of the arm; report a missing calibration."""
    rest = config.life.rest_q
    if rest is None:
        yield Diagnosis(
            "note",
            "rest pose",
            "none: the arm is lowered straight down. Lay it down by hand: `pliant servos doctor "
            "ARM --watch` prints the line to paste",
        )
    else:
        try:
            pose = posture(model, rest, "life.rest_q")
            check_rest(model, ArmPoints(model), pose, config.robot.table)
        except PliantError as error:
            yield Diagnosis("bad", "rest pose", str(error))
    yield from _limits(model)
    if config.servo:
        yield from _controllable(config, model)
    if config.calibration is None and all(s.zero is None for s in config.servo.values()):
        yield Diagnosis(
            "note",
            "calibration",
            "every servo's middle counts as its joint's zero; name LeRobot's file in "
            "`calibration`, or give each servo its `zero`",
        )


def _limits(model: Model) -> Iterator[Diagnosis]:
    """Report joints without position limits, as `continuous` joints of a URDF are."""
    is_bounded = np.isfinite(model.lower) & np.isfinite(model.upper)
    names = [model.joint_names[i] for i in np.flatnonzero(~is_bounded)]
    if names:
        yield Diagnosis(
            "note",
            "limits",
            f"{', '.join(names)}: no position limits, so the controller and a check before torque "
            "comes on accept every position, also where the arm meets itself or pulls its cables. "
            f"Give `limits = {{ {toml_key(names[0])} = [LOWER, UPPER] }}` [rad] in [robot], or "
            "both `lower` and `upper` [rad] of the servo",
        )


def _controllable(config: Config, model: Model) -> Iterator[Diagnosis]:
    """Check that a `Controller` can be created: the task fits, and the servos can hold the arm."""
    settings = config.settings()
    try:
        Controller(model, settings)
    except PliantError as error:
        if not setting(error).startswith("task."):
            yield Diagnosis("bad", "model", str(error))
            return
        yield Diagnosis(
            "note", "settings", f"{error}; `pliant run` needs `task` in [settings] of the file"
        )
        # Use a valid task, so that the check whether the servos hold the arm still runs.
        with contextlib.suppress(PliantError):
            settings = settings.replace(task=ANY_TASK[: model.n])
        try:
            Controller(model, settings)
        except PliantError as worse:
            yield Diagnosis("bad", "model", str(worse))


def _clock(rate: float) -> Diagnosis:
    """Measure how late this machine wakes up from waits for periodic deadlines at `rate` [Hz]."""
    clock, lateness, period = MonotonicClock(), LatenessHistogram(), 1.0 / rate
    deadline = clock.now()
    end = deadline + CLOCK_TEST_TIME
    while deadline < end:
        deadline += period
        clock.wait_until(deadline)
        lateness.add(clock.now() - deadline)
    worst, median = lateness.percentile(99.9), lateness.percentile(50.0)
    text = f"wakes {median * 1e6:.0f} µs late, at most {worst * 1e3:.2f} ms, at {rate:g} Hz"
    if worst > MAX_LATENESS * period:
        return Diagnosis(
            "note", "loop", f"{text}: other programs use the CPU; close them, or lower [loop] rate"
        )
    return Diagnosis("good", "loop", text)


def _ports(chain: ServoBus) -> Iterator[Diagnosis]:
    """Report USB adapters whose latency timer exceeds `MAX_LATENCY_TIMER`."""
    for path in dict.fromkeys(spec.port for spec in chain.specs):
        if not Path(path).exists() or not os.access(path, os.R_OK | os.W_OK):
            continue  # opening the port raises the error for this, with the remedy
        timer = latency_timer(path)
        if timer is not None and timer > MAX_LATENCY_TIMER:
            name = Path(path).resolve().name
            yield Diagnosis(
                "bad",
                "adapter",
                f"{path} delays replies by {timer * 1e3:.0f} ms, so the arm reacts late and sinks "
                f"more as torque comes on: echo 1 | sudo tee "
                f"/sys/bus/usb-serial/devices/{name}/latency_timer (a udev rule makes it last)",
            )


def _servos(infos: tuple[ServoInfo, ...]) -> Iterator[Diagnosis]:
    """Report the servos that replied, their notes, and differences of firmware within a model."""
    volts = [f.voltage for f in infos]
    yield Diagnosis(
        "good",
        "servos",
        f"{len(infos)} answer: {', '.join(sorted({f.model for f in infos}))}, "
        f"{min(volts):.1f} to {max(volts):.1f} V",
    )
    firmware: dict[str, set[int]] = {}
    notes: dict[str, dict[str, None]] = {}
    for info in infos:
        firmware.setdefault(info.model, set()).add(info.firmware)
        for note in info.notes:
            notes.setdefault(note, {})[info.joint] = None
    for note, joints in notes.items():
        yield Diagnosis("note", ", ".join(joints), note)
    for model, versions in firmware.items():
        if len(versions) > 1:
            message = ", ".join(map(str, sorted(versions)))
            yield Diagnosis(
                "note", model, f"firmware differs among them ({message}): update all alike"
            )


def _other_servos(chain: ServoBus) -> Iterator[Diagnosis]:
    """Report servos that no joint of the file has: without torque, their joints would fall."""
    for path, ids in chain.other_ids().items():
        if ids:
            yield Diagnosis(
                "note",
                "ids",
                f"{', '.join(map(str, ids))} on {path}: servos that the file does not name, so "
                "they stay without torque. They are of another arm, or a joint has the wrong id in "
                "the file: compare with `pliant servos doctor ARM --watch`",
            )


def _gains(chain: ServoBus, config: Config) -> Iterator[Diagnosis]:
    """Report servos whose P gain register differs from `gain` in the configuration file."""
    gains = chain.gains
    for joint, servo in servos(config).items():
        if servo.gain is not None and gains[joint] != servo.gain:
            yield Diagnosis(
                "note",
                joint,
                f"its P gain is {gains[joint]}, the file says {servo.gain}: the controller uses "
                f"the servo's value, and the simulator takes it from `gain = {gains[joint]}` in "
                "[servo]",
            )


def _sense(chain: ServoBus, model: Model) -> Iterator[Diagnosis]:
    """Report joints that are outside their limits, and servos whose torque may not come on."""
    position = dict(zip(chain.names, chain.read().position.tolist(), strict=True))
    for name, q, low, high in outside(model, np.array([position[j] for j in model.joint_names])):
        yield Diagnosis(
            "bad",
            name,
            f"stands at {q:.2f} rad, outside its {low:.2f} to {high:.2f}: its zero, sign or "
            "gear in the file is wrong, or it is not calibrated",
        )
    for name, text in chain.enable_errors.items():
        yield Diagnosis("bad", name, text)


def time_readings(chain: ServoBus) -> tuple[Array, int]:
    """Read all joints `CYCLES` times; return the durations [s] and the number of lost replies."""
    times, timeouts_before = np.zeros(CYCLES), chain.counters["timeouts"]
    for i in range(CYCLES):
        begin = time.perf_counter()
        chain.read()
        times[i] = time.perf_counter() - begin
    return times, chain.counters["timeouts"] - timeouts_before


def wire_read_time(chain: ServoBus, baudrate: int) -> float:
    """Return the transmission time of the bytes of one reading of all joints [s]."""
    family = chain.specs[0].row.family
    servos = sum(len(spec.servos) for spec in chain.specs)
    return wire_time(
        family.protocol,
        "sync_read" if family.sync_read else "read",
        servos if family.sync_read else 1,
        family.read[0].size,
        baudrate=baudrate,
    ) * (1 if family.sync_read else servos)


def _cycle(chain: ServoBus, config: Config) -> Diagnosis:
    """Measure the time to read all joints; compare it with the transmission time of the bytes."""
    times, lost = time_readings(chain)
    median, worst = float(np.median(times)), float(np.quantile(times, 0.99))
    bare = wire_read_time(chain, config.port[0].baud)
    text = (
        f"reading takes {median * 1e3:.2f} ms, 99 %: {worst * 1e3:.2f} ms; the wire alone "
        f"{bare * 1e3:.2f} ms"
    )
    if lost:
        return Diagnosis(
            "bad", "bus", f"{lost} of {CYCLES} readings lost; {text}: check the cables"
        )
    if worst > 0.7 / config.loop.rate:
        if median <= 0.7 / config.loop.rate:
            remedy = "other programs delay some readings: close them"
        elif bare > 0.5 * median:
            remedy = (
                f"set the servos to more than {config.port[0].baud} bit/s, and `baud` in [[port]] "
                "with them"
            )
        else:
            remedy = "set the latency timer of the adapter to 1 ms"
        return Diagnosis(
            "bad",
            "bus",
            f"{text}: too slow for {config.loop.rate:g} Hz. The arm may sink by centimetres as "
            f"torque comes on, and reacts late: {remedy}, or lower [loop] rate",
        )
    return Diagnosis("good", "bus", text)

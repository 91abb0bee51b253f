"""Processor time, calls and memory of one control cycle (tick), by stage.

    make tick                                       all rigs
    make tick ARGS='--rigs null,so101 --rounds 3'   some of them
    make tick ARGS='--profile so101'                functions of one rig by processor time
    make tick ARGS='--lateness 10'                  lateness at 200 Hz, with scheduling options

A tick is one turn of `pliant.Loop` with `Arm.read`, `Controller.step` and `Arm.write`, at 100 Hz.
Rigs: `null`, a drive that does nothing on a clock that does not wait; `sim`, the simulator, whose
physics is computed in the wait; and the bytes of an emulated arm of each servo family, with the
emulator in another process: `so101` (Feetech STS), `koch` (Dynamixel X), `arm7` (Dynamixel
Protocol 1.0, one request per servo).

In the same run, rustypot repeats on the same open port the requests that pliant has just made,
without pliant. The vendor's SDK, and LeRobot's bus class where it is installed, make one sync read
and one sync write per tick on a port of their own. LeRobot's reads positions and writes goals in
degrees.

Times are processor times of the thread that runs the loop. Other programs influence them through
caches only. Stages are timed in blocks of their own, because their timers cost time too.
"""

from __future__ import annotations

import argparse
import cProfile
import ctypes
import gc
import os
import platform
import pstats
import subprocess
import sys
import threading
import time
import tracemalloc
from collections import defaultdict
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

import pliant
from pliant import config
from pliant.config.factory import make_emulator
from pliant.drive import JointReadings, MonotonicClock
from pliant.emulator import EmulatorProcess
from pliant.log import Recorder
from pliant.loop import LatenessHistogram

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    #: Requests of a tick: methods of a transport, or of rustypot, with their arguments.
    Requests = list[tuple[Callable[..., Any], tuple[Any, ...]]]

RATE = 100.0
BYTES = ("so101", "koch", "arm7")
RIGS = ("null", "sim", *BYTES)
#: Counted ticks of a block, and ticks before them, in which the controller is reset.
BLOCK, WARM = 100, 20
#: Stages of a tick in the order of the table.
STAGES = {
    "wait": "wait for the deadline",
    "loop": "loop, `Tick.step`",
    "read": "`Arm.read`: checks, thermal model, state",
    "decode": "drive: decode",
    "read bytes": "drive: transactions of the reading; so101: with decode",
    "step": "`Controller.step`",
    "write": "`Arm.write`: checks, budgets, ramp",
    "encode": "drive: encode",
    "write bytes": "drive: transaction of the goals; so101: with encode",
    "status": "drive: status of one servo",
    "status bytes": "drive: transaction of the status",
}
#: Stage to which the transactions (of rustypot) belong that another stage makes.
TRANSACTIONS = {"decode": "read bytes", "encode": "write bytes", "status": "status bytes"}
#: Methods of rustypot.
SYNC_READ, SYNC_WRITE = "sync_read_raw_data_with_error", "sync_write_raw_data"
#: Methods of a transport that make the transactions of a tick, and rustypot's for the same.
CALLS = {
    "read": "read_raw_data_with_error",
    "sync_read": SYNC_READ,
    "sync_write": SYNC_WRITE,
    "write": "write_raw_data_with_error",
}


class NullClock:
    """Clock that does not wait: its time is the last deadline."""

    def __init__(self) -> None:
        self._time = 0.0

    def now(self) -> float:
        """Return the last deadline [s]."""
        return self._time

    def wait_until(self, deadline: float) -> None:
        """Set the time to `deadline` [s]."""
        self._time = max(self._time, deadline)


class NullDrive:
    """Drive whose joints stand still; it reports positions only."""

    def __init__(self, model: pliant.Model, servos: pliant.Servos, q: Any) -> None:
        self.names, self.servos, self.clock = model.joint_names, servos, NullClock()
        self.counters: dict[str, int] = {}
        self._position, self._ok = np.array(q), np.ones(model.n, dtype=bool)

    def read(self) -> JointReadings:
        """Return the positions, with the present time."""
        return JointReadings(self._position, self._ok, self.clock.now())

    def write(self, goal: Any, limit: Any, velocity: Any = None) -> None:
        """Do nothing."""

    enable = write

    def _nothing(self, *_: Any) -> None:
        """Do nothing."""

    open = close = poll_status = disable = watchdog = _nothing


@dataclass
class Sum:
    """Processor times summed over ticks.

    Attributes:
        ticks: Number of ticks.
        thread, process: Processor time of the thread that runs the loop, and of the process [s].
        stages: Processor time of the thread by stage [s].
    """

    ticks: int = 0
    thread: float = 0.0
    process: float = 0.0
    stages: dict[str, float] = field(default_factory=lambda: defaultdict(float))

    def add(self, started: tuple[float, float], ticks: int) -> None:
        """Add ticks since `started`, thread time and process time at their start [s]."""
        self.thread += time.thread_time() - started[0]
        self.process += time.process_time() - started[1]
        self.ticks += ticks

    def per_tick(self, seconds: float) -> float:
        """Return a sum of times as time per tick [µs]."""
        return 1e6 * seconds / max(self.ticks, 1)


def clocks() -> tuple[float, float]:
    """Return processor time of this thread and of the process [s]."""
    return time.thread_time(), time.process_time()


class StageTimer:
    """Timer of the stages; the time of a stage excludes that of the stages that it calls.

    Args:
        sums: Processor time by stage [s], to which the timer adds.
    """

    def __init__(self, sums: dict[str, float]) -> None:
        self._sums, self._stack, self._since = sums, ["loop"], 0.0
        self.on = False

    def start(self) -> None:
        """Count the time from now on."""
        self.on, self._since = True, time.thread_time()

    def stop(self) -> None:
        """Count the time up to now, and no further."""
        self._add()
        self.on = False

    def _add(self) -> None:
        now = time.thread_time()
        self._sums[self._stack[-1]] += now - self._since
        self._since = now

    def timed(self, call: Callable[..., Any], stage: str) -> Callable[..., Any]:
        """Return `call` with its time counted as `stage`; stage `bytes` depends on the caller."""

        def run(*args: Any, **kwargs: Any) -> Any:
            if not self.on:
                return call(*args, **kwargs)
            self._add()
            top = self._stack[-1]
            # A transaction that makes another one, after a failure, belongs to the same stage.
            self._stack.append(TRANSACTIONS.get(top, top) if stage == "bytes" else stage)
            try:
                return call(*args, **kwargs)
            finally:
                self._add()
                self._stack.pop()

        return run


class Wrapped:
    """Object with the attributes of `inner`, except those in `replaced`."""

    def __init__(self, inner: Any, replaced: dict[str, Callable[..., Any]]) -> None:
        self._inner = inner
        self.__dict__.update(replaced)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)


class Rig:
    """An enabled arm with its controller, and blocks of ticks to measure on it."""

    def __init__(self, name: str, arm: pliant.Arm, settings: pliant.Settings) -> None:
        self.name, self.arm = name, arm
        self.controller: Any = pliant.Controller(arm.model, settings, arm.servos)
        self.target = arm.model.forward_kinematics(arm.read().q)
        self.whole, self.staged, self.logged, self.bare = Sum(), Sum(), Sum(), Sum()
        self.vendor: Sum | None = None
        self.lerobot: Sum | None = None
        #: Requests of rustypot in the last tick of `replay`.
        self.last: Requests = []
        self.lateness = LatenessHistogram()
        self.requests = 0.0
        self.calls = self.python_calls = self.memory = 0.0

    @property
    def ports(self) -> list[Any]:
        """The ports of the servo bus; empty for a drive without ports."""
        return getattr(self.arm.drive, "_ports", [])

    @property
    def groups(self) -> list[tuple[Any, Any]]:
        """Groups of servos whose requests the core makes, with their transport."""
        return [
            (group, port.guard._io)
            for port in self.ports
            for group in (*port._read_groups, *port._write_groups)
            if group.core is not None
        ]

    def ticks(
        self,
        start: Callable[[], None],
        end: Callable[[], None],
        *,
        each: Callable[[], None] | None = None,
        recorder: Any = None,
    ) -> None:
        """Run a new loop: `WARM` ticks, `start()`, `BLOCK` ticks, `end()`.

        `each()` is called after each tick of the block.
        """
        loop = pliant.Loop(self.arm, self.controller, rate=RATE, recorder=recorder)
        turns = iter(loop)
        for tick in turns:
            tick.step(self.target)
            if each is not None and tick.index > WARM:
                each()
            if tick.index == WARM:
                start()
            elif tick.index == WARM + BLOCK:
                end()
                break
        self.lateness.add_all(loop.lateness)
        turns.close()  # type: ignore[attr-defined]

    def measure(self, sums: Sum, *, recorder: Any = None) -> None:
        """Add the times of a block to `sums`, without any instrument in it."""
        started = (0.0, 0.0)
        requests = 0

        def start() -> None:
            nonlocal started, requests
            requests, started = self.arm.counters.get("transactions", 0), clocks()

        def end() -> None:
            sums.add(started, BLOCK)
            self.requests = (self.arm.counters.get("transactions", 0) - requests) / BLOCK

        self.ticks(start, end, recorder=recorder)

    def renew(self) -> None:
        """Make a new controller, which has made no step, as a recorder needs it."""
        controller = self.controller
        self.controller = pliant.Controller(controller.model, controller.settings, self.arm.servos)

    def measure_stages(self) -> None:
        """Add the times of a block by stage."""
        timer = StageTimer(self.staged.stages)

        def end() -> None:
            timer.stop()
            self.staged.ticks += BLOCK

        with self._instrumented(timer.timed):
            self.ticks(timer.start, end)

    def replay(self) -> None:
        """Add the times of a block in which rustypot alone repeats the requests of pliant's ticks.

        The requests of a block of pliant's ticks are recorded first. Between the ticks the thread
        sleeps without a busy wait.
        """
        ticks: list[Requests] = []

        def recorded(call: Callable[..., Any], stage: str) -> Callable[..., Any]:
            def run(*args: Any, **kwargs: Any) -> Any:
                if ticks and stage == "bytes":
                    ticks[-1].append((call, args))
                return call(*args, **kwargs)

            return run

        def note() -> None:
            ticks.append([])

        with self._instrumented(recorded), self._groups_in_python(recorded):
            self.ticks(note, lambda: None, each=note)
        converted = [
            [self.of_rustypot(call, args) for call, args in tick] for tick in ticks[:BLOCK]
        ]
        deadline = time.perf_counter()
        started = clocks()
        for requests in converted:
            deadline += 1.0 / RATE
            time.sleep(max(deadline - time.perf_counter(), 0.0))
            for call, args in requests:
                call(*args)
        self.bare.add(started, BLOCK)
        self.last = converted[-1]

    def of_rustypot(self, call: Callable[..., Any], args: tuple[Any, ...]) -> Any:
        """Return the method of rustypot and its arguments for a recorded request."""
        owner: Any = call.__self__  # type: ignore[attr-defined]
        for group, transport in self.groups:
            if owner is not group.core:
                continue
            if call.__name__ == "read":
                return getattr(transport._io, SYNC_READ), (list(group.ids), *args[0])
            # Families with a codec write one block.
            blocks, _, *command = args
            rows = group.devices[0].codec.encode(group.indices, *command)[3]
            data = [list(row) for row in rows]
            return getattr(transport._io, SYNC_WRITE), (list(group.ids), blocks[0].address, data)
        convert = {
            "write": lambda id, address, data: (id, address, list(data)),
            "sync_read": lambda ids, address, size: (list(ids), address, size),
            "sync_write": lambda ids, address, data: (
                list(ids),
                address,
                [list(row) for row in data],
            ),
        }.get(call.__name__, lambda *rest: rest)
        return getattr(owner._io, CALLS[call.__name__]), convert(*args)

    def count(self) -> None:
        """Count the function calls of each tick, and measure its peak memory [bytes].

        The results are medians over a block of ticks, without the wait for the deadline.
        """
        ticks: list[dict[str, int]] = []

        def hook(_: Any, event: str, __: Any) -> None:
            if event in ticks[-1]:
                ticks[-1][event] += 1

        wait = self.arm.clock.wait_until

        def pause(deadline: float) -> None:
            sys.setprofile(None)
            wait(deadline)
            if counting:
                ticks.append({"call": 0, "c_call": 0})
                sys.setprofile(hook)

        counting = False

        def start() -> None:
            nonlocal counting
            counting = True

        def end() -> None:
            nonlocal counting
            sys.setprofile(None)
            counting = False

        with replaced(self.arm.clock, "wait_until", pause):
            self.ticks(start, end)
        self.python_calls = float(np.median([tick["call"] for tick in ticks]))
        self.calls = float(np.median([sum(tick.values()) for tick in ticks]))
        peaks: list[float] = []

        def clear(deadline: float) -> None:
            wait(deadline)
            if tracemalloc.is_tracing():
                tracemalloc.reset_peak()
                peaks.append(-tracemalloc.get_traced_memory()[0])

        def look() -> None:
            peaks[-1] += tracemalloc.get_traced_memory()[1]

        tracemalloc.start()
        try:
            with replaced(self.arm.clock, "wait_until", clear):
                self.ticks(lambda: None, lambda: None, each=look)
        finally:
            tracemalloc.stop()
        self.memory = float(np.median(peaks[-BLOCK:]))

    @contextmanager
    def _instrumented(self, timed: Callable[[Any, str], Callable[..., Any]]) -> Iterator[None]:
        """Replace the functions at the borders of the stages by `timed(function, stage)`."""
        arm, drive = self.arm, self.arm.drive
        borders = (
            (arm.clock, "wait_until", "wait"),
            (arm, "read", "read"),
            (arm, "write", "write"),
            (drive, "read", "read bytes" if self.groups else "decode"),
            (drive, "write", "write bytes" if self.groups else "encode"),
            (drive, "poll_status", "status"),
        )
        with ExitStack() as stack:
            for owner, name, stage in borders:
                stack.enter_context(replaced(owner, name, timed(getattr(owner, name), stage)))
            step = {"step": timed(self.controller.step, "step")}
            stack.enter_context(replaced(self, "controller", Wrapped(self.controller, step)))
            for port in self.ports:
                io = port.guard._io
                calls = {name: timed(getattr(io, name), "bytes") for name in CALLS}
                stack.enter_context(replaced(port.guard, "_io", Wrapped(io, calls)))
            yield

    @contextmanager
    def _groups_in_python(self, timed: Callable[[Any, str], Callable[..., Any]]) -> Iterator[None]:
        """Let Python make the requests of `groups`, by `timed(function, "bytes")`."""
        if not self.groups:
            yield
            return
        drive: Any = self.arm.drive
        with ExitStack() as stack:
            for port in self.ports:
                stack.enter_context(replaced(port, "start_usual_writes", lambda *_: None))
            for group, _ in self.groups:
                core = group.core
                calls = {name: timed(getattr(core, name), "bytes") for name in ("read", "write")}
                stack.enter_context(replaced(group, "core", Wrapped(core, calls)))
            drive.end_cycles()
            yield
        drive._start_usual_cycles()


@contextmanager
def replaced(owner: Any, name: str, value: Any) -> Iterator[None]:
    """Return a context in which the attribute `name` of an object has another value."""
    before = owner.__dict__.get(name)
    setattr(owner, name, value)
    try:
        yield
    finally:
        if before is None:
            delattr(owner, name)
        else:
            setattr(owner, name, before)


@contextmanager
def opened(name: str, *, real_time: bool = False) -> Iterator[Rig]:
    """Return a context with a rig; its torque is switched off at the end.

    With `real_time`, the rig `null` waits for its deadlines.
    """
    if name == "null":
        model = pliant.robots.arm7()
        assert model.servos is not None
        drive: Any = NullDrive(model, model.servos, np.full(model.n, -0.3))
        if real_time:
            drive.clock = MonotonicClock()
        arm, settings = pliant.Arm(model, drive), pliant.Settings.soft("y")
    else:
        backend: Any = "sim" if name == "sim" else "emulator"
        arm = pliant.connect("so101" if name == "sim" else name, backend=backend)
        settings = config.load("so101" if name == "sim" else name).settings()
    arm.enable()
    try:
        yield Rig(name, arm, settings)
    finally:
        arm.disable_torque()
        arm.close()


def sdk(name: str) -> tuple[Any, int] | None:
    """Return the vendor's Python SDK for the servos of an arm, and the number of its protocol.

    Returns None if the SDK has no group sync read for these servos.
    """
    if name == "so101":
        import scservo_sdk

        return scservo_sdk, 0
    if name == "koch":
        import dynamixel_sdk

        return dynamixel_sdk, 2
    return None


def vendor(name: str, requests: Requests, rounds: int) -> Sum | None:
    """Time a group sync read and a group sync write per tick by the vendor's SDK.

    Args:
        name: Name of the arm.
        requests: Requests of one tick; the SDK makes those that are sync requests.
        rounds: Number of blocks.

    Returns:
        Processor times; None without an SDK for the servos of this arm.
    """
    found = sdk(name)
    if found is None:
        return None
    module, protocol = found
    reads, address, size = next(args for call, args in requests if call.__name__ == SYNC_READ)
    ids, start, data = next(args for call, args in requests if call.__name__ == SYNC_WRITE)
    total = Sum()
    with EmulatorProcess(make_emulator, config.load(name)) as emulator:
        port, packets = module.PortHandler(emulator.port), module.PacketHandler(protocol)
        port.setBaudRate(1_000_000)
        read = module.GroupSyncRead(port, packets, address, size)
        for id in reads:
            read.addParam(id)
        for _ in range(rounds):
            deadline, started = time.perf_counter(), clocks()
            for _ in range(BLOCK):
                deadline += 1.0 / RATE
                time.sleep(max(deadline - time.perf_counter(), 0.0))
                while read.txRxPacket() != 0:
                    time.sleep(0.05)  # a late reply on a busy machine
                [read.getData(id, address, 2) for id in reads]
                write = module.GroupSyncWrite(port, packets, start, len(data[0]))
                for id, values in zip(ids, data, strict=True):
                    write.addParam(id, values)
                assert write.txPacket() == 0
            total.add(started, BLOCK)
        port.closePort()
    return total


def lerobot(name: str, specs: Sequence[Any], rounds: int) -> Sum | None:
    """Time one `sync_read` and one `sync_write` per tick of LeRobot's bus class.

    Args:
        name: Name of the arm.
        specs: Joints and their servos.
        rounds: Number of blocks.

    Returns:
        Processor times; None without LeRobot, or if it has no bus class for this arm.
    """
    try:
        from lerobot.motors import Motor, MotorCalibration, MotorNormMode
        from lerobot.motors.dynamixel import DynamixelMotorsBus
        from lerobot.motors.feetech import FeetechMotorsBus
    except ImportError:
        return None
    kind = {"so101": FeetechMotorsBus, "koch": DynamixelMotorsBus}.get(name)
    if kind is None:
        return None
    motors, calibration = {}, {}
    for spec in specs:
        model = spec.row.family.name if name == "so101" else spec.model.removesuffix("-T")
        motors[spec.name] = Motor(spec.id, model.lower(), MotorNormMode.DEGREES)
        calibration[spec.name] = MotorCalibration(spec.id, 0, 0, 0, 4095)
    total = Sum()
    with EmulatorProcess(make_emulator, config.load(name)) as emulator:
        bus = kind(emulator.port, motors, calibration)
        bus.connect(handshake=False)
        goals = bus.sync_read("Present_Position", num_retry=5)
        for _ in range(rounds):
            deadline, started = time.perf_counter(), clocks()
            for _ in range(BLOCK):
                deadline += 1.0 / RATE
                time.sleep(max(deadline - time.perf_counter(), 0.0))
                bus.sync_read("Present_Position", num_retry=5)
                bus.sync_write("Goal_Position", goals)
            total.add(started, BLOCK)
        bus.disconnect(disable_torque=False)
    return total


def run(names: Sequence[str], rounds: int) -> list[Rig]:
    """Measure the rigs `names` in rounds of blocks of each kind, and return them."""
    rigs = []
    for name in names:
        with opened(name) as rig, TemporaryDirectory() as folder:
            for turn in range(rounds):
                rig.measure(rig.whole)
                rig.measure_stages()
                if rig.ports:
                    rig.replay()
                rig.renew()
                rig.measure(rig.logged, recorder=Recorder(Path(folder) / f"{turn}.mcap"))
            rig.count()
        if rig.last:
            rig.vendor = vendor(name, rig.last, rounds)
            rig.lerobot = lerobot(name, rig.arm.drive.specs, rounds)
        rigs.append(rig)
        print(f"   {name}: {rig.whole.per_tick(rig.whole.thread):.0f} µs", file=sys.stderr)
    return rigs


def report(rigs: Sequence[Rig]) -> str:
    """Return the table of the rigs in Markdown."""

    def row(title: str, value: Callable[[Rig], str]) -> str:
        return f"| {title} | " + " | ".join(value(rig) for rig in rigs) + " |"

    def mean(sums: Sum | None) -> str:
        return f"{sums.per_tick(sums.thread):.0f}" if sums is not None and sums.ticks else ""

    def stage(name: str) -> Callable[[Rig], str]:
        def value(rig: Rig) -> str:
            seconds = rig.staged.stages.get(name)
            return "" if seconds is None else f"{rig.staged.per_tick(seconds):.1f}"

        return value

    def ratio(rig: Rig) -> str:
        return f"{rig.whole.thread / rig.bare.thread:.2f}" if rig.bare.ticks else ""

    def late(rig: Rig) -> str:
        if not getattr(rig.arm.clock, "real_time", False):
            return ""
        return " / ".join(f"{1e6 * rig.lateness.percentile(p):.0f}" for p in (50.0, 99.0))

    lines = [
        row("per tick", lambda rig: rig.name),
        "|---|" + "---:|" * len(rigs),
        row("**processor time of the thread [µs]**", lambda rig: mean(rig.whole)),
        row("of the process [µs]", lambda rig: f"{rig.whole.per_tick(rig.whole.process):.0f}"),
        row("thread, with a recorder [µs]", lambda rig: mean(rig.logged)),
        row("rustypot alone, same requests [µs]", lambda rig: mean(rig.bare)),
        row("pliant / rustypot alone", ratio),
        row("vendor's SDK, sync read and write only [µs]", lambda rig: mean(rig.vendor)),
        row(
            "LeRobot's bus class, sync read and write only [µs]"
            + ("" if find_spec("lerobot") else " (skipped: not installed)"),
            lambda rig: mean(rig.lerobot),
        ),
        *(row(f"{title} [µs]", stage(name)) for name, title in STAGES.items()),
        row("requests", lambda rig: f"{rig.requests:.2f}"),
        row("calls of functions", lambda rig: f"{rig.calls:.0f}"),
        row("of which written in Python", lambda rig: f"{rig.python_calls:.0f}"),
        row("largest memory held within a tick [kB]", lambda rig: f"{rig.memory / 1000:.1f}"),
        row("lateness, median / p99 [µs]", late),
    ]
    return "\n".join(lines)


def profile(name: str, rows: int) -> None:
    """Print the functions of a rig by processor time."""
    profiler = cProfile.Profile(time.thread_time)
    with opened(name) as rig:
        rig.ticks(profiler.enable, profiler.disable)
    pstats.Stats(profiler).sort_stats("tottime").print_stats(rows)


def _lock_memory() -> None:
    """Keep all memory of the process in RAM (`mlockall`), now and in future."""
    if ctypes.CDLL(None, use_errno=True).mlockall(3) != 0:
        raise OSError(ctypes.get_errno(), "mlockall")


def _scheduled(policy: int, priority: int) -> Callable[[], None]:
    return lambda: os.sched_setscheduler(0, policy, os.sched_param(priority))


class Policy:
    """Thread that computes like a policy at 30 Hz: 15 ms of Python and NumPy at a time."""

    def __init__(self) -> None:
        self._stop = threading.Event()

    def start(self) -> None:
        """Start the thread."""
        self._stop.clear()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Stop the thread."""
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        matrix = np.ones((128, 128))
        while not self._stop.wait(1.0 / 30.0 - 0.015):
            end = time.perf_counter() + 0.015
            while time.perf_counter() < end:
                sum(range(1000))
                matrix @ matrix


def lateness(seconds: float, *, load: int) -> str:
    """Return a table of the lateness of ticks at 200 Hz, for scheduling options of the process.

    The rig is `null` in real time. The options take turns, in blocks of 2 s, also with a recorder
    and with a thread that computes.

    Args:
        seconds: Time per option [s].
        load: Number of busy processes beside the loop.
    """
    policy = Policy()
    options: dict[str, tuple[Callable[[], object], Callable[[], object]]] = {
        "as started": (lambda: None, lambda: None),
        "recorder and policy thread": (policy.start, policy.end),
        "garbage collector off": (gc.disable, gc.enable),
        "nice -10": (lambda: os.nice(-10), lambda: os.nice(10)),
        "SCHED_FIFO": (_scheduled(os.SCHED_FIFO, 10), _scheduled(os.SCHED_OTHER, 0)),
        "SCHED_FIFO, recorder": (
            _scheduled(os.SCHED_FIFO, 10),
            _scheduled(os.SCHED_OTHER, 0),
        ),
        "SCHED_FIFO, recorder and policy thread": (
            lambda: (policy.start(), _scheduled(os.SCHED_FIFO, 10)()),
            lambda: (_scheduled(os.SCHED_OTHER, 0)(), policy.end()),
        ),
        "SCHED_FIFO, memory locked, collector off": (
            lambda: (_scheduled(os.SCHED_FIFO, 10)(), _lock_memory(), gc.disable()),
            lambda: (_scheduled(os.SCHED_OTHER, 0)(), gc.enable(), ctypes.CDLL(None).munlockall()),
        ),
    }
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(load)]
    found = {name: LatenessHistogram() for name in options}
    try:
        with opened("null", real_time=True) as rig, TemporaryDirectory() as folder:
            turns = product(range(round(seconds / 2.0)), options.items())
            for turn, (name, (start, end)) in turns:
                recorder = None
                if "recorder" in name:
                    rig.renew()
                    recorder = Recorder(Path(folder) / f"{name} {turn}.mcap")
                start()
                loop = pliant.Loop(
                    rig.arm, rig.controller, rate=200.0, duration=2.0, recorder=recorder
                )
                for tick in loop:
                    tick.step(rig.target)
                end()
                found[name].add_all(loop.lateness)
    finally:
        for process in busy:
            process.kill()
    rows = [
        f"| {name} | "
        + " | ".join(f"{1e6 * histogram.percentile(p):.0f}" for p in (50.0, 99.0, 99.9))
        + f" | {1e6 * histogram.largest:.0f} |"
        for name, histogram in found.items()
    ]
    head = ["| lateness [µs] | median | p99 | p99.9 | largest |", "|---|---:|---:|---:|---:|"]
    return "\n".join([*head, *rows])


def main() -> None:
    """Measure the rigs and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rigs", default=",".join(RIGS), help="rigs, comma-separated")
    parser.add_argument("--rounds", type=int, default=5, help="number of blocks of each kind")
    parser.add_argument("--profile", metavar="RIG", help="print the functions of a rig instead")
    parser.add_argument("--lateness", type=float, metavar="SECONDS", help="time per option")
    parser.add_argument("--load", type=int, default=0, help="busy processes beside --lateness")
    arguments = parser.parse_args()
    if arguments.lateness:
        print(lateness(arguments.lateness, load=arguments.load))
        return
    if arguments.profile:
        profile(arguments.profile, 40)
        return
    rigs = run(arguments.rigs.split(","), arguments.rounds)
    print(
        f"{platform.machine()}, instructions {rigs[0].controller.simd_level}, CPython "
        f"{platform.python_version()}, NumPy {np.__version__}\n\n{report(rigs)}"
    )


if __name__ == "__main__":
    main()

"""Endings of a program that cannot lower its arm: ``python -m experiments.guardian``.

Emulated servos run in a process of their own, in real time. Another process enables the arm, and
is ended at a random time in one of its phases (`PHASES`). Its guardian lowers the arm. The program
prints the tables of docs/descents.md: for each ending, the time until the guardian's first goal and
the motion of the arm; then the cost of the guardian.
"""

from __future__ import annotations

import ctypes
import os
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import pliant
import pliant.teach
from experiments import command_line, markdown
from pliant.config import load
from pliant.config.factory import make_arm, make_emulator
from pliant.config.loader import builtin_text, parse
from pliant.emulator.process import EmulatorProcess
from pliant.loop import Loop
from pliant.sim.postures import VERTICAL

if TYPE_CHECKING:
    from pliant.config import Config
    from pliant.emulator import ArmEmulator
    from pliant.emulator.log import Transaction

#: Folder from which programs import this module.
ROOT = Path(__file__).resolve().parents[1]
#: Signals that the harness sends, and all endings: these and failures that the program causes.
SIGNALS = ("SIGKILL", "SIGSTOP", "SIGHUP")
ENDINGS = (*SIGNALS, "segmentation fault", "abort", "exhausted memory", "held lock")
#: Arms, one per servo family, with a pose above the table [rad].
ARMS = {
    "so101": (0.3, -0.6, 0.5, 0.6, 0.0),
    "koch": (0.3, -0.6, 0.5, 0.6, 0.0),
    "arm7": tuple(VERTICAL),
}
#: Phases of a program, and time after the beginning of each within which it is ended [s].
PHASES = {"enabling": 1.5, "running": 2.0, "descending": 4.0, "teaching": 4.0}
#: Time after an ending within which packets of the ended program may still arrive [s].
IN_FLIGHT = 0.02
#: Longest time until the arm must be lowered [s], and time of observation after torque off [s].
PATIENCE, AFTER = 90.0, 1.0
#: Largest speed of the tool during the descent, and after torque off [m/s].
MAX_SPEED, MAX_FALL = 0.2, 0.1
#: Registers whose values may differ after a run: servos change them, or no program restores them.
CHANGING = (
    *("present", "moving", "status", "goal_position", "torque_enable", "realtime_tick"),
    *("position_trajectory", "velocity_trajectory"),
)
#: Reply timeout of the programs [s]; the emulator shares the computer with them.
REPLY_TIMEOUT = 0.05


def configuration(robot: str, **overrides: Any) -> Config:
    """Return the configuration of a built-in arm, with a reply timeout for emulated servos."""
    text = builtin_text(robot)
    line = f"[loop]\nreply_timeout_min = {REPLY_TIMEOUT}\n"
    text = text.replace("[loop]\n", line) if "[loop]\n" in text else f"{text}\n{line}"
    return parse(text, source=robot, **overrides)


class Recorder:
    """Record of an emulated arm: tool, torque and goals, by the system's monotonic clock.

    Args:
        bus: The emulator.
    """

    def __init__(self, bus: ArmEmulator) -> None:
        self._bus = bus
        self._rows: list[tuple[float, float, float, bool]] = []
        self._goals: list[float] = []
        self._first: list[dict[str, int]] | None = None
        bus.world.watchers.append(self._recorded)
        bus.log.watch = self._watched

    def _recorded(self, _: int) -> None:
        if self._first is None:
            self._first = self._registers()
        plant = self._bus.plant
        speed = float(np.linalg.norm(plant.ground_truth.frame("tool").twist()[:3]))
        self._rows.append((time.monotonic(), float(plant.tool[2, 3]), speed, self.has_torque()))

    def _watched(self, transaction: Transaction) -> None:
        if any("goal_position" in write.values for write in transaction.writes):
            self._goals.append(time.monotonic())

    def has_torque(self) -> bool:
        """Return True if a servo has torque."""
        return any(servo.get("torque_enable") for servo in self._bus.servos)

    def _registers(self) -> list[dict[str, int]]:
        return [
            {
                register.name: servo.get(register.name)
                for register in servo.table
                if register.area == "ram" and not register.name.startswith(CHANGING)
            }
            for servo in self._bus.servos
        ]

    def summary(self, ended: float) -> dict[str, Any]:
        """Return the behaviour of the arm since the program ended at `ended`, a monotonic time.

        Keys: `had_torque`, True if torque was on after the ending; `has_torque`, True if it is on
        now; `first_goal` and `takes`, times from the ending to the first new goal (None: none) and
        to torque off [s]; `speed` and `falls`, largest speed of the tool with torque and without
        [m/s]; `sags`, sag of the tool before the first goal [m]; `lowered`, descent of the tool
        [m]; `registers`, texts of registers that were not restored.
        """
        now, height, speed, torque = (np.array(column) for column in zip(*self._rows, strict=True))
        after = now > ended
        on = after & torque.astype(bool)
        goals = [goal for goal in self._goals if goal > ended + IN_FLIGHT]
        changed = [
            f"{name}: {value} -> {new[name]}"
            for old, new in zip(self._first or [], self._registers(), strict=True)
            for name, value in old.items()
            if new[name] != value
        ]
        start = height[~after][-1]
        return {
            "had_torque": bool(on.any()),
            "has_torque": self.has_torque(),
            "first_goal": goals[0] - ended if goals else None,
            "takes": float(now[on][-1] - ended) if on.any() else 0.0,
            "speed": float(speed[on].max(initial=0.0)),
            "falls": float(speed[after & ~torque.astype(bool)].max(initial=0.0)),
            "sags": float(start - height[after & (now < (goals[0] if goals else np.inf))].min()),
            "lowered": float(start - height[-1]),
            "registers": changed,
        }


def recorded(config: Config, q: list[float]) -> ArmEmulator:
    """Return the emulator of an arm in the pose q (n,) [rad], with its `Recorder` as attribute."""
    bus = make_emulator(config, q=q)
    bus.recorder = Recorder(bus)  # type: ignore[attr-defined]
    return bus


# --- The program that is ended ---


def _say(word: str) -> None:
    os.write(1, f"{word}\n".encode())


def _perform() -> None:
    """Wait for a line on standard input, and end this process in the way that the line names."""
    ending = sys.stdin.readline().strip()
    if ending == "segmentation fault":
        ctypes.string_at(0)
    elif ending == "abort":
        os.abort()
    elif ending == "held lock":
        ctypes.PyDLL(None).sleep(1000)  # a call by PyDLL keeps the interpreter's lock
    elif ending == "exhausted memory":
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
        size = pages * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (size, size))
        kept, block, deadline = [], 1 << 20, time.monotonic() + 3.0
        while time.monotonic() < deadline:
            try:
                kept.append(bytearray(block))
            except MemoryError:
                block = max(block // 2, 512)
        os.abort()  # as C++ and Rust do when an allocation fails


def victim(robot: str, port: str, phase: str, *, guardian: bool = True) -> None:
    """Run the program that is ended; print its guardian's process id, and when the phase begins."""
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # `nohup` ignores it
    threading.Thread(target=_perform, daemon=True).start()
    arm = make_arm(configuration(robot, backend="bus", port=port), guardian=guardian)
    switch = arm.drive.enable

    def enable(*orders: Any, **options: Any) -> None:
        _say(str(arm._guardian.pid if arm._guardian is not None else 0))
        if phase == "enabling":
            _say("begin")
        if phase == "start":
            _say(str(time.perf_counter() - begun))
            os._exit(0)
        switch(*orders, **options)

    arm.drive.enable = enable  # type: ignore[method-assign]
    begun = time.perf_counter()
    with arm:
        if phase == "teaching":
            _say("begin")
            pliant.teach.record(arm)
        controller = pliant.Controller(arm.model, pliant.Settings.soft("y", task="xyz"), arm.servos)
        target = arm.model.forward_kinematics(arm.read().q)
        for tick in Loop(arm, controller, duration=0.3 if phase == "descending" else None):
            if tick.index == 0 and phase == "running":
                _say("begin")
            moved = target.copy()
            moved[2, 3] += 0.02 * np.sin(2.0 * tick.time)
            tick.step(moved)
        if phase == "descending":
            _say("begin")


# --- The harness ---


@dataclass(frozen=True)
class Case:
    """One run.

    Attributes:
        robot: Name of the built-in arm.
        phase: Phase in which the program ends, see `PHASES`.
        ending: One of `ENDINGS`.
        seed: Number that determines time and pose.
    """

    robot: str
    phase: str
    ending: str
    seed: int


def start(case: Case) -> tuple[list[float], float]:
    """Return the initial pose (n,) [rad], and the time from the phase's start to the ending [s]."""
    rng = np.random.default_rng([case.seed, *case.phase.encode(), *case.ending.encode()])
    rest = np.array(load(case.robot).life.rest_q)
    q = rest + rng.uniform(0.3, 1.0) * (np.array(ARMS[case.robot]) - rest)
    delay = PHASES[case.phase] * rng.uniform()
    # Torque comes on joint by joint in the first part of this phase.
    return q.tolist(), delay**2 / PHASES[case.phase] if case.phase == "enabling" else delay


def run(case: Case) -> dict[str, Any]:
    """Run a case; return the summary of the `Recorder`, and values of the processes.

    Keys in addition to the summary's: `code`, the program's exit code; `messages` of the program
    and of the guardian; `memory`, the guardian's own memory [MB]; `guarded`, True if it ended.
    """
    q, delay = start(case)
    with tempfile.TemporaryFile("w+") as stderr, emulator(case.robot, q) as bus:
        call = f"victim({case.robot!r}, {bus.port!r}, {case.phase!r})"
        with subprocess.Popen(
            [sys.executable, "-c", f"from experiments.guardian import victim; {call}"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=stderr,
            text=True,
            cwd=ROOT,
        ) as process:
            try:
                assert process.stdin is not None
                assert process.stdout is not None
                line = process.stdout.readline()
                if not line:
                    stderr.seek(0)
                    raise RuntimeError(f"the program has ended before torque on: {stderr.read()}")
                guardian = int(line)
                process.stdout.readline()
                memory = own_memory(guardian)
                time.sleep(delay)
                ended = time.monotonic()
                if case.ending in SIGNALS:
                    process.send_signal(getattr(signal, case.ending))
                else:
                    process.stdin.write(f"{case.ending}\n")
                    process.stdin.flush()
                code = process.wait(PATIENCE)
                while is_running(guardian) and time.monotonic() < ended + PATIENCE:
                    time.sleep(0.05)
            finally:
                process.kill()
        time.sleep(AFTER)
        found: dict[str, Any] = bus.call("recorder.summary", ended)
        stderr.seek(0)
        beside = {"code": code, "messages": stderr.read(), "memory": memory}
    return {**found, **beside, "guarded": not is_running(guardian)}


def emulator(robot: str, q: list[float]) -> EmulatorProcess:
    """Return the process with the emulated servos of an arm in the pose q (n,) [rad]."""
    return EmulatorProcess(recorded, configuration(robot), q)


def own_memory(pid: int) -> float:
    """Return the memory that a process does not share with others [MB]."""
    text = Path(f"/proc/{pid}/smaps_rollup").read_text(encoding="ascii")
    private = [line.split()[1] for line in text.splitlines() if line.startswith("Private_")]
    return sum(map(int, private)) / 1024.0


def is_running(pid: int) -> bool:
    """Return True if a process runs; False if it has ended, also if it has not been waited for."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace")
    except OSError:
        return False
    return text.rpartition(")")[2].split()[0] not in {"Z", "X"}


def main(
    *,
    arm: command_line.Arms = (),
    ending: command_line.Arms = (),
    instants: int = 50,
    jobs: int = 2,
    starts: int = 10,
) -> None:
    """Print a table of all endings, and what the guardian costs.

    Args:
        arm: Names of the arms; default: all of `ARMS`.
        ending: Names of the endings; default: all of `ENDINGS`.
        instants: Number of runs of each ending, at random times in each of the phases in turn.
        jobs: Number of runs at a time.
        starts: Number of starts with and without a guardian.
    """
    phases = tuple(PHASES)
    memory: list[float] = []
    print(markdown.head(COLUMNS), flush=True)
    for robot, how in product(arm or ARMS, ending or ENDINGS):
        turns = (divmod(i, len(phases)) for i in range(instants))
        cases = [Case(robot, phases[phase], how, seed) for seed, phase in turns]
        with ThreadPoolExecutor(jobs) as pool:
            found = list(pool.map(run, cases))
        print(markdown.row(cells(cases, found)), flush=True)
        memory += [one["memory"] for one in found]
        for case, one in zip(cases, found, strict=True):
            if wrong := violations(one):
                print(case, wrong, one, file=sys.stderr, flush=True)
    if memory:
        print(f"\nmemory of its own [MB]: {markdown.worst(memory, 1)}")
    times: dict[bool, list[float]] = {False: [], True: []}
    for _ in range(starts):
        for guardian, found_times in times.items():
            found_times.append(enabling_time("so101", guardian=guardian))
    for guardian, found_times in times.items():
        if found_times:
            print(f"enable, guardian={guardian} [s]: {markdown.worst(found_times, 2)}")


def enabling_time(robot: str, *, guardian: bool) -> float:
    """Return the time from the call of `Arm.enable` to the first torque on, with open ports [s]."""
    with emulator(robot, start(Case(robot, "running", "SIGKILL", 0))[0]) as bus:
        call = f"victim({robot!r}, {bus.port!r}, 'start', guardian={guardian})"
        done = subprocess.run(
            [sys.executable, "-c", f"from experiments.guardian import victim; {call}"],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=True,
            cwd=ROOT,
        )
    return float(done.stdout.split()[-1])


COLUMNS = (
    "arm",
    "ending",
    "lowered",
    "first goal after [s]",
    "sags before [mm]",
    "tool [m/s]",
    "after torque off [m/s]",
    "torque off after [s]",
)


def violations(found: dict[str, Any]) -> list[str]:
    """Return the requirements that a run did not meet, as texts with its values."""
    wrong = {
        "the guardian still runs": not found["guarded"],
        "torque is on": found["has_torque"],
        f"tool at {found['speed']:.2f} m/s": found["speed"] > MAX_SPEED,
        f"falls at {found['falls']:.2f} m/s": found["falls"] > MAX_FALL,
        f"registers: {found['registers']}": bool(found["registers"]),
    }
    return [text for text, is_wrong in wrong.items() if is_wrong]


def cells(cases: list[Case], found: list[dict[str, Any]]) -> list[str]:
    """Return a row of the table: maximum and median of each quantity over the runs with torque.

    If no run had torque, over all runs.
    """
    on = [run for run in found if run["had_torque"]] or found
    firsts = [run["first_goal"] for run in on if run["first_goal"] is not None]
    return [
        cases[0].robot,
        cases[0].ending,
        f"{sum(not violations(one) for one in found)} of {len(found)}",
        markdown.worst(firsts, 2) if firsts else "",
        markdown.worst([run["sags"] for run in on], 0, 1e3),
        markdown.worst([run["speed"] for run in on], 2),
        markdown.worst([run["falls"] for run in on], 2),
        markdown.worst([run["takes"] for run in on], 0),
    ]


if __name__ == "__main__":
    command_line.start(main)

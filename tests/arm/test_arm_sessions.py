"""Calls of an arm to its drive in whole sessions, compared with recorded calls.

`PYTHONPATH=tests python tests/arm/test_arm_sessions.py` records the calls again, after an intended
change.
"""

import json
import logging
import math
import os
import warnings
from itertools import groupby
from pathlib import Path

import numpy as np
import pytest
from bare_arm import bare_arm

import pliant.arm.arm
from pliant import ServoError, ServoFaultError, ServoTimeoutError
from pliant.arm import Arm, Budget, GripperConfig
from pliant.arm._messages import MESSAGES
from pliant.drive import JointReadings, ServoStatus

FILE = Path(__file__).parents[1] / "data" / "arm_sessions.json"
START = np.array([0.1, -0.4, 0.5, 0.6, 0.2, 0.3])


class Recorder:
    """Guardian or signals of an arm, whose calls are recorded."""

    is_ours, has_pending = True, False

    def __init__(self, name, calls):
        self._name, self._calls = name, calls
        calls.append((name,))

    def __getattr__(self, name):
        def call(*arguments, **options):
            names = [sorted(value) for value in arguments if isinstance(value, dict)]
            self._calls.append((f"{self._name}.{name} {names} {options}",))

        return call


class Statics:
    """Drive of an SO-101 and its gripper, whose joints go to the equilibrium at a limited speed.

    A joint whose limit is below its weight sinks. The drive is its own clock.

    Attributes:
        calls: Verbs, with the numbers that were sent.
        silent: Mask (N,) of joints that do not answer.
        errors: Errors of the next readings; None: no error.
        heartbeat: Heartbeat of the arm, whose timeouts are added to `calls`.
        status: Results of the next status readings.
    """

    real_time, accepts_lead, latency, outlives_program = False, True, 0.003, True

    def __init__(self, arm, **attributes):
        self.model, drive = arm.model, arm.drive
        self.names, self.servos = drive.names, drive.servos
        self.kp, self.usable = np.asarray(self.servos.kp), np.asarray(self.servos.max_torque)
        self.clock, self.time, self.counters = self, 0.0, {"retries": 3}
        self.q, self.on = START.copy(), np.zeros(6, dtype=bool)
        self.goal, self.limit, self.calls = START.copy(), np.zeros(6), []
        self.silent, self.errors, self.status = np.zeros(6, dtype=bool), [], []
        self.cost, self.heartbeat, self.beats, self.last = 0.001, [0.0, 0.0], 0, [0.0, 0.0]
        for name, value in attributes.items():
            setattr(self, name, value)

    @property
    def enabled(self):
        return self.on

    def now(self):
        return self.time

    def wait_until(self, deadline):
        dt, self.time = max(deadline - self.time, 0.0), max(deadline, self.time)
        weight = np.append(self.model.gravity(self.q[:5]), 0.0)
        change = np.clip(self.goal - weight / self.kp - self.q, -0.8 * dt, 0.8 * dt)
        change = np.where(np.abs(weight) > self.limit, -0.3 * dt * np.sign(weight), change)
        low, high = np.append(self.model.lower, -0.1), np.append(self.model.upper, 1.7)
        self.q = np.clip(self.q + np.where(self.on, change, 0.0), low, high)

    def open(self):
        self.calls.append(("open",))

    def close(self):
        self.calls.append(("close",))

    def read(self):
        self.wait_until(self.time + self.cost)
        self.note_heartbeat()
        if self.errors and (error := self.errors.pop(0)) is not None:
            raise error
        position = np.where(self.silent, 9.0, np.round(self.q / 0.0015) * 0.0015)
        return JointReadings(position, ~self.silent, self.time)

    def note_heartbeat(self):
        before, self.last = self.last, list(self.heartbeat)
        self.beats += before[0] != self.last[0]
        if before[1] != self.last[1]:
            self.calls.append(("timeout", self.last[1]))

    def write(self, goal, limit, velocity=None):
        speeds = [] if velocity is None else np.minimum(velocity, 9.0)
        self.calls.append(("write", *goal, *limit, *speeds))
        self.goal, self.limit = goal.copy(), limit.copy()

    def poll_status(self):
        return self.status.pop(0) if self.status else None

    def enable(self, goal, limit, lead=0.0):
        self.calls.append(("enable", *goal, *limit, *np.broadcast_to(lead, 6)))
        self.goal, self.limit, self.on = goal + lead, limit.copy(), np.ones(6, dtype=bool)

    def disable(self, names):
        self.note_heartbeat()
        self.calls.append((f"disable {' '.join(names)}",))
        self.on = self.on & ~np.isin(self.names, names)

    def watchdog(self, seconds):
        self.calls.append(("watchdog", seconds))


def move(arm, count, amplitude=0.3, **options):
    """Send goals of a slow motion in cycles of 10 ms; return ages and faults of the readings."""
    found, begin = [], arm.read().q
    for i in range(count):
        state = arm.read()
        found += [float(np.sum(state.age)), float(len(state.faults))]
        arm.write(begin + amplitude * math.sin(0.05 * i), **options)
        arm.clock.wait_until(arm.clock.now() + 0.01)
    return found


def simple(arm, drive):
    arm.enable()
    found = move(arm, 30, limit=0.5 * drive.usable[:5])
    for order in (arm.gripper.open, lambda: arm.gripper.close(0.4), lambda: arm.gripper.go(0.8)):
        order()
        found.append(arm.gripper.width)
    found += move(arm, 5, velocity=[1.0, 2.0, np.inf, 0.5, 0.1])
    found += move(arm, 5, 5.0, lead=True)
    arm.ramp_limits()
    found += move(arm, 70, 2.0, extra={"gripper": (0.2, 0.1)})
    return [*found, *arm.heat.values(), arm.gripper.width]


def rest(arm, drive):
    arm.enable()
    move(arm, 10)
    arm.park()
    arm.enable()
    arm.park(START[:5] + 0.1)
    return [*arm.leads]


def left_on(arm, drive):
    arm.enable()
    move(arm, 60, 0.2)
    arm.leave_enabled()
    return []


def silences(arm, drive):
    arm.enable()
    drive.silent[1] = True
    found = move(arm, 20)
    drive.errors = [ServoTimeoutError("lost")] * 3
    found += move(arm, 5)
    drive.silent[:] = False
    found += move(arm, 60)
    drive.silent[2] = True
    drive.errors = [None] * 20 + [ServoError("noise")] * 30
    return found


def lost(arm, drive):
    arm.enable()
    drive.errors = [None] * 30 + [ServoError("unplugged")] * 9999
    return []


def taken(arm, drive):
    drive.on = np.array([True, True, False, True, False, False])
    drive.goal, drive.limit = START + 0.05, 0.6 * drive.usable
    drive.orders = tuple(np.where(drive.on, x, np.nan) for x in (drive.goal, drive.limit))
    arm.enable()
    return [*arm.leads, *move(arm, 20)]


def hot(arm, drive):
    arm.enable()
    drive.status = [
        ServoStatus("elbow_flex", 7.1, 61.0),
        ServoStatus("shoulder_lift", 5.0, 84.0, ("shoulder_lift: too hot",)),
        None,
        ServoStatus("gripper", None, 41.0),
        ServoStatus("shoulder_lift", 5.5, None),
    ]
    found = move(arm, 40, 0.1)
    drive.cost = 0.5
    for _ in range(60):
        arm.read()
        arm.write(START[:5] + 1.0, drive.usable[:5])
    drive.cost = 0.001
    return [*found, *arm.heat.values(), *move(arm, 5)]


def jumps(arm, drive):
    arm.enable()
    found = move(arm, 5)
    drive.q[3] += 1.0
    found += move(arm, 12)
    drive.refusing = np.arange(6) == 1
    found.append(arm.counters["jumps"])
    return found


def sagging(arm, drive):
    arm.enable()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        move(arm, 60, 0.0, limit=0.3 * np.abs(arm.model.gravity(START[:5])))
    return [len(caught)]


def guarded(arm, drive):
    arm.enable()
    found = move(arm, 5)
    drive.time += 0.3
    found += move(arm, 5)
    drive.errors = [ServoTimeoutError("lost")] * 30
    return [*found, *move(arm, 40)]


def torque_stays(arm, drive):
    arm.enable()

    def disable(names):
        drive.calls.append(("failed",))
        raise ServoFaultError("wrist_flex did not confirm")

    drive.disable = disable
    drive.unrestored = np.arange(6) == 4
    drive.torque_unknown = np.arange(6) == 3
    return []


def unrestored(arm, drive):
    arm.enable()
    drive.unrestored = np.arange(6) % 4 == 1
    arm.disable_torque()
    return []


def resumed(arm, drive):
    """The guardian lowers an arm; a joint and the gripper answer only after a while."""
    goals, limits = START + 0.05, 0.5 * drive.usable
    missing = np.array([False, False, True, False, False, True])
    drive.on, drive.silent = np.arange(6) != 4, missing.copy()
    drive.goal, drive.limit = goals, limits

    def reopen():
        known = drive.on & ~drive.silent
        drive.calls.append(("reopen", *known))
        return tuple(np.where(known, x, np.nan) for x in (goals, limits))

    drive.reopen = reopen
    read, count = drive.read, []

    def later():
        count.append(1)
        if len(count) > 300:
            drive.silent[:] = False
        return read()

    drive.read = later
    arm._resume("the program has ended")
    return [float(drive.on.sum())]


def resumed_off(arm, drive):
    drive.reopen = lambda: (np.full(6, np.nan), np.full(6, np.nan))
    arm._resume("the program has ended")
    return []


REST = START[:5] + np.array([0.3, -0.2, 0.1, 0.0, 0.2])
#: Sessions, with options of `Arm` and attributes of the drive.
SESSIONS = {
    "simple": (simple, {"grippers": {"gripper": GripperConfig(lever=0.05, limit=0.3)}}, {}),
    "without leads": (simple, {"rate": 50.0}, {"accepts_lead": False, "overload": np.full(6, 0.6)}),
    "rest": (rest, {"rest_q": REST, "table": -0.5}, {}),
    "on the table": (rest, {"rest_q": REST, "table": 0.02}, {}),
    "left on": (left_on, {"guardian": False}, {"real_time": True}),
    "left on at exit": (simple, {"on_exit": "leave_enabled"}, {}),
    "silences": (silences, {}, {"real_time": True}),
    "lost": (lost, {}, {}),
    "taken": (taken, {}, {}),
    "hot": (hot, {"power_budget": Budget(supply=3.0)}, {"stall_current": np.full(6, 2.0)}),
    "jumps": (jumps, {}, {}),
    "sagging": (sagging, {}, {}),
    "guarded": (guarded, {"watchdog": 0.2}, {}),
    "torque stays": (torque_stays, {}, {}),
    "unrestored": (unrestored, {"handle_signals": False}, {}),
    "resumed": (resumed, {}, {"real_time": True}),
    "resumed, left on": (resumed, {"on_exit": "leave_enabled", "guardian": False}, {}),
    "resumed without torque": (resumed_off, {}, {}),
}


def play(name):
    """Return the record of a session: verbs with their counts, sums of what was sent, and texts."""
    session, options, attributes = SESSIONS[name]
    base = bare_arm("so101")
    drive = Statics(base, **attributes)
    drive.servos = drive.servos.replace(stiffness_known=session is not left_on)
    texts, post = [], MESSAGES.post

    def record(text, level=logging.INFO, *, progress=False):
        # Messages about the progress depend on the time that the computer takes.
        if not progress:
            texts.append([text.replace(str(os.getpid()), "PID"), level])
        return post(text, level, progress=progress)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(MESSAGES, "post", record)
        patch.setattr(pliant.arm.arm, "Guardian", lambda _: Recorder("guardian", drive.calls))
        patch.setattr(pliant.arm.arm, "Signals", lambda _: Recorder("signals", drive.calls))
        arm = Arm(base.model, drive, **options)
        drive.heartbeat = arm._supervisor.heartbeat
        found = session(arm, drive)
        try:
            arm.close()
        except ServoError as error:
            texts.append([str(error), 0])
    texts = [[*text, len([*run])] for text, run in groupby(texts)]
    verbs, sums = [], []
    for verb, *numbers in drive.calls:
        if verbs and verbs[-1][0] == verb and len(sums[-1]) == len(numbers):
            verbs[-1][1] += 1
            # Later calls weigh more, so that an exchange of two of them changes the sums.
            weight = 1.0 + 0.001 * verbs[-1][1]
            sums[-1] = [a + weight * float(b) for a, b in zip(sums[-1], numbers, strict=True)]
        else:
            verbs.append([verb, 1])
            sums.append([float(number) for number in numbers])
    timeout = drive.heartbeat[1]
    numbers = [*found, drive.time, drive.beats, timeout, *(x for row in sums for x in row)]
    return {"verbs": verbs, "texts": texts, "numbers": [float(f"{x:.7g}") for x in numbers]}


@pytest.mark.parametrize("name", SESSIONS)
def test_an_arm_sends_the_recorded_commands(name):
    record, recorded = play(name), json.loads(FILE.read_text("utf-8"))[name]
    assert record["verbs"] == recorded["verbs"]
    assert record["texts"] == recorded["texts"]
    numbers = recorded["numbers"]
    assert record["numbers"] == pytest.approx(numbers, rel=1e-5, abs=1e-7, nan_ok=True)


if __name__ == "__main__":
    rows = [f'"{name}": {json.dumps(play(name))}' for name in SESSIONS]
    FILE.write_text("{\n" + ",\n".join(rows) + "\n}\n", "utf-8")

"""The guardian: arms whose program is killed, crashes, stops or hangs, over the bytes of a bus."""

import os
import pickle
import signal
import subprocess
import sys
import textwrap
import time
from contextlib import ExitStack
from types import SimpleNamespace

import numpy as np
import programs
import pytest
from bare_arm import bare_arm

pytest.importorskip("rustypot", reason="servo buses need the extra servo")
pytest.importorskip("mujoco", reason="the arm behind the bytes needs the extra sim")
if sys.platform != "linux":
    pytest.skip("these tests read /proc", allow_module_level=True)

import pliant
from experiments import guardian
from experiments.guardian import Case, is_running
from pliant.arm import _guardian_process
from pliant.arm._guardian import Guardian, _running, is_available
from pliant.arm._messages import MESSAGES
from pliant.config.factory import make_emulator
from pliant.emulator import emulate

full = pytest.mark.full
#: Phase and ending of a program, and the random seed of time and pose.
CASES = [
    ("running", "SIGKILL", 0),
    ("enabling", "SIGKILL", 1),
    pytest.param("descending", "SIGKILL", 1, marks=full),
    pytest.param("teaching", "SIGKILL", 0, marks=full),
    ("running", "SIGSTOP", 3),
    pytest.param("descending", "SIGSTOP", 3, marks=full),
    ("descending", "held lock", 3),
    *(
        pytest.param("running", ending, 3, marks=full)
        for ending in ("SIGHUP", "segmentation fault", "abort", "exhausted memory", "held lock")
    ),
]


@pytest.mark.parametrize(("phase", "ending", "seed"), CASES)
def test_the_arm_is_lowered_within_its_bounds(phase, ending, seed):
    outcome = guardian.run(Case("so101", phase, ending, seed))
    assert guardian.violations(outcome) == [], outcome
    assert outcome["had_torque"]
    if phase == "running":
        assert outcome["lowered"] > 0.02
    if ending in {"SIGHUP", "exhausted memory"}:
        # With these endings, the program may lower its arm itself.
        return
    assert "was lowered: torque OFF" in outcome["messages"]
    reason = {"SIGSTOP": "was stopped for", "held lock": "was silent for"}
    assert f"the program {reason.get(ending, 'has ended')}" in outcome["messages"]
    assert outcome["code"] < 0


#: Pose of `so101` close above its rest pose [rad].
LOW = [0.0, -1.5, 1.4, 0.8, 0.0]
PROGRAM = """
import os, signal, sys, time, pliant
arm = pliant.connect({file!r}, port={port!r}{options})
try:
    arm.enable()
except pliant.ServoError as error:
    print(error, flush=True)
    arm.close()
    sys.exit(3)
print(arm._guardian and arm._guardian.pid, flush=True)
{action}
"""
CONFIGURATION = pliant.config.loader.builtin_text("so101") + "\n[loop]\nreply_timeout_min = 0.05\n"
#: Program that holds its pose until it is ended.
HOLD = """
for tick in pliant.Loop(arm):
    tick.skip()
    if tick.index == 10:
        print("holds", flush=True)
    time.sleep(0.001)
"""


@pytest.fixture
def bus():
    with guardian.emulator("so101", LOW) as bus:
        yield bus


@pytest.fixture
def begin(bus, tmp_path):
    """Start a program on the bus with this code, and return it with the id of its guardian."""
    file, stack = tmp_path / "arm.toml", ExitStack()
    file.write_text(CONFIGURATION)

    def start(action, **options):
        options_text = "".join(f", {name}={value!r}" for name, value in options.items())
        code = PROGRAM.format(file=str(file), port=bus.port, options=options_text, action="{}")
        text = code.replace("{}", textwrap.dedent(action))
        program = programs.Program("-c", text, stdout=programs.PIPE, stderr=programs.PIPE)
        stack.enter_context(program)
        stack.callback(program.kill)
        line = program.stdout.readline().strip()
        return program, int(line) if line.isdigit() else line

    with stack:
        yield start


def wait_for(pid, timeout=60.0):
    """Wait for the end of a process; return True if it has ended."""
    deadline = time.monotonic() + timeout
    while is_running(pid) and time.monotonic() < deadline:
        time.sleep(0.02)
    return not is_running(pid)


def test_a_program_that_lowers_its_arm_leaves_nothing_behind(bus, begin):
    program, pid = begin("arm.close()\nprint('closed', flush=True)")
    stdout, stderr = program.communicate()
    assert stdout.split() == ["closed"], stderr
    assert not is_running(pid)
    assert not bus.call("recorder.has_torque")
    assert "guardian" not in stderr


def test_a_program_without_standard_streams_has_a_guardian(bus, tmp_path):
    file, result = tmp_path / "arm.toml", tmp_path / "result"
    file.write_text(f"{CONFIGURATION}comm_timeout = 10.0\n")
    code = f"""
import pathlib, pliant
try:
    with pliant.connect({str(file)!r}, port={bus.port!r}) as arm:
        text = f"{{arm.enabled}} {{arm._guardian is not None}}"
except pliant.PliantError as error:
    text = repr(error)
pathlib.Path({str(result)!r}).write_text(text)
"""
    shell = ("/bin/sh", "-c", 'exec "$@" <&- >&- 2>&-', "sh")
    process = subprocess.run([*shell, sys.executable, "-c", code], timeout=100, check=False)
    assert (process.returncode, result.read_text()) == (0, "True True")
    assert not bus.call("recorder.has_torque")


def test_torque_left_on_deliberately_stays_on_and_the_next_program_takes_over(bus, begin):
    program, pid = begin("arm.leave_enabled()\narm.close()")
    assert program.communicate()[0] == ""
    assert wait_for(pid)
    assert bus.call("recorder.has_torque")
    program, pid = begin(HOLD)
    assert program.stdout.readline() == "holds\n"
    program.kill()
    assert wait_for(pid)
    assert not bus.call("recorder.has_torque")


@full
def test_on_exit_holds_for_the_guardian_too(bus, begin):
    program, pid = begin(HOLD, on_exit="leave_enabled")
    assert program.stdout.readline() == "holds\n"
    program.kill()
    _, stderr = program.communicate()
    assert wait_for(pid)
    assert bus.call("recorder.has_torque")
    assert "stays where it is, torque ON" in stderr


def test_a_second_program_gets_an_error_and_the_first_goes_on(bus, begin):
    first, pid = begin(HOLD)
    second, error = begin("")
    assert "in use by another program" in error
    assert second.wait() == 3
    assert is_running(pid)
    first.send_signal(signal.SIGTERM)
    _, stderr = first.communicate()
    assert "was lowered: torque OFF" in stderr
    assert wait_for(pid)


@full
def test_a_program_started_again_waits_for_the_guardian_of_the_killed_one(bus, begin):
    program, pid = begin(HOLD)
    assert program.stdout.readline() == "holds\n"
    program.kill()
    goals = bus.call("log.count")
    while bus.call("log.count") < goals + 20:
        time.sleep(0.01)
    _, error = begin("")
    assert "a guardian that lowers the arm" in error
    assert wait_for(pid)
    program, pid = begin("arm.close()")
    assert program.communicate()[1].count("torque OFF") == 1


#: Ways to make a child that outlives the program: `os.fork`, as `multiprocessing` does; and a fork
#: in C, which skips Python's hooks and so keeps the socket to the guardian open.
CHILDREN = {
    "fork": "os.fork()",
    "C": "ctypes.CDLL(None).fork()",
}


@pytest.mark.parametrize("fork", [CHILDREN["fork"], pytest.param(CHILDREN["C"], marks=full)])
def test_a_forked_child_that_lives_on_does_not_keep_the_arm_up(bus, begin, fork):
    leave = "" if fork == CHILDREN["fork"] else "arm.drive.drop_ports()"
    program, pid = begin(
        f"""
        import ctypes
        if {fork} == 0:
            {leave}
            time.sleep(300.0)
            os._exit(0)
        """
        + textwrap.indent(HOLD, 8 * " ")
    )
    assert program.stdout.readline() == "holds\n"
    program.kill()
    assert wait_for(pid)
    assert not bus.call("recorder.has_torque")


@full
def test_a_program_that_closes_all_its_files_loses_the_arm(bus, begin):
    program, pid = begin("os.closerange(3, 256)\ntime.sleep(300.0)")
    assert wait_for(pid)
    assert not bus.call("recorder.has_torque")
    assert is_running(program.pid)


@full
def test_a_guardian_that_was_killed_is_reported_and_changes_nothing(bus, begin):
    program, pid = begin(f"{HOLD.rstrip()}\n    if tick.index == 50:\n        break\narm.close()\n")
    os.kill(pid, signal.SIGKILL)
    _, stderr = program.communicate()
    assert "the guardian of the arm has ended before the program" in stderr
    assert not bus.call("recorder.has_torque")


def test_a_process_that_does_not_exist_is_not_stopped():
    assert not _guardian_process._is_stopped(2**22 + 1)  # above the largest process id of Linux
    assert not _guardian_process._is_stopped(os.getpid())


@pytest.mark.parametrize("has_ended", [False, True])
def test_an_arm_at_rest_is_watched_no_longer(has_ended, monkeypatch):
    guardian, sent, messages = object.__new__(Guardian), [], []
    monkeypatch.setattr(MESSAGES, "post", lambda text, _: messages.append(text))
    guardian._drive = object()
    guardian._process = SimpleNamespace(poll=lambda: -9 if has_ended else None)
    guardian._line = SimpleNamespace(send=sent.append)
    for _ in range(2):
        guardian.rest()
    assert sent == [None]
    assert len(messages) == has_ended


@pytest.mark.parametrize(
    ("watches", "hand_over", "expected"),
    [
        (True, True, ["close"]),
        (True, False, ["send", "close", "kill", "wait"]),
        (False, True, ["close", "kill", "wait"]),
    ],
)
def test_a_guardian_is_ended_unless_the_arm_is_handed_over_to_it(watches, hand_over, expected):
    class Recorded(Guardian):
        def __init__(self):
            calls = [
                (name, lambda *_, name=name: self.calls.append(name))
                for name in ("send", "close", "kill", "wait")
            ]
            self.calls, self._drive = [], object() if watches else None
            self._line = SimpleNamespace(**dict(calls[:2]))
            self._process = SimpleNamespace(poll=lambda: None, **dict(calls[2:]))
            _running.add(self)

    guardian = Recorded()
    assert guardian.is_ours
    guardian.close(hand_over=hand_over)
    assert guardian.calls == expected
    assert not guardian.is_ours


def test_a_forked_child_leaves_guardian_and_ports_to_its_parent():
    guardian, calls = object.__new__(Guardian), []
    guardian._supervisor = SimpleNamespace(heartbeat="shared")
    guardian._drive = SimpleNamespace(drop_ports=lambda: calls.append("drop"))
    guardian._line = SimpleNamespace(
        close=lambda: calls.append("close"), send=lambda _: calls.append("send")
    )
    guardian.leave()
    assert sorted(calls) == ["close", "drop"]
    assert guardian._supervisor.heartbeat.tolist() == [0.0, 0.0]
    guardian.rest()
    assert "send" not in calls


def test_the_guardian_lowers_the_arm_after_a_descent_that_failed(bus, begin):
    program, pid = begin("""
        import pliant.arm.arm

        def fail(*arguments, **options):
            raise MemoryError

        pliant.arm.arm.descend = fail
        try:
            arm.close()
        except MemoryError:
            print("failed", flush=True)
            time.sleep(300.0)
    """)
    assert program.stdout.readline() == "failed\n"
    # Ctrl-C and the end of the terminal do not reach the guardian.
    assert os.getsid(pid) == pid != os.getsid(program.pid)
    assert wait_for(pid)
    assert is_running(program.pid)
    assert not bus.call("recorder.has_torque")
    program.kill()
    _, stderr = program.communicate()
    assert "was lowered: torque OFF" in stderr


@full
def test_a_program_that_goes_on_after_a_failed_descent_leaves_the_arm_to_its_guardian(bus, begin):
    program, pid = begin("""
        print("begin", flush=True)
        for action in (arm.lower, arm.lower, lambda: arm.write(arm.model.lower)):
            try:
                action()
            except pliant.ServoError as error:
                print(error, flush=True)
        time.sleep(3.0)
        arm.close()
        print("closed", flush=True)
        time.sleep(300.0)
    """)
    assert program.stdout.readline() == "begin\n"
    bus.call("pull")
    assert "the bus is gone" in program.stdout.readline()
    assert "arm.close() leaves it to its guardian" in program.stdout.readline()
    assert "may be on after a descent that failed" in program.stdout.readline()
    bus.call("put_back")
    assert bus.call("recorder.has_torque")
    assert program.stdout.readline() == "closed\n"
    assert wait_for(pid)
    assert is_running(program.pid)
    assert not bus.call("recorder.has_torque")
    program.kill()
    _, stderr = program.communicate()
    assert "in the 30 s after this program has closed the arm or ended; later start" in stderr


@full
def test_the_guardian_of_a_lost_arm_does_not_kill_a_program_that_lowers_another(
    bus, begin, tmp_path
):
    with guardian.emulator("so101", guardian.ARMS["so101"]) as other_bus:
        program, pid = begin(f"""
            other = pliant.connect({str(tmp_path / "arm.toml")!r}, port={other_bus.port!r})
            with arm, other:
                print("holds", flush=True)
                for ticks in zip(pliant.Loop(arm), pliant.Loop(other)):
                    for tick in ticks:
                        tick.skip()
        """)
        assert program.stdout.readline() == "holds\n"
        bus.call("pull")
        assert program.wait() == 1  # the lost bus raised an error
        assert not other_bus.call("recorder.has_torque")
        bus.call("put_back")
        _, stderr = program.communicate()
        assert "was not lowered, the bus is gone" in stderr
        assert wait_for(pid)
        assert not bus.call("recorder.has_torque")


@full
def test_an_arm_enabled_again_is_guarded_again(bus, begin):
    program, pid = begin(f"arm.lower()\narm.enable()\n{HOLD}")
    assert program.stdout.readline() == "holds\n"
    program.kill()
    assert wait_for(pid)
    assert not bus.call("recorder.has_torque")


def test_without_a_guardian_the_servos_keep_their_torque(bus, begin):
    program, pid = begin(HOLD, guardian=False)
    assert pid == "None"
    assert program.stdout.readline() == "holds\n"
    program.kill()
    program.wait()
    time.sleep(1.0)
    assert bus.call("recorder.has_torque")


def test_simulated_and_emulated_arms_and_other_drives_have_no_guardian():
    assert not is_available(bare_arm("koch").drive)
    arm = pliant.connect("so101", backend="emulator")
    assert not is_available(arm.drive)
    arm.close()
    with pytest.raises(TypeError, match="guardian must be a bool"):
        bare_arm("koch", guardian="yes")
    spec = pliant.servo.ServoSpec(name="pan", model="STS3215-7.4V", id=1, port="COM3")
    assert is_available(pliant.servo.ServoBus([spec]))
    assert not is_available(pliant.servo.ServoBus([spec], transport=lambda *_: None))


def test_a_program_that_cannot_have_a_guardian_says_so(monkeypatch, caplog):
    spec = pliant.servo.ServoSpec(name="pan", model="STS3215-7.4V", id=1, port="COM3")
    monkeypatch.setattr(sys, "frozen", True, raising=False)
    with caplog.at_level("WARNING", logger="pliant.arm"):
        assert not is_available(pliant.servo.ServoBus([spec]))
        MESSAGES.flush(5.0)
    assert "no guardian watches this arm" in caplog.text


def test_a_tick_makes_no_more_calls_and_requests_with_a_guardian():
    config = guardian.configuration("so101")
    calls: dict[bool, list[int]] = {}
    requests: dict[bool, list[int]] = {}
    for has_guardian in (False, True):
        with make_emulator(config, q=LOW) as emulated:
            arm = pliant.connect(
                guardian.configuration("so101", backend="bus", port=emulated.port),
                guardian=has_guardian,
                handle_signals=False,
            )
            arm.enable()
            assert (arm._guardian is not None) is has_guardian
            calls[has_guardian], requests[has_guardian] = [], []
            for _ in range(60):
                before, count = arm.counters["transactions"], 0

                def on_event(frame, event, argument):
                    nonlocal count
                    count += event in {"call", "c_call"}

                sys.setprofile(on_event)
                arm.write(arm.read().q)
                sys.setprofile(None)
                calls[has_guardian].append(count)
                requests[has_guardian].append(arm.counters["transactions"] - before)
            arm.disable_torque()
            arm.close()
    # Compare minimum and first quartile: requests differ from cycle to cycle, and a busy machine
    # causes retries.
    for counts in (calls, requests):
        assert min(counts[True]) == min(counts[False])
        quartiles = {has_guardian: sorted(counts[has_guardian])[15] for has_guardian in counts}
        assert quartiles[True] == quartiles[False]


def test_registers_and_zeros_are_those_of_the_ended_program_on_two_ports(monkeypatch):
    """A closed copy drives the servos of both ports, although one servo no longer answers."""
    monkeypatch.setattr("pliant.servo._enable.RESUME_TIME", 1.0)
    model = pliant.robots.load("so101")
    mounts = [
        pliant.emulator.Mount(joint=name, model="STS3215", id=k, port="ab"[k % 2])
        for k, name in enumerate(model.joint_names, 1)
    ]
    with emulate(model, mounts, q=np.array(LOW)) as emulated:
        specs = [
            pliant.servo.ServoSpec(
                name=mount.joint, model="STS3215-7.4V", id=mount.id, port=emulated.ports[mount.port]
            )
            for mount in mounts
        ]
        for servo in emulated.servos:
            servo.put("torque_limit", 900 + servo.id)
        first = pliant.servo.ServoBus(specs, reply_timeout_min=0.1)
        first.open()
        with pytest.raises(pliant.ServoError, match="in use"):
            first.closed_copy().reopen()
        copy = pickle.loads(pickle.dumps(first.closed_copy()))
        first.enable(first.read().position, [0.5] * 5)
        first.close()
        emulated.short()
        with pytest.raises(pliant.ServoError, match="torque may be on"):
            copy.reopen()
        emulated.short(False)
        assert all(servo.get("torque_enable") for servo in emulated.servos)
        emulated.unplug(3)
        goals, limits = copy.reopen()
        assert np.flatnonzero(np.isnan(goals)).tolist() == [2]
        assert copy.enabled.all()
        assert np.flatnonzero(copy.torque_unknown).tolist() == [2]
        assert [device.enabled for device in copy._devices] == [True, True, False, True, True]
        others = [0, 1, 3, 4]
        positions = [emulated.servo(joint + 1).get("goal_position") for joint in others]
        goal_registers = copy._codec.encode(others, np.nan_to_num(goals), [0.5] * 5, None, 0.0)[0]
        assert goal_registers == positions
        assert limits[others] == pytest.approx(0.5, abs=0.02)
        copy.write(np.nan_to_num(goals) + 0.01, [0.5] * 5)
        emulated.sync()
        for joint in others:
            servo = emulated.servo(joint + 1)
            assert servo.get("goal_position") == copy._joints[joint][0].goal
        with pytest.raises(pliant.ServoError, match="elbow_flex"):
            copy.disable()
        assert [emulated.servo(k + 1).get("torque_limit") for k in others] == [901, 902, 904, 905]
        copy.close()


@pytest.mark.parametrize(("robot", "requests"), [("so101", 8), ("koch", 21)])
def test_the_first_goal_of_a_guardian_needs_few_requests(robot, requests):
    """Until the first goal, the servos hold the last command of the program."""
    with make_emulator(guardian.configuration(robot)) as emulated:
        config = guardian.configuration(robot, backend="bus", port=emulated.port)
        program = pliant.connect(config, guardian=False, handle_signals=False)
        program.enable()
        copy = pickle.loads(pickle.dumps(program.drive.closed_copy()))
        emulated.sync()
        program.drive.close()
        goals_sent = []
        emulated.log.watch = lambda transaction: goals_sent.append(
            any("goal_position" in write.values for write in transaction.writes)
        )
        arm = pliant.Arm(program.model, copy, guardian=False, handle_signals=False)
        arm._resume("the program has ended")
        assert goals_sent.index(True) <= requests
        assert not any(servo.get("torque_enable") for servo in emulated.servos)
        arm.close()
        program._release()


@pytest.mark.parametrize("powered", [3, 0])
def test_the_guardian_of_a_half_enabled_arm_switches_no_torque_on(powered):
    with make_emulator(guardian.configuration("so101"), q=LOW) as emulated:
        port = guardian.configuration("so101", backend="bus", port=emulated.port)
        program = pliant.connect(port, guardian=False)
        program.open()
        copy = pickle.loads(pickle.dumps(program.drive.closed_copy()))
        program.close()
        limits = [servo.get("torque_limit") for servo in emulated.servos]
        for servo in emulated.servos:
            servo.put("torque_limit", 300)
            servo.put("goal_position", servo.position)
        for servo in emulated.servos[:powered]:
            servo.put("torque_enable", 1)
        arm = pliant.Arm(program.model, copy, guardian=False, handle_signals=False)
        arm._resume("the program has ended")
        assert not any(servo.get("torque_enable") for servo in emulated.servos)
        assert [servo.get("torque_limit") for servo in emulated.servos] == limits
        assert not any(w.values["torque_enable"] for w in emulated.log.writes("torque_enable"))
        ids = {write.id for write in emulated.log.writes("goal_position")}
        assert ids == {servo.id for servo in emulated.servos[:powered]}
        assert not arm.enabled
        arm.close()


class Beats:
    """Simulated program for the guardian's checks: heartbeat, time, and True if it is stopped."""

    def __init__(self, monkeypatch):
        self.heartbeat, self.now, self.is_stopped = [0.0, 0.0], 0.0, False
        monkeypatch.setattr(_guardian_process.time, "monotonic", lambda: self.now)
        monkeypatch.setattr(_guardian_process, "_is_stopped", lambda _: self.is_stopped)
        self.program = _guardian_process.Program(os.getppid(), self.heartbeat)

    def checks(self, seconds, period=0.1):
        """Check every `period` [s]; return the first problem and its time [s], None if none."""
        for index in range(round(seconds / period)):
            self.now += period
            if problem := self.program.problem(0.5):
                return problem, (index + 1) * period
        return None


def test_only_a_program_under_supervision_counts_as_silent(monkeypatch):
    beats = Beats(monkeypatch)
    assert beats.checks(60.0) is None
    beats.heartbeat[1] = 0.6
    problem, after = beats.checks(60.0)
    assert problem.startswith("the program was silent for 1.")
    assert after == pytest.approx(0.6 + _guardian_process.MARGIN, abs=0.15)
    beats.heartbeat[0] += 1.0
    assert beats.checks(1.0) is None
    # When the timeout becomes shorter, the silence starts to count again from zero.
    beats.heartbeat[:] = [2.0, 10.0]
    assert beats.checks(8.0) is None
    beats.heartbeat[1] = 0.5
    assert beats.checks(1.0) is None


def test_a_stopped_program_has_the_time_of_its_bus(monkeypatch):
    beats = Beats(monkeypatch)
    beats.is_stopped = True
    assert beats.checks(1.0) is None
    beats.is_stopped = False  # a debugger or `fg` continues the program
    assert beats.checks(1.0) is None
    beats.is_stopped = True
    problem, after = beats.checks(60.0)
    assert problem.startswith("the program was stopped for 1.")
    assert after == pytest.approx(0.5 + _guardian_process.MARGIN, abs=0.15)


def test_time_in_which_the_guardian_did_not_run_does_not_count(monkeypatch):
    beats = Beats(monkeypatch)
    beats.heartbeat[1] = 0.6
    # Five checks with 10 s between them, as on a machine that slept: 0.2 s count for each.
    assert beats.checks(50.0, period=10.0) is None
    assert beats.checks(50.0, period=10.0) is not None


def test_a_message_of_the_program_ends_its_silence_and_its_stop(monkeypatch):
    for is_stopped, limit, name in ((False, 0.6, "silent"), (True, 0.0, "stopped")):
        beats = Beats(monkeypatch)
        beats.heartbeat[1], beats.is_stopped = limit, is_stopped
        for _ in range(3):
            beats.program.restart()
            assert beats.checks(1.4) is None
        # After a restart, time counts from then on, and the heartbeat of that moment is not new.
        beats.heartbeat[0] += 1.0
        beats.now += 100.0
        beats.program.restart()
        problem, after = beats.checks(60.0)
        assert f"was {name} for 1." in problem
        assert after < 1.8
    assert beats.program.sentinels == [beats.program._end]


class Watched:
    """Program whose guardian's calls are simulated: it ends or hangs after some checks.

    Args:
        messages: Messages of the program, one per check: content, None, or an error.
        ends: Number of checks after which the program has ended, None: never.
        hangs: Number of checks after which it hangs.
    """

    def __init__(self, monkeypatch, messages, *, ends=None, hangs=None):
        self.messages, self.ends, self.hangs, self.checks = list(messages), ends, hangs, 0
        self.answers, self.calls, self.sentinels = [], [], []
        self.patience = 0.0
        monkeypatch.setattr(_guardian_process, "wait", self.wait)
        monkeypatch.setattr(_guardian_process, "_build", self.build)

    def wait(self, lines, timeout):
        self.checks += 1
        assert self.checks < 20
        assert timeout == _guardian_process.PERIOD
        return [self] if self.messages and self in lines else []

    def build(self, content):
        arm = None if content == "wrong" else SimpleNamespace(name=content, comm_timeout=0.7)
        return arm, None if arm else "TypeError: wrong"

    def recv(self):
        message = self.messages.pop(0)
        if isinstance(message, Exception):
            raise message
        return message

    def send(self, answer):
        self.answers.append(answer)

    @property
    def has_ended(self):
        return self.ends is not None and self.checks > self.ends

    def problem(self, patience):
        self.patience = patience
        return None if self.hangs is None or self.checks <= self.hangs else "it hangs"

    def restart(self):
        self.calls.append("restart")

    def kill(self):
        self.calls.append("kill")


@pytest.mark.parametrize(
    ("messages", "events", "expected", "answers"),
    [
        (["so101"], {"ends": 5}, "the program has ended", [None]),
        (["so101"], {"ends": 0}, "the program has ended", [None]),
        (["so101"], {"hangs": 5}, "it hangs, and was ended", [None]),
        (["so101", EOFError()], {}, "the program has given the arm up", [None]),
        (["so101", EOFError()], {"ends": 2}, "the program has ended", [None]),
        (["so101", OSError()], {"ends": 2}, "the program has ended", [None]),
        # Torque off, or no arm: nothing is to be lowered.
        (["so101", None], {"ends": 5}, None, [None]),
        (["so101", None, EOFError()], {}, None, [None]),
        (["wrong"], {"ends": 5}, None, ["TypeError: wrong"]),
        ([], {"ends": 5}, None, []),
        ([EOFError()], {}, None, []),
        (["so101", None, "koch"], {"hangs": 5}, "it hangs, and was ended", [None, None]),
    ],
)
def test_the_guardian_lowers_the_arm_that_has_torque(
    monkeypatch, messages, events, expected, answers
):
    program = Watched(monkeypatch, messages, **events)
    found = _guardian_process.watch(program, program)
    assert (found and found[1]) == expected
    names = [message for message in messages if isinstance(message, str)]
    assert found is None or found[0].name == names[-1]
    assert program.answers == answers
    assert ("kill" in program.calls) == ("hangs" in events)
    assert program.calls.count("restart") == len([m for m in messages if m is None or m in names])
    assert program.patience in {0.0, 0.7}  # 0 before the first check, else the arm's timeout [s]


class Taken:
    """An arm whose port another process locks for the first `count` attempts to open it."""

    def __init__(self, monkeypatch, count, error):
        self.left, self.error, self.time, self.reasons = count, error, 0.0, []
        self.waits, self.closed, self.messages = [], 0, []
        self.drive, self._label = self, "so101"
        monkeypatch.setattr(_guardian_process.time, "monotonic", lambda: self.time)
        monkeypatch.setattr(_guardian_process.time, "sleep", self.sleep)
        monkeypatch.setattr(MESSAGES, "post", lambda text, _: self.messages.append(text))

    def sleep(self, seconds):
        self.waits.append(seconds)
        self.time += seconds

    def _resume(self, reason):
        self.reasons.append(reason)
        self.left -= 1
        if self.left >= 0:
            raise self.error

    def close(self):
        self.closed += 1
        raise pliant.ServoError("not open")


@pytest.mark.parametrize(
    ("count", "error", "has_ended", "waits"),
    [
        (0, None, True, []),
        (3, pliant.ServoError("locked"), True, [_guardian_process.OPEN_PERIOD] * 3),
        (3, pliant.ServoError("locked"), False, [_guardian_process.PERIOD] * 3),
        (9, pliant.ServoFaultError("goals are rejected"), True, []),
    ],
)
def test_the_port_of_an_ended_program_is_tried_again(monkeypatch, count, error, has_ended, waits):
    arm = Taken(monkeypatch, count, error)
    _guardian_process.take_over(arm, "because", SimpleNamespace(has_ended=has_ended))
    assert arm.waits == waits
    assert arm.reasons == ["because"] * (len(waits) + 1)
    assert arm.closed == len(waits)
    assert not arm.messages


def test_an_arm_whose_port_stays_locked_is_reported(monkeypatch):
    arm = Taken(monkeypatch, 10**6, pliant.ServoError("locked"))
    _guardian_process.take_over(arm, "because", SimpleNamespace(has_ended=False))
    assert arm.time == pytest.approx(_guardian_process.OPEN_TIME, abs=0.11)
    (message,) = arm.messages
    assert message.startswith("so101 was not lowered")
    assert "(because; ServoError: locked)" in message


@pytest.mark.parametrize(("checks", "kills"), [(0, 0), (3, 1), (10**6, 1)])
def test_the_end_of_a_killed_program_is_waited_for(monkeypatch, checks, kills):
    """The program ends `checks` checks after the signal; a hanging system call may delay it."""
    beats = Beats(monkeypatch)
    killed, left = [], [checks]

    def sleep(seconds):
        left[0] -= 1
        beats.now += seconds

    monkeypatch.setattr(_guardian_process.time, "sleep", sleep)
    monkeypatch.setattr(os, "kill", lambda *arguments: killed.append(arguments))
    monkeypatch.setattr(_guardian_process.Program, "has_ended", property(lambda _: left[0] <= 0))
    beats.program.kill()
    assert killed == [(os.getppid(), signal.SIGKILL)] * kills
    assert beats.now == pytest.approx(min(0.01 * checks, _guardian_process.KILL_TIME), abs=0.011)


def test_the_arm_of_a_guardian_handles_no_signals_and_starts_no_other(monkeypatch):
    monkeypatch.setattr(_guardian_process, "Arm", lambda **options: options)
    arm, error = _guardian_process._build(pickle.dumps(("bus", {"rate": 50.0})))
    assert arm == {"drive": "bus", "rate": 50.0, "guardian": False, "handle_signals": False}
    assert error is None
    assert _guardian_process._build(pickle.dumps("bus"))[0] is None
    assert "UnpicklingError" in _guardian_process._build(b"bus")[1]


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (None, None),
        ("TypeError: wrong", "did not start: TypeError: wrong"),
        ("silence", "did not start: it did not answer"),
        (EOFError(), "did not start: it did not answer"),
        (BrokenPipeError(), "did not start: it did not answer"),
    ],
)
def test_a_guardian_that_does_not_watch_is_reported(answer, message):
    class Line:
        def send(self, content):
            sent.append(content)
            if isinstance(answer, OSError):
                raise answer

        def poll(self, seconds):
            return answer != "silence"

        def recv(self):
            if isinstance(answer, Exception):
                raise answer
            return answer

        def close(self):
            sent.append("closed")

    guardian, sent = object.__new__(Guardian), []
    guardian._line, guardian._drive = Line(), None
    drive = SimpleNamespace(closed_copy=lambda: "copy")
    if message is None:
        guardian.watch(drive, {"rate": 50.0})
        assert guardian._drive is drive
    else:
        with pytest.raises(pliant.ServoError, match=message):
            guardian.watch(drive, {"rate": 50.0})
        assert guardian._drive is None
    assert pickle.loads(sent[0]) == ("copy", {"rate": 50.0})


@pytest.mark.parametrize("found", [None, ("arm", "because")])
def test_the_process_of_the_guardian_takes_over_what_it_found(monkeypatch, found):
    calls, ignored = [], {}
    ours, theirs = os.pipe()
    memory = os.memfd_create("heartbeat")
    os.truncate(memory, 16)
    monkeypatch.setattr(signal, "signal", ignored.__setitem__)
    monkeypatch.setattr(_guardian_process, "set_policy", calls.append)
    monkeypatch.setattr(_guardian_process, "take_over", lambda *arguments: calls.append(arguments))

    def watch(program, line):
        calls.append((program.pid, line.fileno(), tuple(program._heartbeat)))
        line.close()
        return found

    monkeypatch.setattr(_guardian_process, "watch", watch)
    _guardian_process.main([str(os.getppid()), str(theirs), str(memory)])
    os.close(ours)
    os.close(memory)
    assert calls[:2] == ["SCHED_BATCH", (os.getppid(), theirs, (0.0, 0.0))]
    assert {signal.SIGINT, signal.SIGTERM, signal.SIGHUP} < ignored.keys()
    assert set(ignored.values()) == {signal.SIG_IGN}
    if found is None:
        assert len(calls) == 2
    else:
        policy, (*arm_and_reason, program) = calls[2:]
        assert (policy, tuple(arm_and_reason)) == ("SCHED_OTHER", found)
        assert program.pid == os.getppid()

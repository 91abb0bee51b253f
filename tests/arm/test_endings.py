"""End of a program: its messages; it also ends if standard error cannot be written."""

import contextlib
import io
import logging
import os
import signal
import struct
import sys
import textwrap
import time
import traceback
from types import SimpleNamespace

import numpy as np
import pytest
from programs import PIPE, Program

pytest.importorskip("mujoco", reason="these programs drive a simulated arm: extra sim")


import pliant
import pliant.arm.arm
from pliant._core import SUPPORT, torque_margin
from pliant.arm import _shutdown
from pliant.arm._guardian_process import OPEN_TIME
from pliant.arm._messages import LOGGER, MESSAGES, MessageQueue, _is_enabled
from pliant.arm._shutdown import ExitMessages, descend, exit_cause, hold_position

pytestmark = pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="signals of POSIX")

BEGIN = """
import os, signal, sys, threading, time, pliant
import numpy as np
for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT"):
    default = signal.default_int_handler if name == "SIGINT" else signal.SIG_DFL
    signal.signal(getattr(signal, name), default)

NEAR = [0.0, 1.5, 0.0, 0.0, 0.0]  # 3 cm above the end of its descent

def connect(**options):
    global arm, start
    options = {"table": False, "rest_q": None, "q": [0.0, 1.2, 0.0, 0.0, 0.0]} | options
    arm = pliant.connect("koch", backend="sim", **options)
    start = arm.drive.plant.tool[2, 3]
    return arm

def report():
    plant = arm.drive.plant
    on = arm.drive.enabled.any()
    print("torque", "on" if on else "off", "down" if plant.tool[2, 3] < start - 0.02 else "up")
    sys.stdout.flush()

def kill(name):
    os.kill(os.getpid(), getattr(signal, name))

def once(action, turns=20):
    # Run an action after some turns of the descent.
    left = [turns]
    def count():
        left[0] -= 1
        if left[0] == 0:
            action()
    arm.clock.on_tick = count
"""


@contextlib.contextmanager
def begin(program, stderr=PIPE):
    process = Program("-c", BEGIN + textwrap.dedent(program), stderr=stderr)
    try:
        yield process
    finally:
        process.kill()  # without effect if the program has already ended by itself
        process.wait()


def run(program, stderr=PIPE):
    with begin(program, stderr) as process:
        stdout, complained = process.communicate(timeout=100)
    return stdout.split(), complained, process.returncode


@contextlib.contextmanager
def reader(kind):
    """Yield a stream for standard error that is closed, full, or never read."""
    if kind == "full":
        with open("/dev/full", "w", encoding="utf-8") as file:
            yield file
        return
    read_end, write_end = os.pipe()
    if kind == "gone":
        os.close(read_end)
    else:
        os.set_blocking(write_end, False)
        with contextlib.suppress(BlockingIOError):
            while True:
                os.write(write_end, bytes(4096))
        with contextlib.suppress(BlockingIOError):
            while True:
                os.write(write_end, bytes(1))
        os.set_blocking(write_end, True)
    try:
        yield write_end
    finally:
        os.close(write_end)
        if kind != "gone":
            os.close(read_end)


DEAD = ["gone", pytest.param("full", marks=pytest.mark.full), "blocked"]


@pytest.mark.parametrize("kind", DEAD)
def test_a_signal_lowers_the_arm_although_stderr_cannot_be_written(kind):
    with reader(kind) as stderr:
        stdout, _, _ = run(
            """
            try:
                with connect():
                    once(lambda: kill("SIGINT"))
                    kill("SIGHUP")
            finally:
                report()
                os._exit(0)  # Python writes its own last words to the same reader
            """,
            stderr,
        )
    assert stdout == ["torque", "off", "down"]


@pytest.mark.parametrize("kind", DEAD)
def test_a_stalled_program_is_lowered_although_stderr_cannot_be_written(kind):
    with reader(kind) as stderr:
        stdout, _, _ = run(
            """
            def wait():
                while arm.enabled:
                    time.sleep(0.01)
                report()
                os._exit(0)
            with connect(real_time=True, comm_timeout=0.1, dt=0.005, q=NEAR):
                for tick in pliant.Loop(arm):
                    tick.skip()
                    if tick.index == 5:
                        wait()
            """,
            stderr,
        )
    assert stdout == ["torque", "off", "down"]


def test_ctrl_c_while_a_stalled_program_is_lowered_says_that_it_is_lowered_already():
    _, stderr, code = run("""
        def press():
            while not arm._supervisor.is_leaving:
                time.sleep(0.01)
            time.sleep(0.2)
            kill("SIGINT")
        with connect(real_time=True, comm_timeout=0.1, dt=0.005, q=NEAR):
            threading.Thread(target=press, daemon=True).start()
            for tick in pliant.Loop(arm):
                tick.skip()
                if tick.index == 5:
                    time.sleep(20.0)
    """)
    first, second, *_ = [line for line in stderr.splitlines() if line.startswith("pliant: ")]
    assert "the arm was taken over). Ctrl-C twice leaves at once" in first, stderr
    assert "is being lowered already. Ctrl-C again leaves at once" in second
    assert code == -signal.SIGINT


def test_a_program_that_blocks_after_ctrl_c_is_lowered():
    stdout, stderr, _ = run("""
        with connect(real_time=True, comm_timeout=0.1, dt=0.005, q=NEAR):
            def look():
                while arm.enabled:
                    time.sleep(0.01)
                report()
                os._exit(0)
            threading.Thread(target=look, daemon=True).start()
            try:
                arm.drive.read, read = lambda: (kill("SIGINT"), read())[1], arm.drive.read
                for tick in pliant.Loop(arm):
                    tick.skip()
            finally:
                threading.Event().wait()  # as a terminal that is stopped blocks a print
    """)
    assert stdout == ["torque", "off", "down"], stderr


@pytest.mark.parametrize(
    ("signals", "code"),
    [
        pytest.param(["SIGINT", 0.005, "SIGINT"], 130, marks=pytest.mark.full),
        pytest.param(["SIGTERM", 0.005, "SIGTERM", 1.0, "SIGTERM"], 143, marks=pytest.mark.full),
        (["SIGINT", *[0.033, "SIGINT"] * 25], 130),
        (["SIGHUP", 1.0, "SIGHUP", 0.005, "SIGTERM", 1.0, "SIGTERM"], 129),
        (["SIGINT", 0.2, "SIGTERM", 1.0, "SIGQUIT"], 143),
        (["SIGTERM", 0.3, "SIGINT", 0.005, "SIGINT"], 143),
        pytest.param(["SIGQUIT", 0.005, "SIGQUIT"], 131, marks=pytest.mark.full),
    ],
)
def test_no_signals_but_two_deliberate_interrupts_leave_torque_on(signals, code):
    stdout, stderr, exit_code = run(
        f"""
        def send():
            for step in {signals!r}[1:]:
                time.sleep(step) if isinstance(step, float) else kill(step)
        try:
            with connect():
                once(send, 3)
                kill({signals[0]!r})
        finally:
            report()
        """
    )
    assert stdout == ["torque", "off", "down"], stderr
    assert exit_code in {code, -signal.SIGINT if code == 130 else code}
    assert "torque OFF" in stderr


def test_a_second_interrupt_reports_the_state_and_the_next_step():
    stdout, stderr, code = run("""
        try:
            with connect():
                once(lambda: (time.sleep(1.0), kill("SIGINT")))
                kill("SIGINT")
        finally:
            plant, q = arm.drive.plant, arm.drive.plant.read().q
            report()
            arm.clock.on_tick = None
            arm.clock.wait_until(arm.clock.now() + 2.0)
            print(np.abs(plant.read().q - q).max() < 0.02)
    """)
    assert stdout == ["torque", "on", "up", "True"], stderr
    first, second = [line for line in stderr.splitlines() if line.startswith("pliant: ")]
    assert "is being lowered (Ctrl-C). Ctrl-C again leaves at once, torque ON" in first
    assert "torque ON: shoulder_lift" in second
    assert "carry it" in second
    for remedy in ("`pliant run ARM`", "support the arm and cut the supply"):
        assert remedy in second
    assert code == 130


def test_a_third_interrupt_leaves_a_bus_that_hangs():
    stdout, stderr, code = run("""
        def press():
            for _ in range(3):
                time.sleep(1.3)
                kill("SIGINT")
        try:
            with connect():
                arm.drive.write = lambda *_: threading.Event().wait()
                threading.Thread(target=press, daemon=True).start()
                kill("SIGINT")
        finally:
            report()
    """)
    assert stdout == ["torque", "on", "up"], stderr
    assert "was not lowered (SystemExit: 130): torque is ON in shoulder_pan" in stderr
    assert code == 130


def test_an_interrupt_during_the_descent_is_raised_after_it():
    stdout, stderr, code = run("""
        def step():
            with connect() as arm:
                arm.drive.read, read = lambda: (kill("SIGINT"), read())[1], arm.drive.read
                for tick in pliant.Loop(arm):
                    tick.skip()
        try:
            step()
        finally:
            report()
    """)
    assert stdout == ["torque", "off", "down"]
    lines = stderr.splitlines()
    trace = lines[lines.index("Traceback (most recent call last):") :]
    assert not any("signals.py" in line or "loop.py" in line for line in trace)
    assert trace[-2:] == ["KeyboardInterrupt", next(s for s in lines if "torque OFF" in s)]
    assert code in {130, -signal.SIGINT}


@pytest.mark.parametrize(
    ("module", "is_hidden"),
    [
        ("pliant", True),
        ("pliant.loop", True),
        ("pliant.arm._signals", True),
        ("pliantly.loop", False),
        ("program", False),
    ],
)
def test_the_traceback_of_an_interrupt_ends_in_the_program(module, is_hidden):
    scope = {"__name__": module}
    exec("def wait(): raise KeyboardInterrupt", scope)
    with pytest.raises(KeyboardInterrupt) as caught:
        scope["wait"]()
    pliant.arm.arm._end_at_the_caller(caught.value)
    names = [frame.name for frame in traceback.extract_tb(caught.value.__traceback__)]
    assert ("wait" in names) is not is_hidden


def test_endings_are_logged_where_the_program_configures_logging():
    stdout, stderr, _ = run("""
        import logging
        class Lines(logging.Handler):
            def emit(self, record):
                print(record.levelname, record.name, "torque" in record.getMessage(), flush=True)
        logging.getLogger("pliant").addHandler(Lines())
        try:
            with connect():
                raise KeyError("policy")
        except KeyError as error:
            print(len(error.__notes__), flush=True)
    """)
    assert stdout == ["WARNING", "pliant.arm", "True"] * 2 + ["1"]
    assert stderr == ""


@pytest.mark.parametrize(
    ("silence", "is_printed"),
    [
        ("", True),
        ("logging.getLogger('pliant').addHandler(logging.NullHandler())", False),
        ("logging.getLogger('pliant').setLevel(logging.CRITICAL)", False),
        ("logging.disable(logging.CRITICAL)", False),
    ],
)
def test_silence_is_had_by_the_means_of_logging(silence, is_printed):
    stdout, stderr, _ = run(f"""
        import logging
        {silence}
        with connect():
            pass
        print("quiet")
        try:
            with connect():
                raise KeyError("policy")
        except KeyError:
            report()
    """)
    assert stdout == ["quiet", "torque", "off", "down"]
    lines = stderr.splitlines()
    if is_printed:
        assert len(lines) == 2
        assert "lowered (KeyError: 'policy')" in lines[0]
    else:
        assert not lines


@pytest.mark.parametrize(
    ("own", "package", "lowest"),
    [
        (logging.NOTSET, logging.NOTSET, logging.INFO),
        (logging.NOTSET, logging.ERROR, logging.ERROR),
        (logging.DEBUG, logging.ERROR, logging.DEBUG),
        (logging.CRITICAL, logging.DEBUG, logging.CRITICAL),
    ],
)
def test_levels_of_loggers_hold_without_a_handler(monkeypatch, own, package, lowest):
    monkeypatch.setattr(LOGGER, "level", own)
    monkeypatch.setattr(logging.getLogger("pliant"), "level", package)
    levels = (logging.DEBUG, logging.INFO, logging.WARNING, logging.ERROR, logging.CRITICAL)
    assert [level for level in levels if _is_enabled(level)] == [v for v in levels if v >= lowest]
    monkeypatch.setattr(logging.root.manager, "disable", logging.ERROR)
    assert [level for level in levels if _is_enabled(level)] == [logging.CRITICAL]
    monkeypatch.setattr(LOGGER, "disabled", True)
    assert not any(map(_is_enabled, levels))


def test_an_error_during_the_descent_leaves_torque_on(make, grasp, monkeypatch, caplog):
    def fail(*_, **__):
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr(pliant.arm.arm, "descend", fail)
    arm = make()
    caplog.set_level(logging.DEBUG)
    with pytest.raises(ZeroDivisionError), arm:
        arm.write(grasp, np.zeros(7))
    MESSAGES.flush(5.0)
    arm.clock.wait_until(arm.clock.now() + 3.0)
    assert np.abs(arm.drive.plant.read().q - grasp).max() < 0.1
    assert arm.drive.enabled.all()
    assert "was not lowered (ZeroDivisionError: a bug): torque is ON in" in caplog.text


@pytest.fixture
def posted(monkeypatch):
    """Record messages instead of writing them: level by text."""
    levels = {}
    monkeypatch.setattr(MESSAGES, "post", lambda text, level, **_: levels.update({text: level}))
    return levels


@pytest.mark.parametrize("has_signal", [False, True])
def test_a_signal_during_the_descent_raises_the_level_of_its_message(make, posted, has_signal):
    arm = make()
    arm._signals = SimpleNamespace(has_pending=has_signal, stopped=False)
    for name in ("install", "hold", "begin", "deliver", "restore"):
        setattr(arm._signals, name, lambda *_: None)
    with arm:
        pass
    (level,) = (level for text, level in posted.items() if "was lowered: torque OFF" in text)
    assert level == (logging.WARNING if has_signal else logging.DEBUG)


def standing(*, gravity=(0.0, 0.0), friction=0.1, up=(0.0, 0.0, 1.0), **clock):
    """Return a part of `ArmIO` for messages: `q` is the position of the tool."""

    def forward_kinematics(q):
        base_from_tool = np.eye(4)
        base_from_tool[:3, 3] = q
        return base_from_tool

    model = SimpleNamespace(
        gravity_vector=-9.81 * np.asarray(up),
        forward_kinematics=forward_kinematics,
        joint_names=["shoulder", "elbow"],
    )
    return SimpleNamespace(
        clock=SimpleNamespace(now=lambda: 100.0, **clock),
        model=model,
        q=np.zeros(3),
        gravity=lambda: np.asarray(gravity),
        outdated=lambda: np.zeros(2, dtype=bool),
        servos=SimpleNamespace(friction=friction),
        held=None,
        last_write=99.0,
    )


@pytest.mark.parametrize(
    ("clock", "cause", "level"),
    [
        ({"real_time": True}, None, logging.INFO),
        ({"real_time": False}, None, logging.DEBUG),
        ({}, None, logging.DEBUG),
        ({"real_time": True}, "KeyError", logging.WARNING),
        ({}, "KeyError", logging.WARNING),
    ],
)
def test_an_unplanned_shutdown_is_a_warning_with_its_cause(
    posted, monkeypatch, clock, cause, level
):
    messages = ExitMessages("arm", standing(**clock), cause)
    messages.begin()
    assert all((" (KeyError)" if cause else "lowered. ") in text for text in posted)
    messages.lowered()
    messages.left_enabled()
    assert len(posted) == 3
    assert set(posted.values()) == {level}
    messages.left_enabled(stopped=True)
    assert list(posted.values())[-1] == logging.WARNING
    posted.clear()
    begin = time.monotonic()
    for seconds in (0.9, 1.1, 2.0, 2.2):
        monkeypatch.setattr(time, "monotonic", lambda seconds=seconds: begin + seconds)
        messages.progress(SimpleNamespace(phase=f"down at {seconds}"))
    assert list(posted.values()) == [logging.INFO if clock.get("real_time") else logging.DEBUG] * 2
    assert ["1.1" in text or "2.2" in text for text in posted] == [True, True]


def test_lines_of_progress_end_with_the_port(posted, monkeypatch):
    monkeypatch.setattr(pliant.arm._shutdown, "PROGRESS", 0.0)
    messages = ExitMessages("left", standing(), None, ports=" (/dev/ttyUSB0)")
    messages.progress(SimpleNamespace(phase="down"))
    (text,) = posted
    assert text.startswith("left: down, tool 0 cm lower, ")
    assert text.endswith(" s (/dev/ttyUSB0)")


def test_the_announcement_tells_how_to_abort(posted):
    messages = ExitMessages("arm", standing(), None)
    for arguments in ({}, {"interrupted": True}, {"abort": "Closing the page leaves"}):
        messages.begin(**arguments)
    for text, way in zip(posted, ("Ctrl-C twice", "Ctrl-C again", "Closing the page"), strict=True):
        assert f". {way} leaves at once, torque ON" in text


def test_a_descent_that_does_not_end_says_rarely_what_it_waits_for(posted, monkeypatch):
    monkeypatch.setattr(pliant.arm._shutdown, "PROGRESS", 0.0)
    arm = standing(real_time=True)
    messages = ExitMessages("arm", arm, None)
    messages.begin(abort="`kill -9 7` leaves")
    posted.clear()
    for seconds in range(100, 300):
        arm.clock.now = lambda seconds=seconds: seconds
        messages.progress(SimpleNamespace(phase="down"))
    reminders = [text for text in posted if "take away the hand" in text]
    for seconds, text in zip((46, 107, 168), reminders, strict=True):
        assert f" after {seconds} s," in text
    assert all(text.endswith("`kill -9 7` leaves at once, torque ON") for text in reminders)
    assert {posted[text] for text in reminders} == {logging.WARNING}


def test_the_progress_of_an_arm_that_a_hand_moves_says_so(posted, monkeypatch):
    monkeypatch.setattr(pliant.arm._shutdown, "PROGRESS", 0.0)
    arm = standing(real_time=True)
    messages = ExitMessages("arm", arm, None)
    start = arm.clock.now()
    for second in range(30):
        arm.clock.now = lambda second=second: start + second
        arm.q = np.array([0.0, 0.0, -0.02 * min(second, 10)])  # lower until 10 s
        messages.progress(SimpleNamespace(phase="down"))
    stalled = [text for text in posted if text.endswith(" s, not at rest: is a hand on it?")]
    assert len(stalled) == 13  # from 17 s on, because it gets 2 cm lower after 9 s
    posted.clear()
    messages.progress(SimpleNamespace(phase="ramp"))
    assert "hand" not in next(iter(posted))


@pytest.mark.parametrize(
    ("gravity", "friction", "expected"),
    [
        ((-2.0, 1.0), 0.1, "shoulder, elbow carry it"),
        ((0.5, 3.0), 0.1, "elbow, shoulder carry it"),
        ((0.05, -3.0), 0.1, "elbow carries it"),
        ((0.05, -0.09), 0.1, "no joint carries much"),
        ((9e-4, 0.0), 0.0, "no joint carries much"),
    ],
)
def test_joints_that_carry_an_arm_left_enabled_are_named(posted, gravity, friction, expected):
    arm = standing(gravity=gravity, friction=friction)
    assert f"torque ON: {expected}. " in ExitMessages("arm", arm, None).left_enabled()
    assert len(posted) == 1


@pytest.mark.parametrize(
    ("up", "moved", "expected"),
    [
        ((0.0, 0.0, 1.0), (5.0, 5.0, -0.2), "tool 20 cm lower"),
        ((0.0, 0.0, 1.0), (0.0, 0.0, 0.006), "tool 1 cm higher"),
        ((0.0, 0.0, 1.0), (0.0, 0.0, 0.004), "tool 0 cm lower"),
        ((1.0, 0.0, 0.0), (0.2, 5.0, 5.0), "tool 20 cm higher"),
        ((0.0, 0.0, 1.0), (0.0, 0.0, np.nan), "height not known"),
        ((0.0, 0.0, 1.0), "lost", "height not known"),
    ],
)
def test_a_descent_is_measured_against_gravity(posted, up, moved, expected):
    arm = standing(up=up)
    messages = ExitMessages("arm", arm, None)
    assert ", tool 0 cm lower, 0.0 s" in messages.lowered()
    messages.progress(None)
    arm.q = moved
    assert f", {expected}, " in messages.lowered()


@pytest.mark.parametrize(
    ("last_write", "expected"), [(99.0, "tool 30 cm lower"), (100.0, "tool 0 cm lower")]
)
def test_a_fall_between_the_loop_and_the_descent_counts(posted, last_write, expected):
    """The fall does not count if the program has moved the arm since the loop."""
    arm = standing()
    arm.held, arm.last_write = (99.5, np.array([0.0, 0.0, 0.3])), last_write
    messages = ExitMessages("arm", arm, None)
    messages.progress(None)
    assert f", {expected}, " in messages.lowered()


@pytest.mark.parametrize("when", ["begin", "end"])
def test_the_height_of_an_arm_with_a_silent_joint_is_not_known(posted, when):
    arm = standing()
    known, silent = arm.outdated, lambda: np.array([False, True])
    messages = ExitMessages("arm", arm, None)
    arm.outdated = silent if when == "begin" else known
    messages.progress(None)
    arm.q, arm.outdated = (0.0, 0.0, -0.2), silent if when == "end" else known
    assert ", height not known, 0.0 s" in messages.lowered()


@pytest.mark.parametrize(
    ("on", "unknown", "down", "expected"),
    [
        (None, [], False, "was not lowered, the bus is gone"),
        ([], [], False, "was not lowered (ValueError: why): torque is OFF"),
        (
            ["a", "b"],
            [],
            True,
            "rests, but torque off failed (ValueError: why): torque is ON in a,",
        ),
        (["a", "b"], ["b"], False, "torque is ON in a and torque is not known in b. "),
        ([], ["a", "b"], False, ": torque is not known in a, b. "),
    ],
)
def test_a_failed_descent_names_joints_that_may_have_torque(posted, on, unknown, down, expected):
    text = ExitMessages("arm", standing(), None).failed(ValueError("why"), on, unknown, down=down)
    assert expected in text
    assert posted == {text: logging.WARNING}


@pytest.mark.parametrize("has_guardian", [False, True])
def test_the_message_of_a_lost_bus_tells_of_the_guardian(posted, has_guardian):
    messages = ExitMessages("arm", standing(), None)
    text = messages.failed(ValueError("why"), None, has_guardian=has_guardian)
    assert "start the program again, which takes the arm over" in text
    chance = f"guardian lowers it in the {OPEN_TIME:.0f} s after this program has closed"
    assert (chance in text) is has_guardian


def test_joints_with_registers_of_this_program_are_named(posted):
    ExitMessages("arm", standing(), None).unrestored(["elbow", "wrist"])
    ((text, level),) = posted.items()
    assert "elbow, wrist" in text
    assert level == logging.WARNING


@pytest.mark.parametrize(
    ("error", "cause"),
    [
        (None, None),
        (GeneratorExit(), None),
        (SystemExit(1), None),
        (KeyboardInterrupt(), "Ctrl-C"),
        (SystemExit(128 + signal.SIGTERM), "SIGTERM"),
        (ValueError("one\ntwo"), "ValueError: one"),
        (ValueError(), "ValueError"),
        (ValueError("x" * 148), f"ValueError: {'x' * 148}"),
        (ValueError("x" * 149), f"ValueError: {'x' * 145}..."),
        (pliant.ServoError("x" * 300), f"ServoError: {'x' * 300}"),
    ],
)
def test_a_shutdown_has_its_cause_in_one_short_line(error, cause):
    assert exit_cause(error) == cause


class Descent:
    """A descent of an arm whose joints never move; every tick takes 10 ms, or a `stall` once [s].

    Attributes:
        made: Arguments of each `Lowering` object that was created.
        skipped: Number of orders sent before each end of the motion toward the rest pose.
        sent: Time and speed limit of each order.
        answers: Number of `sample` calls after which a silent joint has answered, None: never.
        unfit: Number of `sample` calls after which a joint may not follow its goals, None: never.
        silent_joint: True if the position of a joint is outdated.
    """

    phase, answers, unfit, silent_joint = "down", None, None, False

    def __init__(self, monkeypatch, *, orders=10, is_silent=False, is_refused=False, stall=0.0):
        self.time, self.made, self.sent, self.calls, self.samples = 100.0, [], [], [], 0
        self.skipped, self.taken = [], []
        self.orders, self.silent, self.refused, self.stall = orders, is_silent, is_refused, stall
        self.speed_limit = np.full(2, np.inf)
        self.model, self.servos = SimpleNamespace(n=2), None
        self.q, self.goal, self.limit = np.zeros(2), np.ones(2), np.full(2, 3.0)
        self.torque_unknown = np.zeros(2, dtype=bool)
        self.clock = SimpleNamespace(now=lambda: self.time, wait_until=self.wait_until)
        monkeypatch.setattr(_shutdown, "Lowering", self.lowering)

    def lowering(self, model, servos, q, **arguments):
        self.made.append(arguments)
        self.left = self.orders
        return self

    @property
    def last_write(self):
        return self.sent[-1][0] if self.sent else -np.inf

    def skip_rest(self):
        self.skipped.append(len(self.sent))
        self.phase = "down"

    def take_over(self, joints, q, goal, limit):
        assert (q is self.q, goal is self.goal, limit is self.limit) == (True,) * 3
        self.taken.append((joints.tolist(), len(self.sent)))
        self.left = self.orders

    def wait_until(self, deadline):
        self.time = max(self.time, deadline)

    def step(self, q, ok, *, dt, age):
        self.left -= 1
        assert ok.dtype == bool
        assert ok.all() == (not self.silent)
        if self.left == self.orders - 2:
            self.time += self.stall
        return (
            None
            if self.left < 0
            else SimpleNamespace(goal=q, torque_limit=q, speed_limit=self.speed_limit)
        )

    def sample(self):
        self.samples += 1
        if self.silent:
            raise pliant.ServoError("no answer")
        return np.ones(2, dtype=bool)

    def resume_silent(self):
        if self.samples != self.answers:
            return None
        self.torque_unknown[:] = False
        return np.array([True, False])

    def unknown_joints(self):
        return ["elbow"]

    def unfit_joints(self, now):
        reasons = {"elbow": "no answer", "wrist": "no answer", "shoulder": "too hot"}
        return reasons if self.samples == self.unfit else {}

    def delay(self, now):
        return 0.0

    def is_refused(self):
        return self.refused

    def outdated(self):
        return np.array([self.silent_joint, False])

    def set_watchdog(self, seconds):
        self.calls.append(seconds)
        raise pliant.ServoError("a lost reply")

    def send(self, goal, limit, speed_limit):
        self.sent.append((self.time, speed_limit))
        raise pliant.ServoError("a lost packet")


def test_a_descent_sends_its_orders_at_its_rate(monkeypatch):
    run = Descent(monkeypatch, stall=0.055)
    ticks = []
    assert descend(run, None, 100.0, lambda: False, on_tick=ticks.append)
    assert run.calls == [0.0]  # switch the watchdogs off first
    assert len(ticks) == 10
    # After a stall, the loop does not make up for all ticks that it missed.
    assert np.diff([time for time, _ in run.sent]) == pytest.approx([0.065, 0.0, 0.0, *[0.01] * 6])
    assert [speed for _, speed in run.sent] == [None] * 10


def test_a_blind_descent_limits_the_speed_of_the_servos(monkeypatch):
    run = Descent(monkeypatch)
    run.speed_limit[1] = 0.1  # the first joint has a position again
    assert descend(run, None, 100.0, lambda: False)
    assert all(speed is run.speed_limit for _, speed in run.sent)


def test_an_aborted_descent_leaves_torque_on(monkeypatch):
    run = Descent(monkeypatch)
    assert descend(run, None, 100.0, lambda: len(run.sent) == 4) is False


def test_a_descent_ends_if_the_bus_is_silent_for_long(monkeypatch):
    run = Descent(monkeypatch, orders=1000, is_silent=True)
    with pytest.raises(pliant.ServoError, match="the bus is gone"):
        descend(run, None, 100.0, lambda: False)
    assert run.time == pytest.approx(100.0 + _shutdown.MAX_SILENCE, abs=0.011)


def test_a_descent_whose_goals_are_rejected_starts_again_a_few_times(monkeypatch):
    run = Descent(monkeypatch, is_refused=True)
    with pytest.raises(pliant.ServoFaultError, match="do not take the goals"):
        descend(run, "rest", 100.0, lambda: False)
    assert len(run.made) == 1 + _shutdown.MAX_RESTARTS
    assert len(run.sent) == 10 * len(run.made)
    assert [made["rest"] for made in run.made] == ["rest"] * 3


def test_a_descent_whose_goals_are_rejected_does_not_start_again_from_an_old_position(monkeypatch):
    run = Descent(monkeypatch, is_refused=True)
    run.silent_joint = True
    with pytest.raises(pliant.ServoFaultError, match="do not take the goals"):
        descend(run, "rest", 100.0, lambda: False)
    assert len(run.made) == 1


@pytest.mark.parametrize("phase", ["rest", "down"])
def test_the_move_to_the_rest_pose_ends_where_a_joint_may_not_follow(monkeypatch, phase):
    run, reasons = Descent(monkeypatch, is_refused=True), []
    run.phase, run.unfit = phase, 5
    with pytest.raises(pliant.ServoFaultError, match="do not take the goals"):
        descend(run, "rest", 100.0, lambda: False, on_detour=reasons.append)
    is_ended = phase == "rest"
    told = "elbow, wrist (no answer), shoulder (too hot) may not follow to the rest pose"
    assert reasons == [told] * is_ended
    assert run.skipped == [4] * is_ended
    assert [made["rest"] for made in run.made] == ["rest", *[None if is_ended else "rest"] * 2]


@pytest.mark.parametrize("phase", ["rest", "down", "ramp"])
def test_a_descent_goes_on_from_present_goals_once_a_silent_joint_answers(monkeypatch, phase):
    run = Descent(monkeypatch)
    run.phase, run.answers = phase, 5
    run.torque_unknown[0] = True
    assert descend(run, "rest", 100.0, lambda: False)
    # Torque limits go to zero only once the torque of all joints is known.
    assert len(run.sent) == (10 if phase == "ramp" else 14)
    assert run.made == [{"goal": run.goal, "limit": run.limit, "rest": "rest"}]
    assert run.taken == [([True, False], 0 if phase == "ramp" else 4)]
    run.answers, run.samples = None, 0
    run.torque_unknown[0] = True
    if phase == "ramp":
        with pytest.raises(pliant.ServoFaultError, match="no answer from elbow"):
            descend(run, "rest", 100.0, lambda: False)


@pytest.mark.parametrize(
    ("lead", "present", "held", "limit"),
    [
        # Leads with which a servo of 1, 1 / 1.9 or 2 times the assumed stiffness carries the arm.
        (1.0, 3.0, 1.0, None),
        (1.9, 3.0, 1.9, None),
        (0.5, 3.0, 0.5, None),
        (9.0, 3.0, "highest", None),
        (-9.0, 3.0, "lowest", None),
        # If a servo holds its joint at the torque limit, this limit is not raised.
        (1.5, 1.1, 1.5, 1.1),
        (1.5, 0.9, 1.5, None),
        (1.05, 1.1, 1.05, None),
    ],
)
def test_an_arm_is_held_by_leads_that_can_carry_it(lead, present, held, limit):
    """Leads and limits in the table are multiples of the lead and torque that carry the weight."""
    arm, sent, watchdogs = pliant.robots.load("so101"), [], []
    servos = pliant.connect("so101", backend="sim", handle_signals=False).servos
    weight = np.array([0.5, -0.8, 0.6, 0.3, -0.4])
    need, q = weight / np.asarray(servos.kp), np.full(arm.n, 0.1)
    hold_position(
        SimpleNamespace(
            servos=servos,
            gravity=lambda: weight,
            q=q,
            goal=q + lead * need,
            limit=present * np.abs(weight),
            outdated=lambda: np.zeros(arm.n, dtype=bool),
            send=lambda *orders: sent.append(orders),
            set_watchdog=watchdogs.append,
        )
    )
    ((goal, torque),) = sent
    push = torque_margin(servos, weight)
    margin = np.sign(weight) * push / np.asarray(servos.kp)
    ends = {"lowest": need / 2.5 - margin, "highest": 2.0 * need + margin}
    assert goal - q == pytest.approx(ends[held] if held in ends else held * need)
    most = SUPPORT * np.abs(weight) + push
    assert torque == pytest.approx(
        most if limit is None else np.minimum(limit * np.abs(weight), most)
    )
    assert watchdogs == [0.0]


def test_a_silent_joint_of_an_arm_that_is_held_keeps_its_last_goal():
    arm, sent = pliant.robots.load("so101"), []
    silent = np.array([False, True, False, False, False])
    io = SimpleNamespace(
        servos=pliant.connect("so101", backend="sim", handle_signals=False).servos,
        gravity=lambda: np.full(arm.n, 0.1),
        q=np.full(arm.n, 0.1),
        goal=np.full(arm.n, 0.9),
        limit=np.full(arm.n, 0.2),
        outdated=lambda: silent,
        send=lambda *orders: sent.append(orders),
        set_watchdog=lambda _: None,
    )
    hold_position(io)
    ((goal, limit, speed),) = sent
    assert (goal[silent], limit[silent]) == (pytest.approx([0.9]), pytest.approx([0.2]))
    # The servo may have missed this goal, and must not jump there.
    assert speed[silent] == pytest.approx([0.01])
    assert np.isinf(speed[~silent]).all()
    assert np.abs(goal[~silent] - io.q[~silent]).max() < 0.2


@pytest.mark.parametrize("direction", ["lower", "higher"])
def test_messages_tell_how_far_the_tool_has_moved(make, direction):
    hanging, raised = np.zeros(7), np.array([-3.0, *np.zeros(6)])
    poses = [raised, hanging] if direction == "lower" else [hanging, raised]
    arm = make(q=poses[0])
    arm.open()
    arm._io.sample()
    messages, before = ExitMessages("arm", arm._io, None), arm.drive.plant.tool[2, 3]
    messages.progress(None)
    arm.drive.plant.reset(poses[1])
    arm._io.positions.reset()
    arm._io.sample()
    moved = abs(arm.drive.plant.tool[2, 3] - before)
    assert moved > 1.0
    assert f"tool {100 * moved:.0f} cm {direction}" in messages.lowered()


def test_progress_never_disturbs_a_descent(make, monkeypatch):
    arm = make()
    messages = ExitMessages("arm", arm._io, None)
    monkeypatch.setattr(pliant.arm._shutdown, "PROGRESS", 0.0)
    messages.progress(None)
    monkeypatch.setattr(MESSAGES, "post", lambda *_, **__: 1 / 0)
    messages.progress(None)


def test_a_blocked_reader_is_waited_for_once():
    with reader("blocked") as stderr:
        stdout, _, _ = run(
            """
            from pliant.arm._messages import MESSAGES
            MESSAGES.start()
            message = MESSAGES.post("text", 40)
            for _ in range(20):
                MESSAGES.flush(0.05)
            print(message.is_written)
            """,
            stderr,
        )
    assert stdout == ["False"]


def test_a_message_of_a_process_without_the_thread_counts_as_written():
    assert MessageQueue().post("nothing is started").is_written


@pytest.mark.parametrize("has_handler", [False, True])
def test_progress_is_rare_where_lines_stay(capfd, caplog, monkeypatch, has_handler):
    monkeypatch.setattr(LOGGER, "hasHandlers", lambda: has_handler)
    monkeypatch.setattr(sys, "stderr", sys.__stderr__)
    caplog.set_level(logging.DEBUG)
    messages = MessageQueue()
    messages.start()
    for second in range(12):
        monkeypatch.setattr(time, "monotonic", lambda second=second: float(second))
        message = messages.post(f"second {second}", progress=True)
        while not message.is_written:
            pass
    lines = caplog.messages if has_handler else capfd.readouterr().err.splitlines()
    prefix = "" if has_handler else "pliant: "
    assert lines == [f"{prefix}second {second}" for second in (0, 5, 10)]


def written(*lines):
    """Write messages, (text, is progress) each, to standard error without a handler."""
    messages = MessageQueue()
    messages.start()
    for text, is_progress in lines:
        message = messages.post(text, progress=is_progress)
        messages.flush(5.0)
        assert message.is_written


@pytest.mark.parametrize(("columns", "width"), [(30, 29), (0, 79)])
def test_a_terminal_shows_progress_in_one_line(monkeypatch, columns, width):
    fcntl, termios = pytest.importorskip("fcntl"), pytest.importorskip("termios")
    ours, theirs = os.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
    monkeypatch.setattr(LOGGER, "hasHandlers", lambda: False)
    monkeypatch.setenv("TERM", "xterm")
    with open(theirs, "w", encoding="utf-8") as terminal, open(ours, "rb", buffering=0) as shown:
        for name in ("stderr", "__stderr__"):
            monkeypatch.setattr(sys, name, terminal)
        written(("begin", False), ("down", True), ("d" * 99, True), ("end", False), ("x", False))
        monkeypatch.setenv("TERM", "dumb")
        written(("plain", False), ("down", True), ("end", False))
        os.write(theirs, b"!")
        text = b""
        while not text.endswith(b"!"):
            text += shown.read(1000)
    long, clear = f"pliant: {'d' * 99}"[:width], "\r\x1b[K"
    assert text.decode().replace("\r\r\n", "\r\n") == (
        f"pliant: begin\r\n{clear}pliant: down{clear}{long}{clear}pliant: end\r\npliant: x\r\n"
        "pliant: plain\r\npliant: end\r\n!"
    )


@pytest.mark.parametrize("stream", [None, io.StringIO()])
def test_messages_go_to_a_replaced_standard_error(monkeypatch, stream):
    monkeypatch.setattr(LOGGER, "hasHandlers", lambda: False)
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setattr(LOGGER, "level", logging.INFO)
    written(("begin", False), ("down", True), ("end", False))
    assert stream is None or stream.getvalue() == "pliant: begin\npliant: end\n"

"""End of a program: its messages; it also ends if standard error cannot be written."""

import contextlib
import logging
import os
import signal
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
from pliant.arm._messages import LOGGER, MESSAGES, MessageQueue, _is_enabled
from pliant.arm._shutdown import ExitMessages

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
        process.kill()  # if the program has not ended by itself, which some of these tests check
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


@pytest.mark.parametrize("has_signal", [False, True])
def test_a_signal_during_the_descent_raises_the_level_of_its_message(make, monkeypatch, has_signal):
    arm, levels = make(), {}
    arm._signals = SimpleNamespace(has_pending=has_signal, stopped=False)
    for name in ("install", "hold", "begin", "deliver", "restore"):
        setattr(arm._signals, name, lambda *_: None)
    monkeypatch.setattr(MESSAGES, "post", lambda text, level, **_: levels.update({text: level}))
    with arm:
        pass
    (level,) = (level for text, level in levels.items() if "was lowered: torque OFF" in text)
    assert level == (logging.WARNING if has_signal else logging.DEBUG)


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


def test_progress_is_rare_on_a_stream_that_is_not_a_terminal(capfd, monkeypatch):
    monkeypatch.setattr(LOGGER, "hasHandlers", lambda: False)
    monkeypatch.setattr(sys, "stderr", sys.__stderr__)
    messages = MessageQueue()
    messages.start()
    for second in range(12):
        monkeypatch.setattr(time, "monotonic", lambda second=second: float(second))
        message = messages.post(f"second {second}", progress=True)
        while not message.is_written:
            pass
    assert capfd.readouterr().err.splitlines() == [
        "pliant: second 0",
        "pliant: second 5",
        "pliant: second 10",
    ]

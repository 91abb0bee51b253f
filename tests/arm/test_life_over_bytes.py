"""Random programs on an emulated bus with faults: torque, torque limits and owner of the arm.

`test_life.py` explores signals with a stand-in for the descent; here every descent is real.
"""

from __future__ import annotations

import heapq
import signal
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rustypot", reason="servo buses need the extra servo")
pytest.importorskip("mujoco", reason="the arm behind the bytes needs the extra sim")

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    rule,
    run_state_machine_as_test,
)

import pliant
import pliant.arm._signals
from pliant.arm import Arm
from pliant.emulator import Faults, ManualClock, Mount, emulate
from pliant.emulator.faults import KINDS
from pliant.servo import ServoBus, ServoSpec
from pliant.servo.spec import at_voltage

#: Robot and servo of each family, and name of its torque limit register.
FAMILIES = {"sts": ("so101", "STS3215", "STS3215-7.4V"), "x": ("koch", "XL430-W250", None)}
#: Poses in which the tool is 3 cm and 32 cm above the end of its descent [rad].
POSES = {"low": [0.0, 1.5, 0.0, 0.0, 0.0], "high": [0.0, 0.2, 0.0, 0.2, 0.0]}
NUMBERS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]
#: Largest downward speed of the tool with torque on [m/s]: a descent reaches 0.15, torque on 0.17,
#: and a falling arm 0.6. No target here is below the tool.
FASTEST = 0.25
#: Largest speed [m/s] and motion [m] of the tool once a servo of the chain has lost its torque.
FASTEST_OFF, FARTHEST_OFF = 0.1, 0.02
#: Probability of each fault per transaction on a noisy bus.
NOISY = {"deaf": 0.02, "lose": 0.02, "corrupt": 0.02, "truncate": 0.01, "noise": 0.02, "late": 0.01}


class Clock(ManualClock):
    """Emulated time in which scheduled actions happen."""

    def __init__(self, bus):
        super().__init__(bus)
        self.due = []

    def after(self, seconds, action):
        heapq.heappush(self.due, (self.now() + seconds, len(self.due), action))

    def wait_until(self, deadline):
        while self.due and self.due[0][0] <= deadline:
            time, _, action = heapq.heappop(self.due)
            super().wait_until(time)
            action()
        super().wait_until(deadline)


class RecordingBus(ServoBus):
    """Servo bus that stores the torque limits of the last command in `commanded` [N·m]."""

    commanded = None

    def write(self, goal, limit, velocity=None):
        self.commanded = np.array(limit)
        super().write(goal, limit, velocity)

    def enable(self, goal, limit, lead=None):
        self.commanded = np.array(limit)
        super().enable(goal, limit, lead)


class Life(RuleBasedStateMachine):
    """Random program on a bus with random faults; it fails if the arm drops."""

    poses = ("low",)

    def __init__(self):
        super().__init__()
        self.patch, self.wrong, self.arm = pytest.MonkeyPatch(), [], None
        self.handlers = {n: signal.signal(n, lambda *_: None) for n in NUMBERS}
        self.is_left, self.interrupts, self.fell, self.has_tripped = False, 0, None, False

    @initialize(
        family=st.sampled_from(sorted(FAMILIES)),
        data=st.data(),
        seed=st.integers(0, 10_000),
        noisy=st.booleans(),
        watchdog=st.sampled_from([0.0, 0.2]),
    )
    def make(self, family, data, seed, noisy, watchdog):
        self.watchdog = watchdog
        robot, device, self.known = FAMILIES[family]
        self.device = device
        self.model = pliant.robots.load(robot)
        self.names = [*self.model.joint_names, "gripper"]
        mounts = [Mount(joint=n, model=device, id=k) for k, n in enumerate(self.names, 1)]
        pose = POSES[data.draw(st.sampled_from(self.poses), label="pose")]
        self.bus = emulate(
            self.model,
            mounts,
            q=np.array(pose),
            clock="steps",
            plant={},
            held=True,
            faults=Faults(seed=seed),
        )
        self.bus.start()
        self.line, self.clock = self.bus.lines["main"], Clock(self.bus)
        self.n = self.model.n
        self.in_force = np.zeros(self.n)
        self.volts = np.full(self.n, self.bus.servo(1).supply)
        self.patch.setattr(
            pliant.arm._signals, "time", SimpleNamespace(monotonic=lambda: self.bus.time)
        )
        step, write = self.bus.world.physics.step, self.bus.plant.write

        def watched_step(count):
            step(count)
            self.watch()

        def watched_write(goals, limits, extra):
            write(goals, limits, extra)
            self.compare(np.array(limits))

        self.bus.world.physics.step = watched_step
        self.patch.setattr(self.bus.plant, "write", watched_write)
        if noisy:
            self.bus.faults.by_chance(**NOISY)
        self.connect()

    def teardown(self):
        if hasattr(self, "clock"):
            self.clock.due.clear()
            self.bus.faults.clear()
            self.line.dead = False
            try:
                if self.is_left:
                    self.enable()
                self.ending(self.arm.close)
                self.settle()
                assert self.has_tripped or not self.powered().any()
                self.nothing_is_wrong()
            finally:
                self.bus.stop()
        for number, handler in self.handlers.items():
            signal.signal(number, handler)
        self.patch.undo()

    # --- Checks ---

    def powered(self):
        return np.array([self.bus.servo(k).get("torque_enable") == 1 for k in range(1, self.n + 1)])

    def watch(self):
        """Check owner, speed and torque after a step of the physics."""
        on = self.powered()
        if on.any() and not (self.arm.enabled or self.is_left):
            self.wrong.append(f"{self.bus.time:.2f} s: nobody owns the arm, torque {on}")
        if self.has_tripped:
            # A servo without torque drops its load.
            return
        tool = self.bus.plant.ground_truth.frame("tool")
        place, velocity = self.bus.plant.tool[:3, 3].copy(), tool.twist()[:3]
        if self.was_on.all() and not on.all():
            self.fell = place
        if on.all():
            self.fell = None
        self.was_on = on
        too_fast = (
            -velocity[2] > FASTEST if self.fell is None else np.linalg.norm(velocity) > FASTEST_OFF
        )
        if too_fast:
            self.wrong.append(f"{self.bus.time:.2f} s: the tool moves at {velocity} m/s, {on}")
        if self.fell is not None and np.linalg.norm(place - self.fell) > FARTHEST_OFF:
            self.wrong.append(f"{self.bus.time:.2f} s: the tool fell to {place}, {on}")

    was_on = np.zeros(1, dtype=bool)

    def compare(self, limits):
        """Check that no torque limit in a servo rises beyond the limit of the last command.

        A servo's limit is a share of its stall torque, so it grows with the supply until the
        program has read the new voltage. The driver's table is not proportional to the voltage: at
        4 V an emulated XL430 has 13 % more torque.
        """
        commanded = self.arm.drive.commanded
        bound = (
            self.in_force if commanded is None else np.maximum(self.in_force, commanded[: self.n])
        )
        devices = self.arm.drive._devices[: self.n]
        if all(device.voltage is not None for device in devices):
            self.volts = np.array([device.units.voltage for device in devices])
        table = self.arm.drive.specs[0].row.stall
        assumed = np.array([at_voltage(table, volts) for volts in self.volts])
        bound = bound * np.maximum(1.0, self.bus.servo(1).stall / assumed)
        if np.any(limits > 1.01 * bound + 1e-6):
            self.wrong.append(f"{self.bus.time:.2f} s: limits {limits}, commanded {commanded}")
        self.in_force = limits

    @invariant()
    def nothing_is_wrong(self):
        assert not self.wrong, self.wrong[:5]

    # --- Steps of the program ---

    def connect(self):
        specs = [
            ServoSpec(name=n, model=self.known or self.device, id=k, port=self.bus.port)
            for k, n in enumerate(self.names, 1)
        ]
        drive = RecordingBus(specs, reply_timeout_min=0.01, clock=self.clock)
        if self.arm is not None:
            drive.commanded = self.arm.drive.commanded
        self.arm = Arm(self.model, drive, watchdog=self.watchdog, guardian=False)

    def ending(self, action):
        """Run an action; after an exception close the arm, as the end of a `with` block does."""
        try:
            action()
        except (pliant.ServoError, KeyboardInterrupt, SystemExit) as error:
            self.excuse(error)
            try:
                self.arm.close()
            except (pliant.ServoError, KeyboardInterrupt, SystemExit) as worse:
                self.excuse(worse)
            if self.interrupts >= 2:
                self.is_left = True

    def excuse(self, error):
        """Note that torque may stay on: the line is dead, a servo tripped, or the error says so."""
        is_told = "torque may still be on" in str(error) or "torque stays on" in str(error)
        if self.line.dead or is_told or self.has_tripped:
            self.is_left = True

    def settle(self):
        self.clock.wait_until(self.clock.now() + 0.5)

    def raise_signal(self, number):
        self.interrupts += number == signal.SIGINT
        signal.raise_signal(number)

    @rule()
    def enable(self):
        if self.arm.enabled:
            return
        self.interrupts = 0
        if self.is_left:
            self.connect()
        self.ending(self.arm.enable)
        if self.arm.enabled:
            # A servo may have tripped while torque came on.
            self.is_left, self.has_tripped = False, not self.powered().all()

    @rule(
        seconds=st.sampled_from([0.1, 0.3, 0.6]),
        soft=st.sampled_from(["y", "x y", "z"]),
        way=st.sampled_from([(0.0, 0.0, 0.0), (0.0, 0.05, 0.0), (0.0, 0.0, 0.04), (0.3, 0.3, 0.3)]),
    )
    def run(self, seconds, soft, way):
        def ticks():
            soft_settings = pliant.Settings.soft(soft, task="xyz")
            controller = pliant.Controller(self.arm.model, soft_settings, self.arm.servos)
            target = self.arm.model.forward_kinematics(self.arm.read().q)[:3, 3] + way
            for tick in pliant.Loop(self.arm, controller, duration=seconds):
                command = tick.step(target)
                commanded = self.arm.drive.commanded[: self.n]
                if np.any(commanded > command.torque_limit + 1e-9):
                    self.wrong.append(
                        f"commanded {commanded}, the step gave {command.torque_limit}"
                    )

        if self.arm.enabled:
            self.ending(ticks)

    @rule(start=st.sampled_from([0.0, 0.07, 0.4]), seconds=st.sampled_from([0.03, 0.3, 0.7]))
    def silence(self, start, seconds):
        """Short-circuit the line after `start` [s], for `seconds`."""
        self.clock.after(start, lambda: setattr(self.line, "dead", True))
        self.clock.after(start + seconds, lambda: setattr(self.line, "dead", False))

    @rule(start=st.sampled_from([0.0, 0.05, 0.5]), number=st.sampled_from(NUMBERS))
    def signal(self, start, number):
        """Send a signal to the program after `start` [s], whatever it does at that time."""
        self.clock.after(start, lambda: self.raise_signal(number))

    @rule(
        kind=st.sampled_from([k for k in KINDS if k != "deaf"] * 2 + ["deaf"]),
        count=st.integers(1, 8),
        skip=st.integers(0, 60),
    )
    def lose(self, kind, count, skip):
        """Lose, delay or damage packets, the next ones or later ones."""
        self.bus.faults.inject(kind, count=count, skip=skip)

    @rule(
        start=st.sampled_from([0.0, 0.1, 0.4]),
        kind=st.sampled_from(["reset", "overload", "heat", "voltage"]),
        joint=st.integers(1, 5),
    )
    def trip(self, start, kind, joint):
        """Let a servo reset, or switch itself off, later."""

        def act():
            self.has_tripped = True
            if kind == "reset":
                self.bus.reboot(joint)
            else:
                self.bus.trip(joint, kind)

        self.clock.after(start, act)

    @rule(volts=st.sampled_from([4.0, 20.0]), seconds=st.sampled_from([0.1, 1.0]))
    def vary_supply(self, volts, seconds):
        """Change the supply beyond the range of the servos, for a time."""
        usual = self.bus.servo(1).supply

        def act():
            self.has_tripped = True
            self.bus.supply(volts)

        self.clock.after(0.0, act)
        self.clock.after(seconds, lambda: self.bus.supply(usual))

    @rule(seconds=st.sampled_from([0.3, 1.5]))
    def stall(self, seconds):
        """Do nothing for `seconds`."""
        self.ending(lambda: self.clock.wait_until(self.clock.now() + seconds))

    @rule()
    def take_over(self):
        """Leave the arm with torque on, and let another program take it over."""
        if self.arm.enabled:
            self.is_left = True
            self.ending(self.arm.leave_enabled)
            self.ending(self.arm.close)
            self.enable()

    @rule(verb=st.sampled_from(["lower", "close"]))
    def leave(self, verb):
        self.ending(getattr(self.arm, verb))
        self.settle()


class HighLife(Life):
    """Random program that may also start high above the table, with a long descent."""

    poses = ("low", "high")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("machine", "examples"), [(Life, 8), pytest.param(HighLife, 300, marks=pytest.mark.full)]
)
def test_no_program_and_no_fault_drops_the_arm(machine, examples):
    run_state_machine_as_test(
        machine,
        settings=settings(
            max_examples=examples,
            stateful_step_count=10,
            deadline=None,
            derandomize=examples < 100,
            suppress_health_check=list(HealthCheck),
        ),
    )

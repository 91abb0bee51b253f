"""`pliant servos doctor --measure`: session that measures an arm with the help of a person."""

from __future__ import annotations

import time
from contextlib import closing
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from pliant import identify
from pliant._core import ConfigError, Controller, Settings
from pliant.cli._measurements import MIN_HEIGHT, height_error, per_joint
from pliant.config._soft import apply_soft
from pliant.identify._leads import lead_procedure, solve_weight
from pliant.loop import LatenessHistogram, Loop

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from pliant._core import Axis
    from pliant._typing import Array
    from pliant.arm import Arm
    from pliant.cli._console import Keyboard
    from pliant.cli._measurements import Measurements
    from pliant.config import Config
    from pliant.identify._leads import Leads
    from pliant.loop import Tick

T = TypeVar("T")

#: Standard gravity [m/s²], which converts readings of a scale.
G = 9.80665
#: Pushes of the session: axis, sign, cap as a share of the holding force [1], direction in words.
PUSHES = (
    ("y", 1, 0.2, "toward +y (left, seen from the base)"),
    ("y", 1, 0.4, "toward +y (left, seen from the base)"),
    ("x", -1, 0.4, "toward the base"),
)
#: Smallest motion of the tool in a push [m].
MIN_PUSH = 0.02
#: Smallest motion of the tool in a push, as a multiple of the motion over which the servos build up
#: the capped force [1].
MIN_PUSH_SHARE = 1.5
#: Smallest reading of the scale, and smallest mass of the weight [g].
MIN_READING, MIN_WEIGHT = 1.0, 20.0
#: Largest reading and largest mass, as shares of what the servos can hold by their table [1].
MAX_READING_SHARE, MAX_WEIGHT_SHARE = 3.0, 0.4
#: Time for which the arm is watched after torque off [s].
WATCH_TIME = 1.0


class Session:
    """Measuring session with an arm; it skips the steps that the file already contains.

    The file is written after each step. After an error or Ctrl-C, the arm is lowered.

    Args:
        arm: The arm, not open.
        config: Configuration of the arm.
        file: Measurements file to complete.
        keys: Source of the answers.
        say: Function that shows a question or an error.
    """

    def __init__(
        self,
        arm: Arm,
        config: Config,
        file: Measurements,
        keys: Keyboard,
        say: Callable[[str], None],
    ) -> None:
        self.arm, self.config, self.file, self.keys, self.say = arm, config, file, keys, say
        firm: Mapping[Any, Axis] = Settings.firm(task=config.settings().task).axes
        self.settings = config.settings().replace(axes=firm)
        #: Controller that holds the arm stiffly; made before torque on, where an error does no
        #: harm.
        self.firm = Controller(arm.model, self.settings, arm.servos)
        #: Pose of the tool (4, 4) that the arm holds between the steps.
        self.home: Array = np.eye(4)
        self.lateness, self.missed, self.missing = LatenessHistogram(), 0, 0
        self.write_times: list[float] = []

    def run(self) -> None:
        """Run all steps that the file lacks.

        Raises:
            ConfigError: The arm has no servo bus, the file is of another arm, or the lines ended.
            ServoError: The arm does not follow, or the bus failed.
        """
        arm, file = self.arm, self.file
        with closing(arm):
            arm.open()
            file.start(arm, self.config)
            file.save()
            self._wait_for_pose()
            with arm:
                self.firm = Controller(arm.model, self.settings, arm.servos)
                for step, run in {
                    "servos": self._servos,
                    "push": self._push,
                    "weight": self._weight,
                    "loop": self._loop,
                    "ending": self._ending,
                }.items():
                    if step not in file.steps:
                        run()
                        file.save()

    def _wait_for_pose(self) -> None:
        """Wait with torque off until a person has confirmed a pose with room below the tool."""
        self.say(
            "Next: torque comes on. You: hold the arm in a free pose, elbow bent, the tool "
            f"{MIN_HEIGHT * 100:.0f} cm or more above the table, and press Enter; let go at the "
            "next line. Later you need a kitchen scale and a weight. Ctrl-C at any time lowers the "
            "arm and keeps the steps so far; the same command continues."
        )
        while True:
            while self.keys.line() is None:
                time.sleep(0.05)
            self.home = self.arm.model.forward_kinematics(self.arm.read().q)
            if (error := height_error(self.arm)) is None:
                return
            self.say(f"{error} and press Enter")

    def _servos(self) -> None:
        if self._confirm("the arm swings every joint by 0.1 rad and makes goal steps, 2 to 3 min"):
            arm = self.arm
            identification = identify.identify_servos(
                arm, arm.model, arm.servos, loop=self._ticks()
            )
            self.file.add_servos(identification)

    def _push(self) -> None:
        rows = [self._one_push(*push) for push in PUSHES if push[0] in self.settings.task.names]
        if rows := [row for row in rows if row is not None]:
            self.file.add("push", rows)

    def _one_push(
        self, axis: str, sign: int, share: float, direction: str
    ) -> dict[str, Any] | None:
        """Let a person push the tool; return the values of the push, None if it was skipped."""
        arm, q, index = self.arm, self.arm.read().q, "xyz".index(axis)
        axes: Mapping[Any, Axis] = self.firm.axes
        cap = share * float(axes[axis].hold or 0.0)
        soft = apply_soft(self.settings, f"{axis}={cap:.3g}", arm.model)
        controller = Controller(arm.model, soft, arm.servos)
        report, side = controller.report(q).axes[axis], max(sign, 0)
        promised = report.yield_force[side][1]
        row = np.asarray(arm.model.jacobian(q))[index]
        compliance = float((row**2 / arm.servos.kp).sum())
        needed = max(MIN_PUSH, MIN_PUSH_SHARE * promised * compliance)
        peak = [0.0]

        def on_pose(pose: Array) -> None:
            peak[0] = max(peak[0], sign * float(pose[index, 3] - self.home[index, 3]))

        def parse(line: str) -> float:
            value = grams(line, MIN_READING, MAX_READING_SHARE, report.capacity[side])
            if peak[0] < needed:
                raise ConfigError(
                    f"the tool moved by {peak[0] * 1e3:.0f} mm, needed are {needed * 1e3:.0f} mm: "
                    "push farther and read again"
                )
            return value

        scale = self._ask(
            f"Next: the arm holds its pose and yields along {axis} from {promised:.1f} N "
            f"({promised / G * 1e3:.0f} g) on. You: hold the scale upright, set it to zero, press "
            f"it against the tool, {direction}, for {needed * 100 + 2:.0f} cm in some 4 s, read it "
            "while the tool moves, and take it away. Reading in g, or skip:",
            parse,
            controller,
            on_pose,
        )
        if scale is None:
            return None
        return {
            "axis": axis,
            "toward": "-+"[side],
            "promised": promised,
            "friction_force": report.friction,
            "scale": scale,
            "measured": scale * 1e-3 * G,
            "deviation": peak[0],
        }

    def _weight(self) -> None:
        if not self._confirm("the arm swings every joint by 0.05 rad, 15 s"):
            return
        arm, before = self.arm, self._leads()
        capacity = min(self.firm.report(before.pose).axes["z"].capacity)
        scale = self._ask(
            f"Next: the arm holds its pose. You: weigh a weight of {MIN_WEIGHT:.0f} to "
            f"{MAX_WEIGHT_SHARE * capacity / G * 1e3:.0f} g, hang it by a short string on the "
            "tool's tip, let it rest and step back; then the arm swings again, 10 s. Mass in g, or "
            "skip:",
            lambda line: grams(line, MIN_WEIGHT, MAX_WEIGHT_SHARE, capacity),
        )
        if scale is None:
            return
        after = self._leads(before)
        kp, sigma, extra = solve_weight(before, after, scale * 1e-3)
        columns = {
            "kp": kp,
            "kp_sigma": sigma,
            "kp_assumed": arm.servos.kp,
            "lead": before.lead,
            "lead_with_weight": after.lead,
            "lead_sigma": np.hypot(before.sigma, after.sigma),
        }
        joints = per_joint(arm.model.joint_names, columns)
        values = {"q": before.pose, "scale": scale, "extra_mass": extra, "joints": joints}
        self.file.add("weight", values)
        self._ask("Next: the arm holds its pose. You: take the weight off and press Enter.", str)

    def _leads(self, like: Leads | None = None) -> Leads:
        arm = self.arm
        procedure = lead_procedure(arm.model, arm.servos, period=1.0 / arm.rate, like=like)
        return identify.run_procedure(arm, procedure, self._ticks())

    def _loop(self) -> None:
        times = self.write_times or [np.nan]
        values = {
            "ticks": len(self.lateness),
            "late_median": self.lateness.percentile(50.0),
            "late_99": self.lateness.percentile(99.0),
            "late_max": self.lateness.largest,
            "missed": self.missed,
            "missing": self.missing,
            "write_median": np.median(times),
            "write_99": np.quantile(times, 0.99),
            "counters": self.arm.counters,
        }
        self.file.add("loop", values)

    def _ending(self) -> None:
        if not self._confirm("the arm is lowered, and torque goes off", "keep things away below"):
            return
        arm, clock = self.arm, self.arm.clock
        holding, begin = self._tool_position(), clock.now()
        arm.lower()
        seconds = clock.now() - begin
        lowered = self._tool_position()
        clock.wait_until(clock.now() + WATCH_TIME)
        final = self._tool_position()
        values = {
            "seconds": seconds,
            "distance": float(np.linalg.norm(lowered - holding)),
            "drop": holding[2] - lowered[2],
            "drop_after_torque_off": lowered[2] - final[2],
            "via_rest_pose": arm.rest_q is not None and arm.detour is None,
        }
        self.file.add("ending", values)

    def _tool_position(self) -> Array:
        return self.arm.model.forward_kinematics(self.arm.read().q)[:3, 3]

    def _ticks(self, controller: Controller | None = None) -> Iterator[Tick]:
        """Yield the ticks of a loop; add their lateness and misses to the totals of the session."""
        loop = Loop(self.arm, controller, rate=self.arm.rate)
        try:
            yield from loop
        finally:
            self.lateness.add_all(loop.lateness)
            self.missed += loop.missed
            self.missing += loop.missing

    def _confirm(self, arm_does: str, person_does: str = "step back") -> bool:
        question = f"Next: {arm_does}. You: {person_does}. Enter, or skip:"
        return self._ask(question, lambda _: True) is not None

    def _ask(
        self,
        question: str,
        parse: Callable[[str], T],
        controller: Controller | None = None,
        on_pose: Callable[[Array], None] = lambda _: None,
    ) -> T | None:
        """Hold the arm until a line is valid; return its value, None for `skip`.

        Args:
            question: Text that is shown first.
            parse: Function that converts a line. Its `ConfigError` is shown, and another line is
                read.
            controller: Controller that holds the arm; None: all axes are stiff.
            on_pose: Function that is called with the pose (4, 4) of the tool in every cycle.

        Raises:
            ConfigError: The lines have ended.
        """
        self.keys.discard()
        self.say(question)
        controller = controller or self.firm
        for tick in self._ticks(controller):
            command = controller.step(tick.q, self.home, dt=tick.dt)
            begin = time.perf_counter()
            tick.write(command)
            self.write_times.append(time.perf_counter() - begin)
            on_pose(self.arm.model.forward_kinematics(tick.q))
            line = self.keys.line()
            if line is None:
                continue
            if line.strip() == "skip":
                break
            try:
                return parse(line)
            except ConfigError as error:
                self.say(f"{error}:")
        return None


def grams(line: str, low: float, share: float, capacity: float) -> float:
    """Return a reading [g], checked against the range from `low` [g] to a share of `capacity` [N].

    Raises:
        ConfigError: The line is not a number, or out of this range.
    """
    high = share * capacity / G * 1e3
    try:
        value = float(line.strip().removesuffix("g"))
    except ValueError:
        raise ConfigError(
            f"{line.strip()!r} is not a number of grams: type digits, or skip"
        ) from None
    if not low <= value <= high:
        raise ConfigError(
            f"{value:g} g is impossible: {low:g} to {high:.0f} g here, {share:g} × the "
            f"{capacity:.3g} N that the servos hold by their table; type grams"
        )
    return value

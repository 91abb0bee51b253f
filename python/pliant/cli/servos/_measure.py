"""`pliant servos doctor --measure`: session that measures an arm and leaves a file to send in."""

from __future__ import annotations

import threading
import time
from contextlib import closing
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from pliant import identify
from pliant._core import ConfigError, Controller, Settings
from pliant.config._soft import apply_soft
from pliant.identify._leads import Leads, WeightTest, lead_procedure
from pliant.loop import LatenessHistogram, Loop

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from typing import TypeVar

    from pliant._core import Axis
    from pliant._typing import Array
    from pliant.arm import Arm
    from pliant.cli._measurements import Measurements
    from pliant.config import Config
    from pliant.identify import Procedure
    from pliant.loop import Tick

    T = TypeVar("T")

#: Standard gravity [m/s²], which converts readings of a scale.
G = 9.80665
#: Pushes: axis, side (0: toward -, 1: toward +) and cap as a share of the arm's holding force [1].
PUSHES = (("y", 1, 0.2), ("y", 1, 0.4), ("x", 0, 0.4))
#: Direction of each push for people.
DIRECTIONS = {("y", 1): "toward +y (left, seen from the base)", ("x", 0): "toward the base"}
#: Smallest motion of the tool that counts as a push [m]; and the same as a multiple of the motion
#: at which the servos' stiffness reaches the cap by the table [1].
MIN_PUSH, MIN_PUSH_SHARE = 0.02, 1.5
#: Smallest reading of a scale, and smallest mass of the weight [g].
MIN_READING, MIN_WEIGHT = 1.0, 20.0
#: Largest plausible reading, as a multiple of what the servos hold at full torque by the table; and
#: largest mass of the weight, as a share of it [1].
MAX_READING_SHARE, MAX_WEIGHT_SHARE = 3.0, 0.4
#: Smallest height of the tool above a table in the pose of the session [m].
MIN_HEIGHT = 0.15
#: Time for which the arm is observed after torque off [s].
WATCH_TIME = 1.0


class Lines(Protocol):
    """Source of typed lines, such as `pliant.cli._console.Keyboard`."""

    def line(self) -> str | None:
        """Return the next line, None if there is none yet; raise ConfigError at the end."""

    def discard(self) -> None:
        """Drop what a person has typed before a question."""


def measure(
    arm: Arm, config: Config, file: Measurements, keys: Lines, say: Callable[[str], None]
) -> None:
    """Run the session on a closed arm with a configuration; leave out steps that the file has.

    The arm is lowered at the end, and after an error or Ctrl-C at any time. The file has all steps
    that were completed.

    Raises:
        ConfigError: The arm has no servo bus, the file is of another arm, or the lines ended.
        ServoError: The arm does not follow; or the bus failed.
    """
    session = _Session(arm, config, file, keys, say)
    try:
        session.run()
    finally:
        session.save()


class _Session:
    def __init__(
        self,
        arm: Arm,
        config: Config,
        file: Measurements,
        keys: Lines,
        say: Callable[[str], None],
    ) -> None:
        self.arm, self.config, self.file, self.keys, self.say = arm, config, file, keys, say
        settings = config.settings()
        firm: Mapping[Any, Axis] = Settings.firm(task=settings.task).axes
        self.settings = settings.replace(axes=firm)
        # Check the settings here, so that an error is raised before torque is on.
        Controller(self.arm.model, self.settings, self.arm.servos)
        #: Pose of the tool (4, 4) that the arm holds between the steps.
        self.home = np.eye(4)
        self.late = LatenessHistogram()
        self.missed = self.missing = 0
        self.write_times: list[float] = []
        self._writer: threading.Thread | None = None

    def run(self) -> None:
        arm, say = self.arm, self.say
        with closing(arm):
            arm.open()
            self.file.start(arm, self.config)
            say(
                "About 5 minutes. You need a kitchen scale and a weight. Ctrl-C at any time lowers "
                "the arm and keeps what was measured; the same command continues."
            )
            say(
                "Next: torque comes on. You: hold the arm in a free pose, elbow bent, the tool "
                "15 cm or more above the table, and press Enter; let go at the next line."
            )
            self._wait_for_pose()
            with arm:
                for step, run in (
                    ("servos", self._servos),
                    ("push", self._push),
                    ("weight", self._weight),
                    ("loop", self._loop_times),
                    ("ending", self._ending),
                ):
                    if step not in self.file:
                        run()
                        self._save_beside()

    def _wait_for_pose(self) -> None:
        """Wait, with torque off, until a person has confirmed a pose with room below the tool."""
        while True:
            while self.keys.line() is None:
                time.sleep(0.05)
            self.home = self.arm.model.forward_kinematics(self.arm.read().q)
            height = float(self.home[2, 3]) - (self.arm.table or 0.0)
            if self.arm.table is None or height >= MIN_HEIGHT:
                return
            self.say(
                f"the tool is {height * 100:.0f} cm above the table, needed are "
                f"{MIN_HEIGHT * 100:.0f} cm or more: hold it higher and press Enter"
            )

    def save(self) -> None:
        """Write the file once the arm is lowered: a slow disk must not delay the descent."""
        if self._writer is not None:
            self._writer.join()
        if self.file.data["steps"]:
            self.file.save()

    def _save_beside(self) -> None:
        """Write the file in another thread, so that a killed program loses no step."""
        if self._writer is not None:
            self._writer.join()
        self._writer = threading.Thread(target=self.file.save, daemon=True)
        self._writer.start()

    # Steps.

    def _servos(self) -> None:
        if not self._confirm(
            "the arm swings every joint by about 0.1 rad and jumps its goals, 2 to 3 minutes",
            "step back",
        ):
            return
        arm = self.arm
        q = arm.read().q
        self.file.add_servos(
            identify.identify_servos(arm, arm.model, arm.servos, loop=self._ticks()), q
        )

    def _push(self) -> None:
        rows: list[dict[str, Any]] = []
        for axis, side, share in PUSHES:
            if axis in self.settings.task.names and (row := self._one_push(axis, side, share)):
                rows.append(row)
        if rows:
            self.file.add("push", rows)

    def _one_push(self, axis: str, side: int, share: float) -> dict[str, Any] | None:
        arm = self.arm
        firm: Mapping[Any, Axis] = Controller(arm.model, self.settings, arm.servos).axes
        cap = share * float(firm[axis].hold or 0.0)
        settings = apply_soft(self.settings, f"{axis}={cap:.3g}", arm.model)
        controller = Controller(arm.model, settings, arm.servos)
        report = controller.report(arm.read().q).axes[axis]
        promised = report.yield_force[side][1]
        most = MAX_READING_SHARE * report.capacity[side]
        place = "xyz".index(axis)
        moved = _Motion(place, 1.0 if side else -1.0)
        row = np.asarray(arm.model.jacobian(arm.read().q))[place]
        needed = max(MIN_PUSH, MIN_PUSH_SHARE * promised * float(row**2 @ (1.0 / self._kp)))

        def parse(line: str) -> float:
            grams = _grams(line, MIN_READING, most, f"{MAX_READING_SHARE:g} times what the servos")
            if moved.largest < needed:
                raise ConfigError(
                    f"the tool moved by {moved.largest * 1e3:.0f} mm, needed is a push of "
                    f"{needed * 1e3:.0f} mm or more: push on slowly and read again"
                )
            return grams

        grams = self._ask(
            f"Next: the arm holds its pose and yields along {axis} from {promised:.1f} N "
            f"({promised / G * 1e3:.0f} g) on. You: hold the scale upright, set it to zero, press "
            f"it against the tool, {DIRECTIONS[axis, side]}, for {needed * 100 + 2:.0f} cm in "
            "some 4 s, read it while the tool moves, and take it away. Reading in g, or skip:",
            parse,
            controller,
            moved,
        )
        if grams is None:
            return None
        return {
            "axis": axis,
            "toward": "+" if side else "-",
            "promised": promised,
            "friction_force": report.friction,
            "scale": grams,
            "measured": grams * 1e-3 * G,
            "deviation": moved.largest,
        }

    def _weight(self) -> None:
        arm = self.arm
        if not self._confirm(
            "the arm swings every joint by about 0.05 rad, 15 s", "step back", wait="weight"
        ):
            return
        before = self._leads(None)
        pull = Controller(arm.model, self.settings, arm.servos).report(before.pose).axes["z"]
        most = MAX_WEIGHT_SHARE * min(pull.capacity)
        grams = self._ask(
            f"Next: the arm holds its pose. You: weigh a weight of {MIN_WEIGHT:.0f} to "
            f"{most / G * 1e3:.0f} g on the scale, hang it by a short string on the tool's tip, "
            "let it come to rest and step back. Then the arm swings again, 10 s. Mass in g, or "
            "skip:",
            lambda line: _grams(line, MIN_WEIGHT, most, f"{MAX_WEIGHT_SHARE:g} of what the servos"),
        )
        if grams is None:
            return
        mass = grams * 1e-3
        test = WeightTest(before, self._leads(before), mass)
        kp, sigma, extra = test.solve()
        values: dict[str, Any] = {
            "q": before.pose,
            "scale": grams,
            "mass": mass,
            "mass_by_table": test.mass_seen(self._kp),
            "extra_mass": extra,
        }
        if "servos" in self.file:
            found = np.array([joint["kp"] for joint in self.file["servos"]["joints"]])
            values["mass_by_identified"] = test.mass_seen(found)
        columns = {
            "torque": test.torque(extra),
            "lead": test.lead,
            "lead_sigma": test.sigma,
            "kp": kp,
            "kp_sigma": sigma,
            "kp_assumed": self._kp,
        }
        values["joints"] = [
            {"joint": name, **{key: column[i] for key, column in columns.items()}}
            for i, name in enumerate(arm.model.joint_names)
        ]
        self.file.add("weight", values)
        self._ask("Next: the arm holds its pose. You: take the weight off and press Enter.", str)

    def _loop_times(self) -> None:
        times = self.write_times or [np.nan]
        self.file.add(
            "loop",
            {
                "ticks": len(self.late),
                "late_median": self.late.percentile(50.0),
                "late_99": self.late.percentile(99.0),
                "late_max": self.late.largest,
                "missed": self.missed,
                "missing": self.missing,
                "write_median": np.median(times),
                "write_99": np.quantile(times, 0.99),
                "counters": self.arm.counters,
            },
        )

    def _ending(self) -> None:
        arm = self.arm
        if not self._confirm(
            "the arm is lowered, and torque goes off", "keep hands and things away below the arm"
        ):
            return
        model, clock = arm.model, arm.clock
        places = [model.forward_kinematics(arm.read().q)[:3, 3]]
        begin = clock.now()
        arm.lower()
        seconds = clock.now() - begin
        places.append(model.forward_kinematics(arm.read().q)[:3, 3])
        clock.wait_until(clock.now() + WATCH_TIME)
        places.append(model.forward_kinematics(arm.read().q)[:3, 3])
        down = np.diff([place[2] for place in places])
        self.file.add(
            "ending",
            {
                "seconds": seconds,
                "distance": float(np.linalg.norm(places[1] - places[0])),
                "drop": -down[0],
                "drop_after_torque_off": -down[1],
                "rest_pose": arm.rest_q is not None,
                "straight_down": arm.rest_q is None or arm.detour is not None,
            },
        )

    @property
    def _kp(self) -> Array:
        """Stiffness by the table (n,) [N·m/rad]."""
        return np.broadcast_to(np.asarray(self.arm.servos.kp), self.arm.model.n)

    # Loops.

    def _leads(self, like: Leads | None) -> Leads:
        arm = self.arm
        procedure = lead_procedure(arm.model, arm.servos, period=1.0 / arm.rate, like=like)
        return self._run(procedure)

    def _run(self, procedure: Procedure[T]) -> T:
        return identify.run_procedure(self.arm, procedure, self._ticks())

    def _ticks(self, controller: Controller | None = None) -> Iterator[Tick]:
        """Yield the ticks of a loop, and add its lateness to that of the session."""
        loop = Loop(self.arm, controller, rate=self.arm.rate)
        try:
            yield from loop
        finally:
            self.late.counts += loop.lateness.counts
            self.late.largest = max(self.late.largest, loop.lateness.largest)
            self.missed += loop.missed
            self.missing += loop.missing

    def _confirm(self, arm_does: str, person_does: str, wait: str = "") -> bool:
        text = f"Next: {arm_does}. You: {person_does}. Enter, or skip:"
        return self._ask(text, lambda _: True) is not None

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
            parse: Function that converts a line; a `ConfigError` is shown, and asks again.
            controller: Controller that holds the pose; None: all axes are stiff.
            on_pose: Function that is called with the pose (4, 4) of the tool in every cycle.

        Raises:
            ConfigError: The lines have ended.
        """
        self.keys.discard()
        self.say(question)
        arm = self.arm
        controller = controller or Controller(arm.model, self.settings, arm.servos)
        for tick in self._ticks(controller):
            pose = arm.model.forward_kinematics(tick.q)
            command = controller.step(tick.q, self.home, dt=tick.dt)
            begin = time.perf_counter()
            tick.write(command)
            self.write_times.append(time.perf_counter() - begin)
            on_pose(pose)
            line = self.keys.line()
            if line is None:
                continue
            if line.strip() == "skip":
                return None
            try:
                return parse(line)
            except ConfigError as error:
                self.say(f"{error}:")
        return None


class _Motion:
    """Largest motion of the tool along one axis [m]; called with poses (4, 4)."""

    def __init__(self, index: int, sign: float) -> None:
        self.index, self.sign = index, sign
        self.start: float | None = None
        self.largest = 0.0

    def __call__(self, pose: Array) -> None:
        place = float(pose[self.index, 3])
        self.start = place if self.start is None else self.start
        self.largest = max(self.largest, self.sign * (place - self.start))


def _grams(line: str, low: float, force: float, meaning: str) -> float:
    """Return a reading [g] between `low` [g] and the weight of `force` [N].

    Raises:
        ConfigError: The line is not a number, or the number is out of this range.
    """
    high = force / G * 1e3
    try:
        grams = float(line.strip().removesuffix("g"))
    except ValueError:
        raise ConfigError(f"{line.strip()!r} is no number of grams: type digits, or skip") from None
    if not low <= grams <= high:
        raise ConfigError(
            f"{grams:g} g is impossible: {low:g} to {high:.0f} g here, {meaning} hold by their "
            "table; type grams"
        )
    return grams

"""Recorded motion: joint positions over time, and its JSON file."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pliant._core import ConfigError
from pliant._files import LARGE, check_output, read_text, replacing

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pliant._core import Model
    from pliant._typing import Array
    from pliant.log import Log


#: Value of the field `format` in a motion file.
FORMAT = "pliant motion 1"
#: Sample rate of smoothed motions [Hz].
RATE = 50.0
#: Decimal digits of a position [rad] in a motion file.
DIGITS = 5
#: Largest distance from the first or last position of a motion at which a joint is at rest [rad].
REST_TOLERANCE = 0.02
#: Duration of rest that `Motion.trimmed` keeps at both ends [s].
REST_TIME = 0.2
#: Largest accepted distance between the start of the tool and the recorded start [m]; a larger one
#: means that the motion was recorded on another arm.
START_TOLERANCE = 0.03
#: Minimum number of samples of a motion, and maximum number after smoothing.
MIN_SAMPLES, MAX_SAMPLES = 2, 10_000_000
#: Minimum time between two samples [s]; maximum duration of a motion [s].
MIN_SAMPLE_TIME, MAX_DURATION = 1e-6, 1e5


@dataclass(frozen=True)
class Motion:
    """A recorded motion: N samples of the positions of n joints, with smooth interpolation.

    Attributes:
        joints: Names of the n joints, in the order of the columns of `q`.
        time: Times (N,) [s], rising from 0.
        q: Joint positions (N, n) [rad].
        extra: Positions (N,) [rad] of joints outside the chain, such as a gripper, by name.
        note: Comment by the user.
        start: Position of the tool at the first sample (3,) [m], base axes, computed with the model
            of the recorded arm; None: unknown. It reveals a different arm with equal joint names.

    Raises:
        ConfigError: Shapes, times or numbers are inconsistent.
    """

    joints: tuple[str, ...]
    time: Array
    q: Array
    extra: Mapping[str, Array] = field(default_factory=dict)
    note: str = ""
    start: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        """Check that shapes match, times rise, and all numbers are finite."""
        try:
            time, q = np.asarray(self.time, dtype=np.float64), np.asarray(self.q, dtype=np.float64)
            extra = {name: np.asarray(row, dtype=np.float64) for name, row in self.extra.items()}
        except (TypeError, ValueError) as error:
            raise ConfigError(
                f"time, q and extra of a motion must be arrays of real numbers: {error}"
            ) from error
        size = (time.size, len(self.joints))
        if time.ndim != 1 or time.size < MIN_SAMPLES or q.shape != size:
            raise ConfigError(
                f"a motion of {len(self.joints)} joints needs times (N,) and q (N, n) with N at "
                f"least {MIN_SAMPLES}, got {time.shape} and {q.shape}"
            )
        if any(row.shape != time.shape for row in extra.values()):
            raise ConfigError("a motion needs as many positions of each joint beside the chain")
        columns = {"time": time, **dict(zip(self.joints, q.T, strict=True)), **extra}
        for name, column in columns.items():
            if not np.isfinite(column).all():
                i = int(np.flatnonzero(~np.isfinite(column))[0])
                raise ConfigError(
                    f"{name} of sample {i + 1} of {time.size} is {column[i]}, not a finite number"
                )
        with np.errstate(over="ignore"):
            steps, duration = np.diff(time), float(time[-1] - time[0])
        if not (steps > 0.0).all():
            i = int(np.flatnonzero(steps <= 0.0)[0])
            raise ConfigError(
                f"the times of a motion must rise: sample {i + 2} is at {time[i + 1]:g} s, the "
                f"one before it at {time[i]:g} s"
            )
        if steps.min() < MIN_SAMPLE_TIME or duration > MAX_DURATION:
            raise ConfigError(
                f"a motion takes {MAX_DURATION:g} s at most and {MIN_SAMPLE_TIME:g} s from sample "
                f"to sample at least, got {duration:g} s and {steps.min():g} s: its times are in "
                "seconds"
            )
        if self.start is not None and not (
            len(self.start) == 3 and np.isfinite(np.asarray(self.start, dtype=np.float64)).all()
        ):
            raise ConfigError(
                f"start is where the tool began, three finite numbers [m], got {self.start!r}"
            )
        parts = {"joints": tuple(self.joints), "time": time - time[0], "q": q, "extra": extra}
        for name, value in parts.items():
            object.__setattr__(self, name, value)

    @property
    def duration(self) -> float:
        """Duration of the motion, the time of its last sample [s]."""
        return float(self.time[-1])

    def at(self, time: float) -> Array:
        """Return the joint positions (n,) [rad] at a time [s], clipped to 0 and `duration`.

        The interpolation is cubic (Catmull-Rom), without overshoot (Fritsch and Carlson, 1980).
        """
        if not 0.0 < time < self.duration:
            return np.array(self.q[0 if time <= 0.0 else -1])
        k = int(np.searchsorted(self.time, time, side="right")) - 1
        step = self.time[k + 1] - self.time[k]
        u = (time - self.time[k]) / step
        low, high = self.q[k], self.q[k + 1]
        m, p = step * self._slope(k), step * self._slope(k + 1)
        a, b = 2.0 * (low - high) + m + p, 3.0 * (high - low) - 2.0 * m - p
        q: Array = low + u * (m + u * (b + u * a))
        return q

    def extra_at(self, time: float) -> dict[str, float]:
        """Return the positions [rad] of the joints outside the chain at a time [s], by name."""
        return {name: float(np.interp(time, self.time, row)) for name, row in self.extra.items()}

    def _slope(self, k: int) -> Array:
        """Return the velocities (n,) [rad/s] at sample k; 0 at the ends."""
        if k in {0, len(self.time) - 1}:
            return np.zeros(len(self.joints))
        q, time = self.q[k - 1 : k + 2], self.time[k - 1 : k + 2]
        before, after = np.diff(q, axis=0) / np.diff(time)[:, None]
        limit = 3.0 * np.minimum(np.abs(before), np.abs(after)) * (before * after > 0.0)
        slope: Array = np.clip((q[2] - q[0]) / (time[2] - time[0]), -limit, limit)
        return slope

    def validate_for(self, model: Model) -> None:
        """Check that an arm can execute the motion.

        Raises:
            ConfigError: The joints differ, positions exceed the limits, or the tool would not start
                where it did in the recording.
        """
        self._check_joints(model)
        excess = np.maximum(self.q - model.upper, model.lower - self.q).max(axis=0)
        worst = int(np.argmax(excess))
        # Allow small excess: an arm guided by hand can be moved slightly beyond its limits.
        if excess[worst] > REST_TOLERANCE:
            raise ConfigError(
                f"the motion takes {self.joints[worst]} {excess[worst]:.3f} rad beyond its limits"
            )
        if self.start is not None:
            tool = model.forward_kinematics(np.clip(self.q[0], model.lower, model.upper))[:3, 3]
            distance = float(np.linalg.norm(tool - self.start))
            if distance > START_TOLERANCE:
                raise ConfigError(
                    "the motion is another arm's: its tool began at "
                    f"{_format_point(self.start)}, the tool of {model.name} is at "
                    f"{_format_point(tool)} with the same joint positions, {distance:.3f} m away "
                    f"(at most {START_TOLERANCE:g}); give the URDF of the recording, or remove "
                    '"start" from the file'
                )

    def for_model(self, model: Model) -> Motion:
        """Return a copy with `start` set to the tool position of a model at the first sample.

        Raises:
            ConfigError: The joints differ.
        """
        self._check_joints(model)
        q = np.clip(self.q[0], model.lower, model.upper)
        x, y, z = model.forward_kinematics(q)[:3, 3].tolist()
        return replace(self, start=(x, y, z))

    def _check_joints(self, model: Model) -> None:
        if self.joints != tuple(model.joint_names):
            raise ConfigError(
                f"the motion is of {', '.join(self.joints)}; this arm has "
                f"{', '.join(model.joint_names)}"
            )

    def trimmed(self) -> Motion:
        """Return a copy without the rest before and after the motion, and without `start`.

        Raises:
            ConfigError: No joint moved.
        """
        rows = np.column_stack((self.q, *self.extra.values()))
        moved = np.flatnonzero((np.abs(rows - rows[0]) > REST_TOLERANCE).any(axis=1))
        not_arrived = np.flatnonzero((np.abs(rows - rows[-1]) > REST_TOLERANCE).any(axis=1))
        if not (moved.size and not_arrived.size):
            raise ConfigError(
                f"nothing moved by more than {REST_TOLERANCE:g} rad: there is no motion"
            )
        first, last = self.time[moved[0]] - REST_TIME, self.time[not_arrived[-1]] + REST_TIME
        mask = (self.time >= first) & (self.time <= last)
        extra = {name: row[mask] for name, row in self.extra.items()}
        return replace(self, time=self.time[mask], q=self.q[mask], extra=extra, start=None)

    def smoothed(self, width: float = 0.1, rate: float = RATE) -> Motion:
        """Return a copy at a constant sample rate, smoothed by a Gaussian filter without time lag.

        Args:
            width: Standard deviation of the Gaussian [s].
            rate: Sample rate of the result [Hz].

        Raises:
            ConfigError: A value is out of range, or the result would have too many samples.
        """
        if not (0.0 <= width < np.inf and 0.0 < rate < np.inf):
            raise ConfigError(
                f"width must be at least 0 s, rate above 0 Hz, both finite; got {width!r}, {rate!r}"
            )
        if self.duration * rate > MAX_SAMPLES:
            raise ConfigError(
                f"{self.duration:g} s at a rate of {rate:g} Hz are {self.duration * rate:.3g} "
                f"samples, at most {MAX_SAMPLES:.0e} are made: lower the rate"
            )
        count = max(round(self.duration * rate), 1) + 1
        time = np.linspace(0.0, self.duration, count)
        step = self.duration / (count - 1)
        reach = round(min(3.0 * width / step, count - 1))
        kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) * step / max(width, 1e-9)) ** 2)

        def smooth(row: Array) -> Array:
            even = np.interp(time, self.time, row)
            # Extend the samples by odd reflection: the filter then keeps end points and lines.
            padded = np.pad(even, reach, mode="reflect", reflect_type="odd")
            return np.convolve(padded, kernel / kernel.sum(), mode="valid")

        q = np.column_stack([smooth(row) for row in self.q.T])
        extra = {name: smooth(row) for name, row in self.extra.items()}
        return replace(self, time=time, q=q, extra=extra)

    def save(self, path: str | Path) -> None:
        """Write a JSON file with one sample per line.

        An existing motion file is replaced only once the new file is complete.

        Raises:
            ConfigError: The file exists and is not a motion file, or is not writable.
            OSError: The file cannot be written.
        """
        path = Path(path)
        check_output(path, "motion")
        rows = np.column_stack((self.time, self.q, *self.extra.values()))
        header = {
            "format": FORMAT,
            "joints": list(self.joints),
            "extra": list(self.extra),
            "note": self.note,
            **({} if self.start is None else {"start": [round(x, DIGITS) for x in self.start]}),
            "columns": "time [s], joints [rad], extra [rad]",
        }
        # Times are not rounded: samples may be `MIN_SAMPLE_TIME` apart.
        samples = ",\n  ".join(
            json.dumps([time, *(round(x, DIGITS) for x in row)]) for time, *row in rows.tolist()
        )
        text = json.dumps(header, indent=1, ensure_ascii=False)[:-2]
        with replacing(path) as new_file:
            new_file.write_text(f'{text},\n "samples": [\n  {samples}\n ]\n}}\n', encoding="utf-8")

    @classmethod
    def from_log(cls, log: Log) -> Motion:
        """Return the motion in a log: the measured joint positions.

        Raises:
            ConfigError: The log is damaged, or too short.
        """
        if log.damage:
            raise ConfigError(f"the log is damaged and is not played: {log.damage}")
        extra = dict(zip(log.run["extra"], log.extra.T, strict=True))
        motion = cls(tuple(log.run["joints"]), log.time, log.q, extra, log.run["note"])
        return motion.for_model(log.model())

    @classmethod
    def load(cls, path: str | Path) -> Motion:
        """Return the motion in a motion file, or in a log (`.mcap`).

        Raises:
            ConfigError: The file is not a motion file, or it is a damaged log.
            OSError: The file cannot be read.
        """
        path = Path(path)
        if path.suffix == ".mcap":
            from pliant.log import read

            return cls.from_log(read(path))
        try:
            data: Any = json.loads(read_text(path, LARGE))
            if data["format"] != FORMAT:
                raise ConfigError(f"format is {data['format']!r}, this pliant reads {FORMAT!r}")
            samples, joints, names = data["samples"], data["joints"], data["extra"]
            for key, value in (("joints", joints), ("extra", names)):
                if not (isinstance(value, list) and all(isinstance(name, str) for name in value)):
                    raise ConfigError(f"{key} must be a list of names in quotes")
            n = len(joints)
            width = 1 + n + len(names)
            for i, sample in enumerate(samples, 1):
                if not isinstance(sample, list) or len(sample) != width:
                    raise ConfigError(
                        f"sample {i} of {len(samples)} must be {width} numbers: a time, {n} joints "
                        f"and {len(names)} extra"
                    )
            rows = np.array(samples, dtype=np.float64).reshape(-1, width)
            extra = dict(zip(names, rows[:, 1 + n :].T, strict=True))
            note, start = str(data.get("note", "")), data.get("start")
            if start is not None:
                x, y, z = map(float, start)
                start = x, y, z
            return cls(tuple(joints), rows[:, 0], rows[:, 1 : 1 + n], extra, note, start)
        except ConfigError as error:
            raise ConfigError(f"{path}: {error}") from error
        except KeyError as error:
            raise ConfigError(f"{path} is not a motion file: it has no {error}") from error
        except RecursionError as error:
            raise ConfigError(f"{path} is not a motion file: it is nested too deeply") from error
        except (ValueError, TypeError, OverflowError) as error:
            raise ConfigError(f"{path} is not a motion file: {error}") from error


def _format_point(point: Any) -> str:
    return "(" + ", ".join(f"{x:.3f}" for x in point) + ") m"

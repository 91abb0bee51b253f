"""Retiming of recorded motions with ruckig, within bounds of joint speed, acceleration and jerk."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from pliant._core import ConfigError
from pliant._extras import pip
from pliant.teach.motion import RATE

if TYPE_CHECKING:
    from pliant.teach.motion import Motion

#: Largest increase of the duration by retiming [s].
MAX_EXTRA_TIME = 60.0
#: A motion that is too fast is slowed down to this share of its bounds [1]; ruckig needs the rest
#: as a margin to follow it.
BOUND_SHARE = 0.9


def import_ruckig(bounds: tuple[float, float, float]) -> Any:
    """Check bounds of speed, acceleration and jerk, and return the module ruckig.

    Raises:
        ConfigError: A bound is not above 0.
        ImportError: ruckig is not installed.
    """
    if not all(0.0 < bound < np.inf for bound in bounds):
        raise ConfigError(f"speed, acceleration and jerk must be above 0, got {bounds!r}")
    try:
        import ruckig
    except ImportError as error:
        raise ImportError(f"bounds of a motion need ruckig: {pip()} ruckig") from error
    return ruckig


def retime(motion: Motion, bounds: tuple[float, float, float], rate: float = RATE) -> Motion:
    """Return a copy of a motion that stays within bounds of speed, acceleration and jerk.

    A motion that exceeds a speed or acceleration bound is first slowed down as a whole, so that
    the joints stay on their path. Then ruckig follows it: parts within the bounds stay unchanged,
    and corners are rounded to meet the jerk bound.

    Args:
        motion: The motion. Joints outside the chain (a gripper) are slowed down together with the
            others, but the bounds do not apply to them.
        bounds: Speed [rad/s], acceleration [rad/s²] and jerk [rad/s³] of every joint.
        rate: Sample rate of the result [Hz].

    Returns:
        A motion from rest to rest, with the same end points.

    Raises:
        ConfigError: A bound is not above 0, or the bounds are too low for the motion.
        ImportError: ruckig is not installed.
    """
    ruckig = import_ruckig(bounds)
    n, step = len(motion.joints), 1.0 / rate
    motion = _slowed(motion, bounds[0], bounds[1], step)
    planner = ruckig.Ruckig(n, step)
    inputs, outputs = ruckig.InputParameter(n), ruckig.OutputParameter(n)
    speed, acceleration, jerk = bounds
    inputs.current_position = motion.q[0].tolist()
    inputs.max_velocity, inputs.max_acceleration = [speed] * n, [acceleration] * n
    inputs.max_jerk = [jerk] * n
    rows, count = [motion.q[0]], 0
    while True:
        count += 1
        time = count * step
        ended = time >= motion.duration
        previous, position, following = (motion.at(time + shift) for shift in (-step, 0.0, step))
        slope, curvature = (
            (following - previous) * (0.5 * rate),
            (following - 2.0 * position + previous) * rate**2,
        )
        inputs.target_position = position.tolist()
        slope, curvature = (
            np.clip(slope, -speed, speed),
            np.clip(curvature, -acceleration, acceleration),
        )
        inputs.target_velocity = [0.0] * n if ended else slope.tolist()
        inputs.target_acceleration = [0.0] * n if ended else curvature.tolist()
        result = planner.update(inputs, outputs)
        if int(result) < 0:
            raise ConfigError(f"ruckig refuses the motion at {time:.2f} s: {result}")
        rows.append(np.array(outputs.new_position))
        outputs.pass_to_input(inputs)
        if ended and result == ruckig.Result.Finished:
            break
        if time > motion.duration + MAX_EXTRA_TIME:
            raise ConfigError(
                f"within {bounds!r} (rad/s, rad/s², rad/s³) the motion of {motion.duration:.1f} s "
                f"is not over after {MAX_EXTRA_TIME:g} s more: raise them"
            )
    times = step * np.arange(len(rows), dtype=np.float64)
    extra = {name: np.interp(times, motion.time, row) for name, row in motion.extra.items()}
    return replace(motion, time=times, q=np.array(rows), extra=extra)


def _slowed(motion: Motion, speed: float, acceleration: float, step: float) -> Motion:
    """Return a motion slowed down until it meets `BOUND_SHARE` of the bounds [rad/s, rad/s²].

    `step` is the time step at which speed and acceleration are computed [s].
    """
    times = np.arange(0.0, motion.duration + step, step)
    q = np.array([motion.at(time) for time in times.tolist()])
    speed_ratio = float(np.abs(np.diff(q, axis=0)).max()) / step / (BOUND_SHARE * speed)
    peak_acceleration = float(np.abs(np.diff(q, 2, axis=0)).max(initial=0.0)) / step**2
    factor = max(1.0, speed_ratio, np.sqrt(peak_acceleration / (BOUND_SHARE * acceleration)))
    return replace(motion, time=motion.time * factor)

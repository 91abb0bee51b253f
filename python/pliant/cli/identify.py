"""`pliant identify`: measure the servos, the gravity offset or the payload of an arm."""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from pliant import identify
from pliant._core import ConfigError, Controller
from pliant.cli._console import Console, print_line
from pliant.cli._flags import ArmName, ConfigFlags, File
from pliant.cli._measurements import Measurements, height_error
from pliant.config import connect
from pliant.config._toml import toml_key, toml_string
from pliant.identify.result import MAX_RESIDUAL_RATIO
from pliant.servo import get_model

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pliant.arm import Arm
    from pliant.config import Config

Procedure = Literal["servos", "gravity", "payload"]
#: Motion and duration of each procedure, printed before it starts.
PROCEDURE_TEXTS = {
    "servos": "swings every joint about this pose and makes goal steps, about 2 minutes",
    "gravity": "holds the arm where it is, 4 to 9 seconds",
    "payload": "swings the joints slowly about this pose, about 30 seconds",
}
#: Significant digits of the printed configuration values.
SIGNIFICANT_DIGITS = 4


def run(
    arm: ArmName,
    procedure: Annotated[Procedure, tyro.conf.Positional],
    *,
    span: Annotated[float | None, tyro.conf.arg(metavar="RADIANS")] = None,
    report: File = None,
    override: ConfigFlags,
) -> None:
    """Measure the arm, print the results and the lines for its configuration, and lower the arm.

    servos measures stiffness, friction, damping and delay; gravity checks that the arm stays in its
    pose; payload estimates mass and centre of mass of the load. Do not touch the arm meanwhile, and
    keep its surroundings free. Ctrl-C ends the procedure and lowers the arm.

    Args:
        arm: Configuration file, or the name of a ready one (so101, koch, vx300s, ...).
        procedure: servos, gravity or payload.
        span: Largest distance of each joint's poses from the present one [rad], 0.05 to 0.5; the
            joints swing about every pose. Default: 0.1 for servos, 0.3 for payload.
        report: Measurements file (JSON) to write or to continue, ready to be sent in. Only for
            servos.
        override: Values that replace those of the configuration file.
    """
    options: dict[str, Any] = {} if span is None else {"span": span}
    if procedure == "gravity" and options:
        raise ConfigError("--span belongs to servos and payload: gravity moves nothing")
    if report is not None and procedure != "servos":
        raise ConfigError(f"--report belongs to servos, got {procedure}")
    arm_config = override.load(arm)
    file = None if report is None else Measurements(report, override.inputs(arm, arm_config))
    connected = connect(arm_config)
    # Check the settings here, to raise errors before torque is on.
    Controller(connected.model, arm_config.settings(), connected.servos)
    console = Console()
    print_line(f"{procedure}: {PROCEDURE_TEXTS[procedure]}; do not touch the arm", console)
    results: list[list[str]] = []
    try:
        with closing(connected):
            connected.open()
            if procedure != "gravity" and (low := height_error(connected)) is not None:
                raise ConfigError(f"{low} and start the command again")
            if file is not None:
                file.start(connected, arm_config)
            with connected as live:
                results.append(_measure(procedure, live, arm_config, options, file))
    finally:
        # Write after the descent: a blocked terminal or disk must not delay it. If the file cannot
        # be written, the results are printed nevertheless.
        try:
            if file is not None and "servos" in file.steps:
                file.save()
        finally:
            for line in (line for lines in results for line in lines):
                print_line(line, console)


def _measure(
    procedure: Procedure,
    arm: Arm,
    arm_config: Config,
    options: dict[str, Any],
    file: Measurements | None,
) -> list[str]:
    """Run a procedure; return its results and lines for the configuration file, to be printed."""
    if procedure == "servos":
        identification = identify.identify_servos(arm, arm.model, arm.servos, **options)
        if file is not None:
            file.add_servos(identification)
        return [
            *identification.summary(),
            *_servo_lines(arm_config, identification, getattr(arm.drive, "gains", {})),
            *_payload_lines(identification.payload),
        ]
    controller = Controller(arm.model, arm_config.settings(), arm.servos)
    if procedure == "payload":
        estimate = identify.estimate_payload(arm, controller, **options)
        return [*estimate.summary(), *_payload_lines(estimate)]
    capture = identify.capture_gravity(arm, controller)
    return [*capture.summary(), *_gravity_lines(capture)]


def _servo_lines(
    arm_config: Config, identification: identify.Identification, gains: Mapping[str, int]
) -> list[str]:
    """Return TOML lines for the table [servo]: measured stiffness, friction and damping.

    A joint whose stiffness is not identified keeps the `kp` of the file, with the `gain` that it
    belongs to. `gains` maps joint names to the gain registers as read from the servos; without an
    entry, the servo has the gain of the file, or the maker's.
    """
    if not arm_config.servo:
        return ["", "# the file has no table [servo]: the built-in servos cannot be changed"]
    if identification.residual_ratio > MAX_RESIDUAL_RATIO:
        return ["", "# no lines for the file: the residuals are too large"]
    known = identification.stiffness_known
    lines = ["", "# in place of the lines of these joints:", "[servo]"]
    for i, joint in enumerate(identification.joint_names):
        entry = arm_config.servo[joint].model_dump(exclude_unset=True)
        row = get_model(arm_config.servo[joint].model)
        gain = gains.get(joint, entry.get("gain") or row.gain_default)
        if known[i]:
            entry["kp"] = float(identification.servos.kp[i])
        # Other servos than Feetech's start with the maker's gain, and the file has none for them.
        if row.family.status == "feetech" and (known[i] or ("gain" in entry and "kp" not in entry)):
            entry["gain"] = gain
        entry["friction"] = float(identification.friction[i])
        entry["damping"] = float(identification.servos.damping[i])
        lines.append(f"{toml_key(joint)} = {_toml(entry)}")
    if not known.all():
        unknown = [name for i, name in enumerate(identification.joint_names) if not known[i]]
        lines.append(f"# kp of {', '.join(unknown)} is not known within 10 %, and unchanged here")
    return lines


def _payload_lines(estimate: identify.PayloadEstimate) -> list[str]:
    """Return the TOML line with the payload for [robot], or a comment if no payload was found."""
    if not estimate.found:
        return ["", "# no payload for the file"]
    payload = estimate.payload
    table = {"mass": float(payload.mass), "com": [float(value) for value in payload.com]}
    return ["", "# in the table [robot]:", f"payload = {_toml(table)}"]


def _gravity_lines(capture: identify.GravityCapture) -> list[str]:
    """Return TOML lines for [settings.compensation] that keep the arm still, or a comment."""
    if capture.stays:
        return ["", "# nothing to change in the file: the arm stays with its settings"]
    if capture.remedy is None:
        return ["", "# no settings for the file: identify the servos or the payload"]
    compensation = capture.remedy.compensation
    return [
        "",
        "[settings.compensation]",
        f"friction = {_toml(float(compensation.friction))}",
        f"damping = {_toml(float(compensation.damping))}",
    ]


def _toml(value: Any) -> str:
    """Return a value as TOML on one line, with rounded numbers."""
    if isinstance(value, dict):
        entries = (
            f"{toml_key(key)} = {_toml(each)}" for key, each in value.items() if each is not None
        )
        return f"{{ {', '.join(entries)} }}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, str):
        return toml_string(value)
    if isinstance(value, float):
        return repr(float(f"{value:.{SIGNIFICANT_DIGITS}g}"))
    return str(value).lower() if isinstance(value, bool) else str(value)

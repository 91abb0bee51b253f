"""`pliant identify`: measure servos, gravity or payload on the arm itself."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from rich.console import Console

from pliant import identify
from pliant._core import ConfigError, Controller, Settings
from pliant.cli._console import print_line
from pliant.cli._flags import ArmName, ConfigFlags
from pliant.config import connect

if TYPE_CHECKING:
    from pliant.arm import Arm
    from pliant.config import Config

Procedure = Literal["servos", "gravity", "payload"]
#: Motion and duration of each procedure.
ANNOUNCED = {
    "servos": "swings every joint about this pose and jumps its goal, about 2 minutes",
    "gravity": "holds the arm where it is, 4 to 9 seconds",
    "payload": "swings the joints slowly about this pose, about 30 seconds",
}
#: Significant digits of the numbers for the file.
DIGITS = 4


def run(
    arm: ArmName,
    procedure: Annotated[Procedure, tyro.conf.Positional],
    *,
    span: Annotated[float | None, tyro.conf.arg(metavar="RADIANS")] = None,
    override: ConfigFlags,
) -> None:
    """Measure the arm, print what was found and the lines for its file, and lower the arm.

    servos measures stiffness, friction, damping and delay; gravity checks that the arm stays where
    it is; payload weighs what the tool carries. Do not touch the arm meanwhile, and what stands
    within --span of it must be out of the way. Ctrl-C ends the procedure and lowers the arm.

    Args:
        arm: Configuration file, or the name of a ready one (so101, koch, vx300s, ...).
        procedure: servos, gravity or payload.
        span: Distance of the poses from the present one, per joint [rad]. Default: 0.1 for servos,
            0.3 for payload.
        override: Values that replace those of the configuration file.
    """
    options: dict[str, Any] = {} if span is None else {"span": span}
    if procedure == "gravity" and options:
        raise ConfigError("--span belongs to servos and payload: gravity moves nothing")
    read = override.load(arm)
    settings = read.settings()
    connected = connect(read)
    # Errors of the configuration appear before torque comes on.
    Controller(connected.model, settings, connected.servos)
    console = Console()
    print_line(f"{procedure}: {ANNOUNCED[procedure]}; do not touch the arm", console)
    made: list[list[str]] = []
    try:
        with connected as live:
            made.append(_measure(procedure, live, read, settings, options))
    finally:
        # After the descent of the arm: a terminal may block.
        for line in (line for lines in made for line in lines):
            print_line(line, console)


def _measure(
    procedure: Procedure,
    arm: Arm,
    read: Config,
    settings: Settings,
    options: dict[str, Any],
) -> list[str]:
    """Run a procedure; return its findings and the lines for the file."""
    if procedure == "servos":
        found = identify.identify_servos(arm, arm.model, arm.servos, **options)
        return [*found.summary(), *_servo_lines(read, found), *_payload_lines(found.payload)]
    controller = Controller(arm.model, settings, arm.servos)
    if procedure == "payload":
        weighed = identify.estimate_payload(arm, controller, **options)
        return [*weighed.summary(), *_payload_lines(weighed)]
    captured = identify.capture_gravity(arm, controller)
    return [*captured.summary(), *_gravity_lines(captured)]


def _servo_lines(read: Config, found: identify.Identification) -> list[str]:
    """Return the table [servo] with the measured stiffness, friction and damping."""
    if not read.servo:
        return ["", "# the file has no table [servo]: the built-in servos cannot be changed"]
    lines = ["", "# in place of the lines of these joints:", "[servo]"]
    for i, joint in enumerate(found.joint_names):
        own = read.servo[joint].model_dump(exclude_unset=True)
        own["kp"] = float(found.servos.kp[i])
        own["friction"] = float(found.friction[i])
        own["damping"] = float(found.servos.damping[i])
        lines.append(f"{joint} = {_toml(own)}")
    return lines


def _payload_lines(found: identify.PayloadEstimate) -> list[str]:
    """Return the payload as a line of [robot], if one was found."""
    if not found.found:
        return ["", "# no payload for the file"]
    payload = found.payload
    table = {"mass": float(payload.mass), "com": [float(value) for value in payload.com]}
    return ["", "# in the table [robot]:", f"payload = {_toml(table)}"]


def _gravity_lines(found: identify.GravityCapture) -> list[str]:
    """Return settings under which the arm stays, if it moved under its own."""
    if found.stays:
        return ["", "# nothing to change in the file: the arm stays with its settings"]
    if found.remedy is None:
        return ["", "# no settings for the file: identify the servos or the payload"]
    own = found.remedy.compensation
    return [
        "",
        "[settings.compensation]",
        f"friction = {_toml(float(own.friction))}",
        f"damping = {_toml(float(own.damping))}",
    ]


def _toml(value: Any) -> str:
    """Return a value as TOML on one line."""
    if isinstance(value, dict):
        entries = (f"{key} = {_toml(each)}" for key, each in value.items() if each is not None)
        return f"{{ {', '.join(entries)} }}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, float):
        return repr(float(f"{value:.{DIGITS}g}"))
    return str(value).lower() if isinstance(value, bool) else str(value)

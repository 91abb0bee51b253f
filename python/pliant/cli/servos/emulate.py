"""`pliant servos emulate`: emulate the servos of a configuration on virtual serial ports."""

from __future__ import annotations

import signal
import time
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from pliant._core import ConfigError
from pliant._processes import raise_priority
from pliant.cli._console import Console
from pliant.cli._flags import ArmName, FileFlags, Seconds, check_duration
from pliant.emulator import Faults, JointHand, Timing, ranges, wave

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from pliant.config import Config

#: Motion of the emulated hand that moves the arm; None: no hand.
Hand = Annotated[str | None, tyro.conf.arg(metavar="wave|ranges|FILE")]
#: Times at which the emulated hand takes hold and lets go; None: it always holds the arm.
HandTimes = Annotated[tuple[float, float] | None, tyro.conf.arg(metavar="START END")]
#: Signals that end the command besides Ctrl-C, e.g. from a service manager or a closed terminal.
END_SIGNALS = tuple(
    getattr(signal, name) for name in ("SIGTERM", "SIGHUP", "SIGQUIT") if hasattr(signal, name)
)

#: Delay of a reply above which a warning is printed [s]; LeRobot times out after 0.050 s.
MIN_REPORTED_LATENCY = 0.020


def run(
    arm: ArmName,
    *,
    timing: Literal["off", "wire", "usb"] = "off",
    lose: float = 0.0,
    seed: int = 0,
    hand: Hand = None,
    hand_during: HandTimes = None,
    duration: Seconds = None,
    override: FileFlags,
) -> None:
    """Emulate the servos of a simulated arm on virtual serial ports until Ctrl-C.

    The command prints the path of each port, for any driver or `pliant view ARM --port PATH`.

    Args:
        arm: Configuration file, or the name of a ready one (so101, koch, vx300s, ...).
        timing: Transmission time of bytes: off for none, wire as at the baud rate, usb also with
            the 16 ms latency timer of an FTDI adapter.
        lose: Share of the replies that get lost (0 to 1).
        seed: Seed of the random faults.
        hand: A hand that moves the arm, also without torque. wave swings every joint; ranges leads
            each joint through its range, without a table, for lerobot-calibrate; a motion file of
            `pliant teach` is played forth and back. Default: the arm is held until its torque
            comes on.
        hand_during: Times at which the hand takes hold and lets go [s], counted from torque on;
            until then the arm is held. Default: the hand moves the arm from the start, without end.
        duration: Time after which the command ends [s].
        override: Values that replace those of the configuration file.
    """
    from pliant.config.factory import make_emulator

    if not 0.0 <= lose <= 1.0:
        raise ConfigError(f"--lose is a share from 0 to 1, got {lose:g}")
    check_duration(duration)
    arm_config = override.load(arm, backend="emulator")
    if hand == "ranges":
        robot = arm_config.robot.model_copy(update={"table": None})
        arm_config = arm_config.model_copy(update={"robot": robot})
    if hand is None and hand_during is not None:
        raise ConfigError("--hand-during are the times of a hand: add --hand wave")
    joint_hand = None
    if hand is not None:
        joint_hand = JointHand(_motion(hand, arm_config), interval=hand_during)
    latency = 0.016 if timing == "usb" else 0.0
    bus_timing = Timing(wire=timing != "off", usb_latency=latency)
    console = Console()
    raise_priority()
    # Turn these signals into SystemExit, which removes the virtual ports.
    old_handlers = {number: signal.signal(number, _exit_on_signal) for number in END_SIGNALS}
    try:
        with make_emulator(
            arm_config, timing=bus_timing, faults=Faults(seed=seed, lose=lose), hand=joint_hand
        ) as bus:
            for name, path in bus.ports.items():
                console.print(f"{name}: {path}", highlight=False, soft_wrap=True)
            what = "is held until its torque comes on" if hand is None else "is moved by a hand"
            if hand_during is not None:
                begin, last = hand_during
                what = f"is held until its torque comes on; a hand moves it {begin:g} to {last:g} s"
                what += " later"
            console.print(f"the arm {what}; Ctrl-C ends", style="dim")
            end = None if duration is None else time.monotonic() + duration
            threshold = MIN_REPORTED_LATENCY
            while end is None or time.monotonic() < end:
                time.sleep(0.1)
                if (lateness := bus.max_latency) > threshold:
                    threshold = 2.0 * lateness  # warn again only when the lateness has doubled
                    console.print(
                        f"this computer is busy: a reply was sent {lateness * 1e3:.0f} ms late, "
                        "and drivers may treat it as lost",
                        style="yellow",
                    )
    finally:
        for number, handler in old_handlers.items():
            signal.signal(number, handler)


def _motion(hand: str, arm_config: Config) -> Callable[[float], Mapping[str, float]]:
    """Return the motion named by `--hand`: a function from time [s] to joint positions by name.

    Raises:
        ConfigError: The file is not a motion file, or its joints are not those of the arm.
    """
    from pliant.config.factory import gripper_configs, start_pose
    from pliant.teach import Motion

    model = arm_config.model()
    start = dict(zip(model.joint_names, start_pose(arm_config, model).tolist(), strict=True))
    for name, gripper in gripper_configs(arm_config).items():
        if gripper.opened is not None and gripper.closed is not None:
            start[name] = 0.5 * (gripper.opened + gripper.closed)
    if hand in ("wave", "ranges"):
        return (wave if hand == "wave" else ranges)(model, start)
    motion = Motion.load(hand)
    unknown = [name for name in motion.joints if name not in start]
    if unknown:
        raise ConfigError(
            f"--hand {hand}: a motion of other joints ({', '.join(motion.joints)}); this arm has "
            f"{', '.join(start)}. Or choose wave or ranges"
        )

    def forth_and_back(time: float) -> Mapping[str, float]:
        count, phase = divmod(time, motion.duration)
        motion_time = phase if count % 2 == 0 else motion.duration - phase
        return start | dict(zip(motion.joints, motion.at(motion_time).tolist(), strict=True))

    return forth_and_back


def _exit_on_signal(number: int, _: object) -> None:
    """Exit with the code that a shell reports for a signal: 128 plus its number."""
    raise SystemExit(128 + number)

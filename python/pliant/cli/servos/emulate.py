"""`pliant servos emulate`: emulate the servos of a configuration on a virtual port."""

from __future__ import annotations

import signal
import time
from typing import Literal

from rich.console import Console

from pliant._core import ConfigError
from pliant._priority import raise_priority
from pliant.cli._flags import ArmName, FileFlags, Seconds, check_duration
from pliant.emulator import Faults, Timing

#: Signals of a service manager, of a closing terminal, and Ctrl-\\.
ENDS = tuple(
    getattr(signal, name) for name in ("SIGTERM", "SIGHUP", "SIGQUIT") if hasattr(signal, name)
)

#: Reply latency above which a warning is printed [s]; LeRobot's timeout is 50 ms.
LATE = 0.020


def run(
    arm: ArmName,
    *,
    timing: Literal["off", "wire", "usb"] = "off",
    lose: float = 0.0,
    seed: int = 0,
    duration: Seconds = None,
    override: FileFlags,
) -> None:
    """Emulate an arm's servos, with the simulated arm behind them, until Ctrl-C.

    Prints the path of each port: open it with any driver, or with `pliant view ARM --port PATH`.

    Args:
        arm: Configuration file, or the name of a ready one (so101, koch, vx300s, ...).
        timing: How long bytes take: not at all, as on the wire, or as through an FTDI adapter whose
            latency timer is 16 ms.
        lose: Share of the answers that get lost.
        seed: Of all chance.
        duration: Ends by itself after this time [s].
        override: Values that replace those of the configuration file.
    """
    from pliant.config.factory import make_emulator

    if not 0.0 <= lose <= 1.0:
        raise ConfigError(f"--lose is a share from 0 to 1, got {lose:g}")
    check_duration(duration)
    read = override.load(arm, backend="emulator")
    latency = 0.016 if timing == "usb" else 0.0
    chosen = Timing(wire=timing != "off", usb_latency=latency)
    console = Console()
    # Remove the ports after any signal, as after Ctrl-C.
    raise_priority()
    former = {number: signal.signal(number, _ended) for number in ENDS}
    try:
        with make_emulator(read, timing=chosen, faults=Faults(seed=seed, lose=lose)) as bus:
            for name, path in bus.ports.items():
                console.print(f"{name}: {path}", highlight=False, soft_wrap=True)
            notice = "the arm is held until its torque comes on; Ctrl-C ends"
            console.print(notice, style="dim")
            end = None if duration is None else time.monotonic() + duration
            threshold = LATE
            while end is None or time.monotonic() < end:
                time.sleep(0.1)
                if (late := bus.late) > threshold:
                    threshold = 2.0 * late  # a warning only per doubling of the latency
                    console.print(
                        f"this computer is busy: an answer left {late * 1e3:.0f} ms late, and "
                        "drivers may take that for a lost one",
                        style="yellow",
                    )
    finally:
        for number, handler in former.items():
            signal.signal(number, handler)


def _ended(number: int, _: object) -> None:
    """Exit with the shell's code for a signal."""
    raise SystemExit(128 + number)

"""Control of an arm by the network, shared by `pliant ros` and `pliant foxglove`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pliant._core import Controller
from pliant.cli._console import print_line, print_summary
from pliant.cli._flags import ConfigFlags, check_duration, check_log, make_recorder
from pliant.config import connect
from pliant.config._soft import apply_soft
from pliant.loop import Loop
from pliant.ros import Bridge

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from pliant.view.ipc import ProcessLink


def control(
    arm: str,
    open_link: Callable[[], ProcessLink],
    *,
    soft: str,
    rate: float,
    duration: float | None,
    override: ConfigFlags,
    log: Path | None,
    ready: str,
) -> None:
    """Switch torque on, let the network control the arm until Ctrl-C, and lower it.

    Args:
        arm: Configuration file, or the name of a ready one.
        open_link: Function that starts the process of the network.
        soft: Axes that yield, as `--soft`.
        rate: Rate at which the state is published [Hz].
        duration: Time after which the command ends [s]; None: no limit.
        override: Values that replace those of the configuration.
        log: MCAP file to write; None: no log.
        ready: Text that is printed with the address of the process in place of {address}.
    """
    config = override.load(arm)
    check_log(log, override.inputs(arm, config))
    check_duration(duration)
    settings = apply_soft(config.settings(), soft, config.model(), option="--soft")
    # A simulated arm must keep the time of the clients.
    is_simulated = config.backend == "sim"
    connected = connect(config, real_time=True) if is_simulated else connect(config)
    # Check the settings here, so that an error is raised before torque is on.
    Controller(connected.model, settings, connected.servos)
    with open_link() as link:
        print_line(ready.format(address=link.address))
        loop = None
        try:
            with connected as live:
                controller = Controller(live.model, settings, live.servos)
                recorder = None if log is None else make_recorder(log, config=config)
                loop = Loop(
                    live,
                    controller,
                    rate=settings.rate,
                    duration=duration,
                    recorder=recorder,
                )
                bridge = Bridge(live, loop, link, rate)
                for tick in loop:
                    bridge.step(tick)
        finally:
            # Print only after the arm is lowered: a blocked terminal must not delay the descent.
            if loop is not None:
                print_summary(connected, loop)

"""Control of an arm over the network, shared by `pliant ros` and `pliant foxglove`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pliant.cli._console import print_line, print_summary
from pliant.cli._control import check_settings, load, make_loop
from pliant.cli._flags import ArmName, Axes, ConfigFlags, File, Seconds
from pliant.config import connect
from pliant.ros import Bridge

if TYPE_CHECKING:
    from collections.abc import Callable

    from pliant.view.ipc import ProcessLink


@dataclass(frozen=True, kw_only=True)
class NetworkFlags:
    """Flags of the commands that let the network control an arm.

    Attributes:
        arm: Configuration file, or the name of a ready one (so101, koch, vx300s, ...).
        soft: Axes that yield: "y yaw" with the arm's default caps, "y=2 z=5" with caps of 2 and 5 N
            (N·m for roll, pitch, yaw). The other axes keep their settings.
        state_rate: Rate of the published state [Hz].
        duration: Time after which the command ends [s].
        log: MCAP file to write (needs the extra log).
        override: Values that replace those of the configuration file.
    """

    arm: ArmName
    soft: Axes = ""
    state_rate: float = 50.0
    duration: Seconds = None
    log: File = None
    override: ConfigFlags

    def run(self, open_link: Callable[[], ProcessLink], ready: str) -> None:
        """Switch torque on, let the network control the arm until Ctrl-C, and lower it.

        Args:
            open_link: Function that starts the network process.
            ready: Text to print; {address} is replaced by the address of the process.
        """
        config, settings = load(
            self.arm, self.override, self.soft, duration=self.duration, log=self.log
        )
        # A simulated arm must run in real time, as its clients do.
        is_simulated = config.backend == "sim"
        connected = connect(config, real_time=True) if is_simulated else connect(config)
        # Check the settings here, to raise errors before torque is on.
        check_settings(connected, settings)
        with open_link() as link:
            print_line(ready.format(address=link.address))
            loop = None
            try:
                with connected as live:
                    loop = make_loop(live, settings, config, duration=self.duration, log=self.log)
                    bridge = Bridge(live, loop, link, self.state_rate)
                    for tick in loop:
                        bridge.step(tick)
            finally:
                # Print after the arm is lowered: a blocked terminal must not delay the descent.
                if loop is not None:
                    print_summary(connected, loop)

"""`pliant foxglove`: show an arm live in Foxglove, and let it command the arm."""

from __future__ import annotations

from typing import Annotated

import tyro

from pliant._core import ConfigError
from pliant.cli._flags import ArmName, Axes, ConfigFlags, File, Seconds
from pliant.cli._network import control
from pliant.ros.links import foxglove_link

#: TCP port of the WebSocket server.
Port = Annotated[int, tyro.conf.arg(metavar="PORT")]
#: Maximum TCP port number.
MAX_PORT = 65535


def run(
    arm: ArmName,
    *,
    soft: Axes = "",
    state_rate: float = 50.0,
    host: str = "127.0.0.1",
    http_port: Port = 8765,
    allow_commands: bool = False,
    duration: Seconds = None,
    log: File = None,
    override: ConfigFlags,
) -> None:
    """Switch torque on, show the arm in Foxglove until Ctrl-C, and lower it.

    Foxglove opens the printed address as a "Foxglove WebSocket". Without --allow-commands it only
    shows the arm. The server does not ask who a client is: with --allow-commands, any program on
    this computer, and any web page that is open in a browser on it, can move the arm.

    Args:
        arm: Configuration file, or the name of a ready one (so101, koch, vx300s, ...).
        soft: Axes that yield: "y yaw" with the arm's default caps, "y=2 z=5" with caps of 2 and 5 N
            (N·m for roll, pitch, yaw). The other axes keep their settings.
        state_rate: Rate of the published state [Hz].
        host: Address to listen on; 0.0.0.0 opens it to the network.
        http_port: TCP port to listen on.
        allow_commands: Take targets and parameters from clients.
        duration: Time after which the command ends [s].
        log: MCAP file to write (needs the extra log).
        override: Values that replace those of the configuration file.
    """
    if not 1 <= http_port <= MAX_PORT:
        raise ConfigError(f"--http-port is a port from 1 to {MAX_PORT}, got {http_port}")
    control(
        arm,
        lambda: foxglove_link(host=host, port=http_port, allow_commands=allow_commands),
        soft=soft,
        rate=state_rate,
        duration=duration,
        override=override,
        log=log,
        ready="Foxglove WebSocket: {address}. Ctrl-C lowers the arm.",
    )

"""`pliant foxglove`: show an arm live in Foxglove, and let it command the arm."""

from __future__ import annotations

from pliant.cli._flags import HttpPort, check_port
from pliant.cli._network import NetworkFlags
from pliant.ros.processes import foxglove_link


def run(
    control: NetworkFlags,
    *,
    host: str = "127.0.0.1",
    http_port: HttpPort = 8765,
    allow_commands: bool = False,
) -> None:
    """Switch torque on, show the arm in Foxglove until Ctrl-C, and lower it.

    Foxglove opens the printed address as a "Foxglove WebSocket". Without --allow-commands it only
    shows the arm. The server does not ask who a client is: with --allow-commands, any program on
    this computer, and any web page that is open in a browser on it, can move the arm.

    Args:
        control: Arm, softness, rate, duration and log.
        host: Address to listen on; 0.0.0.0 opens it to the network.
        http_port: TCP port to listen on.
        allow_commands: Take targets and parameters from clients.
    """
    check_port(http_port)
    control.run(
        lambda: foxglove_link(host=host, port=http_port, allow_commands=allow_commands),
        ready="Foxglove WebSocket: {address}. Ctrl-C lowers the arm.",
    )

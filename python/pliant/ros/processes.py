"""Start of the processes that talk to the network: a ROS 2 node, or a Foxglove server."""

from __future__ import annotations

import json
import math
import re

from pliant._core import ConfigError
from pliant._extras import require
from pliant.view.ipc import ProcessLink

#: Address on which the ROS 2 node listens by default: the port of a zenoh router, this computer.
LISTEN = "tcp/127.0.0.1:7447"
#: Maximum ROS domain id.
MAX_DOMAIN = 232


def ros_link(
    *,
    name: str = "pliant",
    namespace: str = "/",
    domain: int = 0,
    listen: str = LISTEN,
    connect: str = "",
) -> ProcessLink:
    """Start the process of a ROS 2 node on zenoh, for `Bridge`.

    Args:
        name: Name of the node.
        namespace: Namespace of the node and its topics, except for "/tf".
        domain: ROS domain id.
        listen: zenoh address on which the node listens as a router, "tcp/HOST:PORT".
        connect: zenoh address of a router that runs already; the node then does not listen.

    Raises:
        ConfigError: A name or the domain is invalid.
        ImportError: The extra `ros` is not installed.
        PliantError: The address is taken, or there is no router.
    """
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
        raise ConfigError(f"name of a node: letters, digits and _, got {name!r}")
    if not re.fullmatch(r"/|(/[A-Za-z][A-Za-z0-9_]*)+", namespace):
        raise ConfigError(
            "namespace: / or words of letters, digits and _ after /, such as /left, got "
            f"{namespace!r}"
        )
    if not 0 <= domain <= MAX_DOMAIN:
        raise ConfigError(f"ROS domain id = {domain} is outside [0, {MAX_DOMAIN}]")
    require("pliant ros", "ros", "zenoh", "rosbags")
    options = {
        "name": name,
        "namespace": namespace,
        "domain": domain,
        "listen": listen,
        "connect": connect,
    }
    return ProcessLink("ROS 2 node", "pliant.ros.node", json.dumps(options), rate=math.inf)


def foxglove_link(
    *, host: str = "127.0.0.1", port: int = 8765, allow_commands: bool = False
) -> ProcessLink:
    """Start the process of a Foxglove WebSocket server, for `Bridge`.

    Args:
        host: Address on which to listen.
        port: TCP port; 0: a free one.
        allow_commands: Accept targets and parameters. The server does not authenticate clients: any
            program, and any web page that is open in a browser on this computer, can then move the
            arm.

    Raises:
        ImportError: The extra `foxglove` is not installed.
        PliantError: The address is taken.
    """
    require("pliant foxglove", "foxglove", "foxglove", "rosbags")
    options = {"host": host, "port": port, "allow_commands": allow_commands}
    return ProcessLink(
        "Foxglove server", "pliant.ros.foxglove_server", json.dumps(options), rate=math.inf
    )

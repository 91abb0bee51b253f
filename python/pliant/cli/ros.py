"""`pliant ros`: a ROS 2 node for an arm, without ROS on its computer."""

from __future__ import annotations

import os
from typing import Annotated

import tyro

from pliant._core import ConfigError
from pliant.cli._network import NetworkFlags
from pliant.ros.processes import LISTEN, ros_link

#: zenoh address.
Endpoint = Annotated[str, tyro.conf.arg(metavar="tcp/HOST:PORT")]
#: ROS domain id; None: the value of the environment variable ROS_DOMAIN_ID.
Domain = Annotated[int | None, tyro.conf.arg(metavar="ID")]


def run(
    control: NetworkFlags,
    *,
    name: str = "pliant",
    namespace: str = "/",
    domain: Domain = None,
    listen: Endpoint = LISTEN,
    connect: Endpoint = "",
) -> None:
    """Switch torque on, let ROS 2 nodes control the arm until Ctrl-C, and lower it.

    ROS 2 nodes with RMW_IMPLEMENTATION=rmw_zenoh_cpp see the arm as a node. This computer needs no
    ROS. By default only programs on this computer can connect; --listen tcp/0.0.0.0:7447 opens the
    arm to everyone on the network, without encryption or password.

    Args:
        control: Arm, softness, rate, duration and log.
        name: Name of the node.
        namespace: Namespace of the node and its topics.
        domain: ROS domain id. Default: the environment variable ROS_DOMAIN_ID, or 0.
        listen: Address on which the node listens, as a zenoh router.
        connect: Address of a router that runs already (rmw_zenohd), in place of --listen.
    """
    control.run(
        lambda: ros_link(
            name=name,
            namespace=namespace,
            domain=_domain() if domain is None else domain,
            listen=listen,
            connect=connect,
        ),
        ready=f"ROS 2 node {namespace.rstrip('/')}/{name} at {{address}}. Ctrl-C lowers the arm.",
    )


def _domain() -> int:
    """Return the ROS domain id of the environment; 0 without one."""
    text = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not text.isdecimal():
        raise ConfigError(f"ROS_DOMAIN_ID is a number, got {text!r}: set it, or use --domain")
    return int(text)

"""`pliant view`: control an arm from a page in the browser."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import tyro

import pliant.robots
from pliant._core import ConfigError
from pliant._extras import require
from pliant.cli._console import Console
from pliant.cli._flags import ArmName, ConfigFlags, File, HttpPort, check_log, check_port

if TYPE_CHECKING:
    from pliant.view.source import Source

#: Name of a simulated scene; None: the arm of the configuration, without a scene.
Scene = Annotated[str | None, tyro.conf.arg(metavar="SCENE")]


def run(
    arm: ArmName = "",
    *,
    scene: Scene = None,
    rate: float = 100.0,
    host: str = "127.0.0.1",
    http_port: HttpPort = 8080,
    browser: bool = False,
    log: File = None,
    override: ConfigFlags,
) -> None:
    """Control an arm from a page in the browser until Ctrl-C, and lower the arm.

    Without ARM, or with --scene, the arm is simulated. The page opens only with the token in its
    link, and only on this machine. With another --host, everyone on that network who has the link
    can move the arm; the data are not encrypted.

    Args:
        arm: Configuration file, or the name of a ready one (so101, koch, vx300s, ...). Default: a
            simulated arm7.
        scene: Simulate ARM, one of arm7, so101 and koch, in a scene: free, door, drawer, wall or
            hand-over.
        rate: Control rate of the simulated arm [Hz].
        host: Address to listen on; 0.0.0.0 opens it to the network.
        http_port: TCP port to listen on.
        browser: Open the page in the default browser.
        log: MCAP file to write (needs the extra log).
        override: Values that replace those of the configuration file.
    """
    check_port(http_port)
    is_simulated = not arm or scene is not None
    check_log(log, [] if is_simulated else override.inputs(arm, override.load(arm)))
    require("the page", "view", "viser", "mjviser")
    from pliant.view.auth import is_loopback
    from pliant.view.ipc import Link
    from pliant.view.session import Session
    from pliant.view.source import Configured

    source = (
        _simulated(arm or "arm7", scene or "free", rate, override)
        if is_simulated
        else Configured(override.load(arm))
    )
    console = Console()
    with Link(host, http_port) as link:
        console.print(f"{link.address}", highlight=False, soft_wrap=True)
        console.print(
            "Open this link in a browser. STOP on the page lowers the arm; Ctrl-C here lowers the "
            "arm and ends the page.",
            highlight=False,
        )
        if not is_loopback(host):
            console.print(
                f"[bold]Open to the network on {host}:[/bold] anyone with this link can move the "
                "arm, and the data are not encrypted.",
                highlight=False,
            )
        if browser:
            import webbrowser

            webbrowser.open(link.address)
        Session(source, link, log).run()


def _simulated(robot: str, scene: str, rate: float, override: ConfigFlags) -> Source:
    """Return the `Source` of a simulated built-in arm; reject flags that change a configuration."""
    from pliant.view.source import Simulated

    if robot not in pliant.robots.names():
        built_in = ", ".join(pliant.robots.names())
        raise ConfigError(f"--scene simulates one of {built_in}, got {robot}: leave --scene out")
    if options := override.as_arguments():
        flag = options[0].split()[0]
        raise ConfigError(f"{flag} belongs to a configuration: pliant view so101 {options[0]}")
    source = Simulated(robot, scene, rate)
    source.arm()  # so that an invalid rate is an error before the page starts
    return source

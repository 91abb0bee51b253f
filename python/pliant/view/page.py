"""The page's process: a web server that shows snapshots and passes messages on.

``python -m pliant.view.page DESCRIPTOR HOST PORT`` is started by `Link`, never by hand.
"""

from __future__ import annotations

import socket
import sys
import time
from typing import TYPE_CHECKING

import viser

from pliant._priority import lower_priority
from pliant.view.auth import TokenAuth
from pliant.view.ipc import PageEndpoint, Ready, StartupError
from pliant.view.messages import LetGo
from pliant.view.panel import Panel
from pliant.view.scene_view import SceneView
from pliant.view.snapshot import SceneInfo, Snapshot

if TYPE_CHECKING:
    from collections.abc import Callable

    from pliant.view.messages import Message

#: Time for which the page shows that the loop has ended, before it ends [s].
DISCONNECTED_TIME = 2.0


class Page:
    """The server with all parts of the page.

    Args:
        send: Receiver of the messages.
        host, port: Where to listen; the next free port is taken.

    Attributes:
        server: viser's server.
        link: Link of the page.
    """

    def __init__(self, send: Callable[[Message], None], host: str, port: int) -> None:
        """Start to listen, with an empty page."""
        auth = TokenAuth()
        auth.install()
        self.server = viser.ViserServer(host=host, port=port, verbose=False, label="pliant")
        name = host if host not in {"0.0.0.0", "::"} else "localhost"
        self.link = f"http://{name}:{self.server.get_port()}/#token={auth.token}"
        self._send = send
        self.scene_view: SceneView | None = None
        self.panel: Panel | None = None
        self.server.gui.configure_theme(
            show_logo=False, show_share_button=False, brand_color=(28, 100, 200)
        )
        self.server.on_client_disconnect(self._left)

    def _left(self, client: viser.ClientHandle) -> None:
        """Release the hand of a visitor who has left; a push ends by its timeout."""
        if self.scene_view is not None and self.scene_view.held_by == client.client_id:
            self._send(LetGo())

    def receive(self, word: SceneInfo | Snapshot) -> None:
        """Process a message of the loop."""
        if isinstance(word, SceneInfo):
            self.scene_view = SceneView(self.server, word, self._send)
            self.panel = Panel(self.server, word, self._send)
            return
        if self.scene_view is not None and self.panel is not None:
            with self.server.atomic():
                self.scene_view.show(word)
            self.panel.show(word)

    def show_disconnected(self) -> None:
        """Show that the loop has ended."""
        if self.panel is not None:
            self.panel.stop.show_disconnected()
        self.server.flush()
        time.sleep(DISCONNECTED_TIME)
        self.server.stop()


def main(descriptor: int, host: str, port: int) -> int:
    """Serve until the loop ends."""
    endpoint = PageEndpoint(descriptor)
    lower_priority()
    try:
        # viser tries a thousand ports and then blocks.
        family, *_, address = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            probe.bind(address)
        page = Page(endpoint.queue, host, port)
    except OSError as error:
        endpoint.send(StartupError(f"the page cannot listen on {host}:{port}: {error}"))
        return 1
    endpoint.send(Ready(page.link))
    while (word := endpoint.receive()) is not None:
        page.receive(word)
    page.show_disconnected()
    return 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), sys.argv[2], int(sys.argv[3])))

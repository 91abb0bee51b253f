"""The page's process: a web server that shows snapshots and passes orders on.

``python -m pliant.view.page DESCRIPTOR HOST PORT`` is started by `Link`, never by hand.
"""

from __future__ import annotations

import socket
import sys
import time
from typing import TYPE_CHECKING

import viser

from pliant._priority import lower_priority
from pliant.view.gate import Gate
from pliant.view.link import Ear, Failed, Ready
from pliant.view.orders import LetGo
from pliant.view.panel import Panel
from pliant.view.snapshot import Snapshot, Stage
from pliant.view.world import World

if TYPE_CHECKING:
    from collections.abc import Callable

    from pliant.view.orders import Order

#: Time for which the page shows that the loop has ended, before it ends [s].
FAREWELL = 2.0


class Page:
    """The server with all parts of the page.

    Args:
        tell: Receiver of the orders.
        host, port: Where to listen; the next free port is taken.

    Attributes:
        server: viser's server.
        link: Link of the page.
    """

    def __init__(self, tell: Callable[[Order], None], host: str, port: int) -> None:
        """Start to listen, with an empty page."""
        gate = Gate()
        gate.close()
        self.server = viser.ViserServer(host=host, port=port, verbose=False, label="pliant")
        name = host if host not in {"0.0.0.0", "::"} else "localhost"
        self.link = f"http://{name}:{self.server.get_port()}/#token={gate.token}"
        self._tell = tell
        self.world: World | None = None
        self.panel: Panel | None = None
        self.server.gui.configure_theme(
            show_logo=False, show_share_button=False, brand_color=(28, 100, 200)
        )
        self.server.on_client_disconnect(self._left)

    def _left(self, client: viser.ClientHandle) -> None:
        """Release the hand of a visitor who has left; a push ends by its timeout."""
        if self.world is not None and self.world.held_by == client.client_id:
            self._tell(LetGo())

    def hear(self, word: Stage | Snapshot) -> None:
        """Process a message of the loop."""
        if isinstance(word, Stage):
            self.world = World(self.server, word, self._tell)
            self.panel = Panel(self.server, word, self._tell)
            return
        if self.world is not None and self.panel is not None:
            with self.server.atomic():
                self.world.show(word)
            self.panel.show(word)

    def farewell(self) -> None:
        """Show that the loop has ended."""
        if self.panel is not None:
            self.panel.stop.farewell()
        self.server.flush()
        time.sleep(FAREWELL)
        self.server.stop()


def main(descriptor: int, host: str, port: int) -> int:
    """Serve until the loop ends."""
    ear = Ear(descriptor)
    lower_priority()
    try:
        # viser tries a thousand ports and then blocks.
        family, *_, address = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            probe.bind(address)
        page = Page(ear.ask, host, port)
    except OSError as error:
        ear.say(Failed(f"the page cannot listen on {host}:{port}: {error}"))
        return 1
    ear.say(Ready(page.link))
    while (word := ear.listen()) is not None:
        page.hear(word)
    page.farewell()
    return 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), sys.argv[2], int(sys.argv[3])))

"""Process of the browser page: a web server that shows the arm and sends messages to the loop.

`Link` starts ``python -m pliant.view.page DESCRIPTOR HOST PORT``.
"""

from __future__ import annotations

import asyncio
import socket
import sys
import time
from typing import TYPE_CHECKING, Any

import viser
from viser._messages import GuiUpdateMessage

from pliant._processes import lower_priority
from pliant.view.auth import TokenAuth
from pliant.view.ipc import PageEndpoint, Ready, StartupError
from pliant.view.messages import LetGo
from pliant.view.panel import Panel
from pliant.view.scene_view import SceneView
from pliant.view.snapshot import Ended, SceneInfo, Snapshot

if TYPE_CHECKING:
    from collections.abc import Callable

    from pliant.view.messages import Message

#: Time for which the page still shows that the loop has ended, before its server stops [s].
DISCONNECTED_TIME = 2.0


class Page:
    """Web server of the browser page, with the 3-D scene and the panels.

    Args:
        send: Function that sends a message to the control loop.
        host, port: Address on which to listen; if the port is taken, the next free one is used.

    Attributes:
        server: viser's server.
        link: Link that opens the page, with its access token.
        scene_view: The 3-D scene; None until the loop has sent the first scene.
        panel: The panels; None until the loop has sent the first scene.
    """

    def __init__(self, send: Callable[[Message], None], host: str, port: int) -> None:
        """Start the server with an empty page."""
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
        self.server.on_client_connect(self._on_connect)
        self.server.on_client_disconnect(self._on_disconnect)
        self._protect_controls()

    def _protect_controls(self) -> None:
        """Let a browser change only the values of controls.

        viser itself would accept every attribute; a change that removes the STOP button would end
        the page.
        """
        change, interface = self.server.gui._handle_gui_updates, self.server._websock_server

        async def change_value(client: Any, message: GuiUpdateMessage) -> None:
            if message.updates.keys() == {"value"}:
                await change(client, message)

        interface.unregister_handler(GuiUpdateMessage, change)
        interface.register_handler(GuiUpdateMessage, change_value)

    async def _on_connect(self, client: viser.ClientHandle) -> None:
        """Minimize the left panel in a narrow window, where it would hide the arm."""
        if self.panel is not None:
            self.panel.fit(client)

    def _on_disconnect(self, client: viser.ClientHandle) -> None:
        """Release the arm if the disconnected client was dragging it; a push ends by itself."""
        if self.scene_view is not None and self.scene_view.held_by == client.client_id:
            self._send(LetGo())

    def receive(self, message: SceneInfo | Snapshot | Ended) -> None:
        """Build the page for a new scene (`SceneInfo`), or show a snapshot or the end of the arm.

        This happens in the thread of viser's event loop: from another thread, viser wakes the tasks
        of its connections unsafely, which fails at times, more often with several tabs.
        """

        async def show() -> None:
            self._show(message)

        loop = self.server.get_event_loop()
        asyncio.run_coroutine_threadsafe(show(), loop).result()

    def _show(self, message: SceneInfo | Snapshot | Ended) -> None:
        if isinstance(message, SceneInfo):
            self.scene_view = SceneView(self.server, message, self._send)
            self.panel = Panel(self.server, message, self._send)
            for client in self.server.get_clients().values():
                self.panel.fit(client)
            return
        if isinstance(message, Ended):
            if self.panel is not None:
                self.panel.stop.show_end(message)
            return
        if self.scene_view is not None and self.panel is not None:
            with self.server.atomic():
                self.scene_view.show(message)
            self.panel.show(message)

    def show_disconnected(self) -> None:
        """Show that the loop has ended, and stop the server after `DISCONNECTED_TIME`.

        An end that the loop has sent stays on the page.
        """
        if self.panel is not None:
            self.panel.stop.show_disconnected()
        self.server.flush()
        time.sleep(DISCONNECTED_TIME)
        self.server.stop()


def main(descriptor: int, host: str, port: int) -> int:
    """Serve the page until the control loop ends; return the exit code of the process."""
    endpoint = PageEndpoint(descriptor)
    lower_priority()
    try:
        # Test the address first: if it is not one of this machine, viser would try 1000 ports.
        family, *_, address = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            probe.bind(address)
        page = Page(endpoint.queue, host, port)
    except OSError as error:
        endpoint.send(StartupError(f"the page cannot listen on {host}:{port}: {error}"))
        return 1
    endpoint.send(Ready(page.link))
    while (message := endpoint.receive()) is not None:
        page.receive(message)
    page.show_disconnected()
    return 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), sys.argv[2], int(sys.argv[3])))

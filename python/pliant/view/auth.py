"""Access control of the page: a random token that the page's script sends with its web socket.

A page that moves a robot must not be open to every program and every web page on the machine. The
token is in the fragment of the link, which a browser sends to no server. A script in the page keeps
it in the tab's session storage, which is separate for every host and port, and sends it in the
address of the web socket. There is no cookie: a browser would send it to every other server on the
same host, and two pages on one machine would overwrite each other's.
"""

from __future__ import annotations

import functools
import gzip
import hmac
import http
import ipaddress
import logging
import secrets
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, urlsplit

import viser
import websockets.asyncio.server
from websockets.datastructures import Headers
from websockets.http11 import Response

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request

#: Random bytes in a token.
BYTES = 24
REFUSED = "This page moves a robot: open it by the link that `pliant view` prints on its terminal."
#: Document that viser serves; its scripts and styles are inside it.
INDEX = Path(viser.__file__).parent / "client" / "build" / "index.html"
#: Takes the token out of the address, and adds it to the address of viser's web socket. viser opens
#: the socket in a worker, which is told the address by a message.
SCRIPT = """<script>
(() => {
  const found = location.hash.match(/^#token=([\\w-]+)$/);
  if (found) {
    sessionStorage.setItem("pliant-token", found[1]);
    history.replaceState(null, "", location.pathname);
  }
  addEventListener("hashchange", () => location.reload());
  const token = sessionStorage.getItem("pliant-token");
  if (token === null) {
    location.replace("/refused");
    return;
  }
  const scheme = location.protocol === "https:" ? "wss:" : "ws:";
  const post = Worker.prototype.postMessage;
  Worker.prototype.postMessage = function (message, ...more) {
    if (message && message.type === "set_server") {
      message = { ...message, server: `${scheme}//${location.host}/?token=${token}` };
    }
    return post.call(this, message, ...more);
  };
})();
</script>"""
#: Headers of every response: no cache, no referrer, no embedding in another page.
HEADERS = {
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}


class TokenAuth:
    """Answers every request to the page's server, and accepts web sockets with the token.

    Attributes:
        token: Random, new in each run.
    """

    def __init__(self) -> None:
        """Generate a token."""
        self.token = secrets.token_urlsafe(BYTES)

    def respond(self, request: Request) -> Response | None:
        """Return the response to a request; None accepts a web socket.

        A web socket needs the token and the page's own origin. Every other request gets the page's
        document, which contains no secret, or a rejection.
        """
        address = urlsplit(request.path)
        if ",".join(request.headers.get_all("Upgrade")).lower() == "websocket":
            return None if self._own(request, address.query) else _text(http.HTTPStatus.FORBIDDEN)
        if address.path == "/refused":
            return _text(http.HTTPStatus.FORBIDDEN)
        if address.path not in {"/", "/index.html"}:
            return _text(http.HTTPStatus.NOT_FOUND)
        zipped = "gzip" in ",".join(request.headers.get_all("Accept-Encoding"))
        return _answer(http.HTTPStatus.OK, "text/html", _document(zipped), zipped=zipped)

    def _own(self, request: Request, query: str) -> bool:
        """Return True if a web socket belongs to this run's page."""
        hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
        if len(hosts) != 1 or len(origins) != 1 or urlsplit(origins[0]).netloc != hosts[0]:
            return False
        sent = parse_qs(query).get("token", [])
        return len(sent) == 1 and hmac.compare_digest(sent[0].encode(), self.token.encode())

    def install(self) -> None:
        """Apply this check to every server that the process starts from now on.

        viser has no hook for requests, so the function that starts its server is replaced. Hence
        `viser<1.2`, and a test that opens a web socket without the token.
        """
        inner = websockets.asyncio.server.serve

        @functools.wraps(inner)
        def serve(*args: Any, process_request: Any = None, **more: Any) -> Any:
            def ask(_: ServerConnection, request: Request) -> Response | None:
                return self.respond(request)

            return inner(*args, process_request=ask, **more)

        # A malformed request (a port scan) must not print a traceback.
        logging.getLogger("websockets.server").setLevel(logging.CRITICAL)
        # `serve` is a class, but viser only calls it, so a function can replace it.
        vars(websockets.asyncio.server)["serve"] = serve


@functools.cache
def _document(zipped: bool) -> bytes:
    """Return viser's page with our script before its own."""
    text = INDEX.read_text(encoding="utf-8")
    body = text.replace("<head>", f"<head>{SCRIPT}", 1).replace("<title>Viser<", "<title>pliant<")
    return gzip.compress(body.encode()) if zipped else body.encode()


def _text(status: http.HTTPStatus) -> Response:
    return _answer(status, "text/plain", f"{REFUSED}\n".encode())


def _answer(status: http.HTTPStatus, kind: str, body: bytes, *, zipped: bool = False) -> Response:
    headers = Headers(HEADERS)
    headers["Content-Type"] = f"{kind}; charset=utf-8"
    headers["Content-Length"] = str(len(body))
    if zipped:
        headers["Content-Encoding"] = "gzip"
    return Response(status.value, status.phrase, headers, body)


def is_loopback(host: str) -> bool:
    """Return True for an address that only this machine can reach."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"

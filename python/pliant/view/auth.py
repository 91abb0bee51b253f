"""Access control of the browser page: its web socket is accepted only with a random token.

A page that moves a robot must not be open to every program and every web page on the machine. The
token is in the fragment of the page's link (after #), which a browser sends to no server. A script
in the page keeps it in the tab's session storage, which is separate for every host and port, and
sends it in the address of the web socket. A cookie is not suitable: a browser would send it to all
servers on the host, and two pages on one machine would overwrite each other's cookie.
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

#: Number of random bytes in the token, before it is encoded as text.
TOKEN_BYTES = 24
#: Largest message that a browser may send [bytes]; the page sends less than 1000 bytes.
MAX_MESSAGE = 65_536
#: Text of the response to every rejected request.
REFUSAL = "This page moves a robot: open it by the link that `pliant view` prints on its terminal."
#: HTML file of the browser page that viser serves; the file contains its scripts and styles.
VISER_PAGE = Path(viser.__file__).parent / "client" / "build" / "index.html"
#: Script that takes the token from the address of the page and adds it to the address of viser's
#: web socket. viser sends that address in a message to the web worker that opens the socket.
TOKEN_SCRIPT = """<script>
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
#: Script that gives an emptied number box its last number back: viser sends no message about an
#: empty box, which would stay empty. The event `input` lets viser's React code take the number.
NUMBER_SCRIPT = """<script>
(() => {
  const last = new WeakMap();
  const value = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value");
  const isNumber = (box) =>
    box instanceof HTMLInputElement && ["decimal", "numeric"].includes(box.inputMode);
  for (const kind of ["focusin", "input"]) {
    addEventListener(kind, ({ target }) => {
      if (isNumber(target) && target.value !== "") last.set(target, target.value);
    });
  }
  addEventListener("focusout", ({ target }) => {
    if (isNumber(target) && target.value === "" && last.has(target)) {
      value.set.call(target, last.get(target));
      target.dispatchEvent(new Event("input", { bubbles: true }));
    }
  });
})();
</script>"""
#: HTTP headers of every response: they forbid caching, referrers and embedding in another page.
HEADERS = {
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}


class TokenAuth:
    """Access check of the page's web server: accepts web sockets only with a random token.

    Attributes:
        token: The token as text, different for each object of this class.
    """

    def __init__(self) -> None:
        """Generate a new random token."""
        self.token = secrets.token_urlsafe(TOKEN_BYTES)

    def respond(self, request: Request) -> Response | None:
        """Return the response to a request; None: the request is a web socket and is accepted.

        A web socket is accepted if the request has the token and comes from a page of this server.
        Every other request gets the HTML page, which contains no secret, or a rejection.
        """
        address = urlsplit(request.path)
        if ",".join(request.headers.get_all("Upgrade")).lower() == "websocket":
            return (
                None
                if self._is_authorized(request, address.query)
                else _refusal(http.HTTPStatus.FORBIDDEN)
            )
        if address.path == "/refused":
            return _refusal(http.HTTPStatus.FORBIDDEN)
        if address.path not in {"/", "/index.html"}:
            return _refusal(http.HTTPStatus.NOT_FOUND)
        zipped = "gzip" in ",".join(request.headers.get_all("Accept-Encoding"))
        return _response(http.HTTPStatus.OK, "text/html", _page(zipped), zipped=zipped)

    def _is_authorized(self, request: Request, query: str) -> bool:
        """Return True if a web socket request has the token and this server's page as origin."""
        hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
        if len(hosts) != 1 or len(origins) != 1 or urlsplit(origins[0]).netloc != hosts[0]:
            return False
        sent = parse_qs(query).get("token", [])
        return len(sent) == 1 and hmac.compare_digest(sent[0].encode(), self.token.encode())

    def install(self) -> None:
        """Install this check in every `websockets` server that the process starts from now on.

        A message of more than `MAX_MESSAGE` bytes closes its web socket.

        viser has no hook for requests, so this method replaces the function with which viser starts
        its server. Other versions of viser may not use that function, so the package requires
        `viser<1.2`.
        """
        original = websockets.asyncio.server.serve

        @functools.wraps(original)
        def serve(*args: Any, process_request: Any = None, **options: Any) -> Any:
            def process(_: ServerConnection, request: Request) -> Response | None:
                return self.respond(request)

            limits = {"max_size": MAX_MESSAGE, "process_request": process}
            return original(*args, **{**options, **limits})

        # Raise the log level: at lower ones, a malformed request (a port scan) prints a traceback.
        logging.getLogger("websockets.server").setLevel(logging.CRITICAL)
        # The original `serve` is a class, but a function can replace it, as viser only calls it.
        vars(websockets.asyncio.server)["serve"] = serve


@functools.cache
def _page(zipped: bool) -> bytes:
    """Return viser's HTML page with this module's scripts first; gzipped if `zipped` is True."""
    text = VISER_PAGE.read_text(encoding="utf-8")
    body = text.replace("<head>", f"<head>{TOKEN_SCRIPT}{NUMBER_SCRIPT}", 1).replace(
        "<title>Viser<", "<title>pliant<"
    )
    return gzip.compress(body.encode()) if zipped else body.encode()


def _refusal(status: http.HTTPStatus) -> Response:
    return _response(status, "text/plain", f"{REFUSAL}\n".encode())


def _response(
    status: http.HTTPStatus, content_type: str, body: bytes, *, zipped: bool = False
) -> Response:
    headers = Headers(HEADERS)
    headers["Content-Type"] = f"{content_type}; charset=utf-8"
    headers["Content-Length"] = str(len(body))
    if zipped:
        headers["Content-Encoding"] = "gzip"
    return Response(status.value, status.phrase, headers, body)


def is_loopback(host: str) -> bool:
    """Return True if a host name or IP address can be reached only from this machine."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"

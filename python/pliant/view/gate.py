"""Who may look: a token in the link, then a cookie, and no page of another origin.

A page that moves a robot must not be open to every program and every web page on the machine. The
link carries a random token; who comes with it gets a cookie that scripts cannot read and other
sites cannot send. Web sockets ask for the cookie and for their own origin.
"""

from __future__ import annotations

import functools
import hmac
import http
import ipaddress
import secrets
from http.cookies import SimpleCookie
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, urlsplit

import websockets.asyncio.server
from websockets.datastructures import Headers
from websockets.http11 import Response

if TYPE_CHECKING:
    from collections.abc import Callable

    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request

#: Bytes of randomness in a token.
BYTES = 24
COOKIE = "pliant-view"
REFUSED = (
    "This page moves a robot: open it by the link that `pliant view` prints on its terminal.\n"
)


class Gate:
    """Asks every request for the token.

    Attributes:
        token: Random, new in each run.
    """

    def __init__(self) -> None:
        """Draw a token."""
        self.token = secrets.token_urlsafe(BYTES)

    def judge(self, request: Request) -> Response | str | None:
        """A refusal, a cookie to be set, or None where the request may pass as it is."""
        if request.headers.get("Upgrade", "").lower() == "websocket":
            here = request.headers.get("Origin", "")
            own = urlsplit(here).netloc == request.headers.get("Host", "") != ""
            return None if own and self._knows(request) else self._refuse()
        given = parse_qs(urlsplit(request.path).query).get("token", [""])[0]
        if given and hmac.compare_digest(given.encode(), self.token.encode()):
            return f"{COOKIE}={self.token}; HttpOnly; SameSite=Strict; Path=/"
        return None if self._knows(request) else self._refuse()

    def _knows(self, request: Request) -> bool:
        for line in request.headers.get_all("Cookie"):
            for name, crumb in SimpleCookie(line).items():
                right = hmac.compare_digest(crumb.value.encode(), self.token.encode())
                if name == COOKIE and right:
                    return True
        return False

    @staticmethod
    def _refuse() -> Response:
        text = REFUSED.encode()
        headers = Headers({"Content-Type": "text/plain", "Content-Length": str(len(text))})
        return Response(http.HTTPStatus.FORBIDDEN, "Forbidden", headers, text)

    def close(self) -> None:
        """Let every server of this process that starts from now on ask.

        viser has no place for that, so the function by which it starts is replaced; `viser<1.2`,
        and a test asks for the page without the token.
        """
        inner = websockets.asyncio.server.serve

        @functools.wraps(inner)
        def serve(
            *args: Any, process_request: Callable[..., Any] | None = None, **more: Any
        ) -> Any:
            def ask(connection: ServerConnection, request: Request) -> Response | None:
                judged = self.judge(request)
                if isinstance(judged, Response):
                    return judged
                answer: Response | None = None
                if process_request is not None:
                    answer = process_request(connection, request)
                if judged is not None and answer is not None:
                    answer.headers["Set-Cookie"] = judged
                    answer.headers["Referrer-Policy"] = "no-referrer"
                    answer.headers["Cache-Control"] = "no-store"
                return answer

            return inner(*args, process_request=ask, **more)

        # A class of that name, of which viser uses the call alone: a function will do.
        vars(websockets.asyncio.server)["serve"] = serve


def is_loopback(host: str) -> bool:
    """Whether an address is reached from this machine alone."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"

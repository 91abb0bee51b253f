"""Who gets in: the token, then the cookie, and only the page's own origin."""

from __future__ import annotations

import http

import pytest
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from pliant.view.gate import COOKIE, Gate, is_loopback

HOST = "127.0.0.1:8080"


def ask(gate, path="/", **headers):
    given = Headers({"Host": HOST})
    for name, value in headers.items():
        given[name.replace("_", "-")] = value
    return gate.judge(Request(path, given))


def socket(gate, **headers):
    return ask(gate, Upgrade="websocket", **headers)


def refused(answer):
    return isinstance(answer, Response) and answer.status_code == http.HTTPStatus.FORBIDDEN


@pytest.fixture
def gate():
    return Gate()


def test_without_the_token_nobody_gets_in(gate):
    assert refused(ask(gate))
    assert refused(ask(gate, "/?token="))
    assert refused(ask(gate, f"/?token={gate.token[:-1]}"))
    assert refused(ask(gate, "/index.html", Cookie=f"{COOKIE}=wrong"))
    assert refused(ask(gate, "/", Cookie="gibberish;;=;"))


def test_token_becomes_a_cookie_that_scripts_and_other_sites_cannot_use(gate):
    cookie = ask(gate, f"/?token={gate.token}")
    assert isinstance(cookie, str)
    assert cookie.startswith(f"{COOKIE}={gate.token};")
    assert "HttpOnly" in cookie
    assert "SameSite=Strict" in cookie
    assert ask(gate, Cookie=f"other=1; {COOKIE}={gate.token}") is None


def test_socket_wants_cookie_and_its_own_origin(gate):
    cookie = f"{COOKIE}={gate.token}"
    own = f"http://{HOST}"
    assert socket(gate, Cookie=cookie, Origin=own) is None
    assert refused(socket(gate, Origin=own))
    assert refused(socket(gate, Cookie=cookie))
    assert refused(socket(gate, Cookie=cookie, Origin="http://127.0.0.1:9999"))
    assert refused(socket(gate, Cookie=cookie, Origin="http://example.org"))
    assert refused(socket(gate, Cookie=cookie, Origin="null"))


def test_token_in_the_address_opens_no_socket(gate):
    answer = ask(gate, f"/?token={gate.token}", Upgrade="websocket", Origin=f"http://{HOST}")
    assert refused(answer)


def test_tokens_are_long_and_differ():
    tokens = {Gate().token for _ in range(20)}
    assert len(tokens) == 20
    assert min(map(len, tokens)) >= 32


@pytest.mark.parametrize(
    ("host", "local"),
    [("127.0.0.1", True), ("::1", True), ("localhost", True), ("0.0.0.0", False), ("robot", False)],
)
def test_loopback_is_told_from_the_network(host, local):
    assert is_loopback(host) is local

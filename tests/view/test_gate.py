"""Access to the page: a web socket needs the token and the origin of the page, but no cookie."""

from __future__ import annotations

import http
import socket

import pytest
from websockets.datastructures import Headers
from websockets.exceptions import InvalidStatus
from websockets.http11 import Request, Response
from websockets.sync.client import connect

from pliant.view.auth import TokenAuth, is_loopback
from pliant.view.ipc import Link

HOST = "127.0.0.1:8080"
PAGE_ORIGIN = f"http://{HOST}"


def ask(gate, path="/", *extra, **headers):
    request_headers = Headers({"Host": HOST})
    for name, value in (*headers.items(), *extra):
        request_headers[name.replace("_", "-")] = value
    return gate.respond(Request(path, request_headers))


def open_socket(gate, path, *extra, **headers):
    return ask(gate, path, *extra, Upgrade="websocket", **headers)


def refused(answer):
    return isinstance(answer, Response) and answer.status_code == http.HTTPStatus.FORBIDDEN


@pytest.fixture
def gate():
    return TokenAuth()


def test_socket_with_the_token_and_its_own_origin_gets_in(gate):
    assert open_socket(gate, f"/?token={gate.token}", Origin=PAGE_ORIGIN) is None


@pytest.mark.parametrize("headers", ["", "wrong", "{}x", "é", "{0}&token={0}", "{0}&token=wrong"])
def test_socket_without_the_token_is_refused(gate, headers):
    assert refused(open_socket(gate, f"/?token={headers.format(gate.token)}", Origin=PAGE_ORIGIN))
    assert refused(open_socket(gate, "/", Origin=PAGE_ORIGIN))
    assert refused(open_socket(gate, "/", Origin=PAGE_ORIGIN, Cookie=f"pliant-view={gate.token}"))


@pytest.mark.parametrize(
    "origin",
    ["null", "", "http://127.0.0.1:9999", "http://example.org", f"{PAGE_ORIGIN}.example.org"],
)
def test_socket_of_another_origin_is_refused(gate, origin):
    path = f"/?token={gate.token}"
    assert refused(open_socket(gate, path))
    assert refused(open_socket(gate, path, Origin=origin))
    assert refused(open_socket(gate, path, ("Origin", PAGE_ORIGIN), Origin=origin))


def test_repeated_headers_are_not_an_error(gate):
    header = ("Upgrade", "websocket")
    assert refused(open_socket(gate, f"/?token={gate.token}", ("Host", HOST), Origin=PAGE_ORIGIN))
    assert isinstance(
        open_socket(gate, f"/?token={gate.token}", header, Origin=PAGE_ORIGIN), Response
    )


@pytest.mark.parametrize("path", ["/", "/index.html", "/?token=anything", "/?websocket=ws://a"])
def test_page_itself_holds_no_token_and_sets_no_cookie(gate, path):
    answer = ask(gate, path)
    assert answer.status_code == http.HTTPStatus.OK
    assert "Set-Cookie" not in answer.headers
    assert gate.token.encode() not in answer.body
    assert answer.headers["Referrer-Policy"] == "no-referrer"
    assert answer.headers["X-Frame-Options"] == "DENY"


@pytest.mark.parametrize("path", ["/../etc/passwd", "/%2e%2e/x", "/" + "a" * 8000, "/\0", "//"])
def test_there_is_one_page_and_nothing_else(gate, path):
    assert ask(gate, path).status_code == http.HTTPStatus.NOT_FOUND


def test_two_pages_on_one_machine_are_open_at_once():
    with Link(port=8230) as first, Link(port=8230) as second:
        sockets = []
        for link in (first, second, first):
            page, _, token = link.address.partition("/#token=")
            address = f"{page.replace('http', 'ws')}/?token={token}"
            with connect(address, origin=page, subprotocols=["viser-v1"]) as page_socket:
                sockets.append(page_socket.response.status_code)
        assert sockets == [101, 101, 101]
        page, token = first.address.partition("/#")[0], second.address.partition("token=")[2]
        with pytest.raises(InvalidStatus):
            connect(f"{page.replace('http', 'ws')}/?token={token}", origin=page)


def test_invalid_requests_print_no_error(capfd):
    with Link(port=8230) as link:
        port = int(link.address.partition("/#")[0].rpartition(":")[2])
        with socket.create_connection(("127.0.0.1", port)) as connection:
            connection.sendall(b"\x16\x03\x01 nothing that is HTTP\r\n\r\n")
            connection.recv(100)
    assert "Traceback" not in capfd.readouterr().err


def test_tokens_are_long_and_differ():
    tokens = {TokenAuth().token for _ in range(20)}
    assert len(tokens) == 20
    assert min(map(len, tokens)) >= 32


@pytest.mark.parametrize(
    ("host", "local"),
    [("127.0.0.1", True), ("::1", True), ("localhost", True), ("0.0.0.0", False), ("robot", False)],
)
def test_loopback_is_distinguished_from_the_network(host, local):
    assert is_loopback(host) is local

"""`Link` to the process of the page: start, token, loop without blocking, end of the process."""

from __future__ import annotations

import os
import signal
import socket
import time
import urllib.error
import urllib.request
from multiprocessing.connection import Connection

import numpy as np
import pytest

from pliant import PliantError
from pliant.view import messages
from pliant.view.ipc import Link, PageEndpoint, PageGone
from pliant.view.messages import Scene
from pliant.view.session import Session
from pliant.view.source import Simulated


@pytest.fixture
def link():
    with Link(port=8210) as new_link:
        yield new_link


def get(address):
    try:
        with urllib.request.urlopen(address, timeout=20) as answer:
            return answer.status, answer.headers, answer.read()
    except urllib.error.HTTPError as error:
        return error.code, error.headers, error.read()


def test_page_comes_without_the_token_and_keeps_it_to_itself(link):
    _, _, token = link.address.partition("/#token=")
    status, headers, body = get(link.address)
    assert status == 200
    assert len(token) >= 32
    assert "Set-Cookie" not in headers
    assert token.encode() not in body
    assert b"<html" in body.lower()


def test_page_asks_nothing_of_the_network(link):
    _, _, body = get(link.address)
    for mark in (b'src="http', b'href="http', b"cdn.", b"fonts.googleapis"):
        assert mark not in body


def test_snapshots_wait_until_the_last_one_was_taken(link):
    source = Simulated("arm7", paced=False)
    session = Session(source, Quick(link))
    session.run(1)
    # At most 30 snapshots per second of real time are sent, also by a fast simulation.
    assert 1 <= session._link.sent <= 1 + 32 * session._link.took


class Quick:
    """Wrapper of a link that ends the session after some ticks and counts the snapshots."""

    def __init__(self, link):
        self.link, self.calls, self.sent = link, 0, 0
        self.begun = time.perf_counter()

    @property
    def took(self):
        return max(time.perf_counter() - self.begun, 1.0)

    def messages(self):
        self.calls += 1
        self.link.messages()
        return [Scene("free")] if self.calls == 400 else []

    def due(self):
        return self.link.due()

    def send(self, message):
        self.sent += 1
        self.link.send(message)


def test_next_snapshot_is_wanted_without_a_look_at_the_orders(link):
    # During the descent the loop sends snapshots, but handles no messages.
    for _ in range(3):
        deadline = time.perf_counter() + 20.0
        while not link.due():
            assert time.perf_counter() < deadline
            time.sleep(0.005)
        link.send(np.zeros(10))


def flooded_link():
    """Return a link and its page endpoint, which has far more messages than a tick handles."""
    local, remote = socket.socketpair()
    endpoint = PageEndpoint(remote.detach())
    for number in range(20_000):
        endpoint.queue(messages.Change(number, f"axis {number}", {"hold": 1.0}))
        endpoint.queue(messages.Push((1.0, 0.0, 0.0)))
    endpoint.queue(messages.Stop())
    link = Link.__new__(Link)
    link._pipe, link._pending = Connection(local.detach()), messages.Queue()
    link._acknowledged, link._due, link._edit_due, link._period = True, 0.0, 0.0, 0.0
    return link, endpoint


def test_flood_reaches_the_loop_in_small_parts_and_the_stop_at_once():
    link, _ = flooded_link()
    received, calls = [], 0
    deadline = time.perf_counter() + 20.0
    while messages.Stop() not in received:
        assert time.perf_counter() < deadline
        took = link.messages()
        assert len(took) <= messages.PER_TICK
        received += took
        calls += bool(took)
        time.sleep(0.001)
    assert calls <= 4
    assert len(link._pending) <= messages.MAX_QUEUED


def test_edits_are_not_taken_faster_than_they_cost(monkeypatch):
    monkeypatch.setattr("pliant.view.ipc.EDIT_PERIOD", 1e9)
    link, _ = flooded_link()
    deadline, received = time.perf_counter() + 20.0, []
    while messages.Stop() not in received:
        assert time.perf_counter() < deadline
        received += link.messages()
    for _ in range(100):
        received += link.messages()
    assert sum(isinstance(message, messages.Edit) for message in received) == 1


def test_page_that_floods_still_takes_snapshots():
    link, endpoint = flooded_link()
    deadline = time.perf_counter() + 20.0
    for number in range(3):
        while not link.due():
            assert time.perf_counter() < deadline
            time.sleep(0.005)
        link.send(np.full(3, number))
        np.testing.assert_array_equal(endpoint.receive(), np.full(3, number))


def test_death_of_the_page_is_noticed(link):
    os.kill(link._process.pid, signal.SIGKILL)
    link._process.wait(20.0)
    with pytest.raises(PageGone, match="has ended"):
        link.messages()
    assert not link.due()
    with pytest.raises(PageGone):
        link.send(np.zeros(3))


def test_an_address_of_another_machine_is_explained():
    with pytest.raises(PliantError, match=r"cannot listen on 203\.0\.113\.1:8210"):
        Link("203.0.113.1", 8210)


def test_large_word_does_not_stop_a_loop_whose_page_hangs(link):
    os.kill(link._process.pid, signal.SIGSTOP)
    try:
        first = link.due()
        link.send(np.zeros(10))
        assert first
        assert not link.due()
        link.messages()
    finally:
        os.kill(link._process.pid, signal.SIGCONT)

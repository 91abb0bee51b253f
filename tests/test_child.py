"""Child processes that share a socket with the program: `pliant._processes`."""

import os
import signal
import socket
from pathlib import Path

import pytest

from pliant._processes import start_module

POSIX = os.name == "posix"


@pytest.fixture
def ends(monkeypatch):
    """Return both ends of a socket; change to this folder, where the children are."""
    monkeypatch.chdir(Path(__file__).parent)
    local, remote = socket.socketpair()
    local.settimeout(60.0)
    with local, remote:
        yield local, remote


@pytest.mark.slow
def test_a_child_has_the_socket_that_it_was_given_and_no_other(ends):
    local, remote = ends
    process = start_module("socket_child", remote, str(local.fileno()))
    assert local.recv(1) + local.recv(1) == b"00"
    local.sendall(b".")
    assert process.wait(60) == 0


@pytest.mark.slow
def test_a_child_notices_that_the_program_closed_its_end(ends):
    local, remote = ends
    process = start_module("socket_child", remote, str(local.fileno()))
    remote.close()
    assert local.recv(1) + local.recv(1) == b"00"
    local.close()
    assert process.wait(60) == 7


@pytest.mark.slow
def test_a_child_that_cannot_start_does_not_raise(ends):
    assert start_module("no_such_module", ends[1]).wait(60) == 1


@pytest.mark.slow
def test_a_child_does_not_inherit_a_real_time_priority(ends, real_time_priority):
    local, remote = ends
    with real_time_priority:
        process = start_module("socket_child", remote, str(local.fileno()))
        assert os.sched_getscheduler(process.pid) == os.SCHED_OTHER
    local.sendall(b".")
    assert process.wait(60) == 0


@pytest.mark.slow
@pytest.mark.skipif(not POSIX, reason="Ctrl-C goes to the foreground group of a POSIX terminal")
def test_ctrl_c_reaches_the_program_and_not_its_child(ends):
    local, remote = ends
    process = start_module("socket_parent", remote)
    remote.close()
    assert local.recv(1) + local.recv(1) == b"00"
    os.killpg(process.pid, signal.SIGINT)
    local.sendall(b".")
    assert process.wait(60) == 0, "the program waits for its child, which ends by the answer"

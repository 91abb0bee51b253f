"""Child processes that share a socket with the program: `pliant._child`."""

import os
import signal
import socket

import pytest

from pliant._child import start_module

POSIX = os.name == "posix"
#: Module that sends whether another process would inherit its socket, and whether it has the other
#: end too, waits for an answer, and ends with exit code 0 for ".", 7 for the end of the socket.
CHILD = """
import os, socket, sys
from pliant._child import take_socket

number, other = map(int, sys.argv[1:])
handle = take_socket(number)
inherits = os.get_inheritable if os.name == "posix" else os.get_handle_inheritable
pipe = socket.socket(fileno=handle)
pipe.sendall(b"1" if inherits(handle) else b"0")
try:
    socket.socket(fileno=other).detach()
    pipe.sendall(b"1")
except OSError:
    pipe.sendall(b"0")
sys.exit({b".": 0, b"": 7}[pipe.recv(1)])
"""
#: Module that starts `CHILD` and waits for Ctrl-C.
PARENT = """
import socket, sys, time
from pliant._child import start_module, take_socket

with socket.socket(fileno=take_socket(int(sys.argv[1]))) as pipe:
    process = start_module("child", pipe, "9999")
try:
    time.sleep(60)
except KeyboardInterrupt:
    sys.exit(process.wait())
"""


@pytest.fixture
def ends(tmp_path, monkeypatch):
    """Return both ends of a socket; modules `child` and `parent` can be started."""
    (tmp_path / "child.py").write_text(CHILD)
    (tmp_path / "parent.py").write_text(PARENT)
    monkeypatch.chdir(tmp_path)
    ours, theirs = socket.socketpair()
    ours.settimeout(60.0)
    with ours, theirs:
        yield ours, theirs


@pytest.mark.slow
def test_a_child_has_the_socket_that_it_was_given_and_no_other(ends):
    ours, theirs = ends
    process = start_module("child", theirs, str(ours.fileno()))
    assert ours.recv(1) + ours.recv(1) == b"00"
    ours.sendall(b".")
    assert process.wait(60) == 0


@pytest.mark.slow
def test_a_child_notices_that_the_program_closed_its_end(ends):
    ours, theirs = ends
    process = start_module("child", theirs, str(ours.fileno()))
    theirs.close()
    assert ours.recv(1) + ours.recv(1) == b"00"
    ours.close()
    assert process.wait(60) == 7


@pytest.mark.slow
def test_a_child_that_cannot_start_is_no_error_of_the_start(ends):
    assert start_module("no_such_module", ends[1]).wait(60) == 1


@pytest.mark.slow
@pytest.mark.skipif(not POSIX, reason="Ctrl-C goes to the foreground group of a POSIX terminal")
def test_ctrl_c_reaches_the_program_and_not_its_child(ends):
    ours, theirs = ends
    process = start_module("parent", theirs)
    theirs.close()
    assert ours.recv(1) + ours.recv(1) == b"00"
    os.killpg(process.pid, signal.SIGINT)
    ours.sendall(b".")
    assert process.wait(60) == 0, "the program waits for its child, which ends by the answer"

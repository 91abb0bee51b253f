"""Child processes that share sockets with the program: `pliant._child`."""

import os
import signal
import socket
import subprocess
import sys
from types import SimpleNamespace

import pytest

from pliant import _child
from pliant._child import child_options, keep_private

POSIX = os.name == "posix"
#: Opens the inherited socket whose number is its first argument, tells whether the second one was
#: inherited too and whether the first would be again, and waits for an answer.
CHILD = """
import os, socket, sys
from pliant._child import keep_private

number, other = map(int, sys.argv[1:])
pipe = socket.socket(fileno=number)
try:
    socket.socket(fileno=other).detach()
    pipe.sendall(b"1")
except OSError:
    pipe.sendall(b"0")
keep_private(number)
inherits = os.get_inheritable if os.name == "posix" else os.get_handle_inheritable
pipe.sendall(b"1" if inherits(number) else b"0")
sys.exit(0 if pipe.recv(1) == b"." else 1)
"""
#: Starts `CHILD` with its own arguments and waits for Ctrl-C.
PARENT = f"""
import subprocess, sys, time
from pliant._child import child_options

child = [sys.executable, "-c", {CHILD!r}, *sys.argv[1:]]
process = subprocess.Popen(child, **child_options(int(sys.argv[1])))
try:
    time.sleep(60)
except KeyboardInterrupt:
    sys.exit(process.wait())
"""


@pytest.fixture
def pair():
    ours, theirs = socket.socketpair()
    ours.settimeout(60.0)
    with ours, theirs:
        yield ours, theirs


def start(code, pair, **options):
    """Start Python with the numbers of the two sockets, of which it inherits the second."""
    numbers = [str(one.fileno()) for one in reversed(pair)]
    shared = child_options(pair[1].fileno())
    return subprocess.Popen([sys.executable, "-c", code, *numbers], **shared | options)


@pytest.mark.slow
def test_a_child_has_the_socket_that_it_was_given_and_no_other(pair):
    ours, _ = pair
    process = start(CHILD, pair)
    assert ours.recv(1) + ours.recv(1) == b"00"
    ours.sendall(b".")
    assert process.wait(60) == 0


@pytest.mark.slow
def test_a_child_notices_that_the_program_closed_its_end(pair):
    ours, theirs = pair
    process = start(CHILD, pair)
    theirs.close()
    ours.recv(2)
    ours.close()
    assert process.wait(60) == 1


@pytest.mark.slow
@pytest.mark.skipif(not POSIX, reason="Ctrl-C goes to the foreground group of a POSIX terminal")
def test_ctrl_c_reaches_the_program_and_not_its_child(pair):
    ours, _ = pair
    process = start(PARENT, pair)
    assert ours.recv(1) + ours.recv(1) == b"00"
    os.killpg(process.pid, signal.SIGINT)
    ours.sendall(b".")
    assert process.wait(60) == 0, "the program waits for its child, which ends by the answer"


def test_the_options_of_windows_name_the_handles(monkeypatch):
    changed = {}
    monkeypatch.setattr(_child, "sys", SimpleNamespace(platform="win32"))
    for module, name, value in (
        (os, "set_handle_inheritable", changed.__setitem__),
        (subprocess, "STARTUPINFO", lambda **fields: fields),
        (subprocess, "CREATE_NEW_PROCESS_GROUP", 0x200),
    ):
        monkeypatch.setattr(module, name, value, raising=False)
    options = child_options(7, 9)
    assert options["startupinfo"] == {"lpAttributeList": {"handle_list": [7, 9]}}
    assert options["creationflags"] == 0x200
    assert changed == {7: True, 9: True}
    keep_private(9)
    assert changed == {7: True, 9: False}

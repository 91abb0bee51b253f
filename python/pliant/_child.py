"""Start of child processes that share a socket with the program, on POSIX and on Windows."""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
from typing import Any

from pliant._priority import end_real_time_priority


def child_options() -> dict[str, Any]:
    """Return arguments of `subprocess.Popen` for a process that Ctrl-C does not reach."""
    if sys.platform == "win32":
        return {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
    return {"start_new_session": True}


def start_module(module: str, shared: socket.socket, *arguments: str) -> subprocess.Popen[bytes]:
    """Start ``python -m MODULE NUMBER ARGUMENTS``; `take_socket` opens the socket by its number.

    Ctrl-C does not reach the process; its standard output is discarded.
    """
    number = shared.fileno()
    command = [sys.executable, "-m", module, str(number), *arguments]
    options = child_options() | {"stdout": subprocess.DEVNULL}
    if sys.platform != "win32":
        child = subprocess.Popen(command, stdin=subprocess.DEVNULL, pass_fds=(number,), **options)
        end_real_time_priority(child.pid)
        return child
    # Windows does not promise that a process can use an inherited socket.
    process = subprocess.Popen(command, stdin=subprocess.PIPE, **options)
    with contextlib.suppress(OSError), process.stdin:
        process.stdin.write(shared.share(process.pid))
    return process


def take_socket(number: int) -> int:
    """Return, in a process of `start_module`, the handle of the socket, private to this process."""
    if sys.platform == "win32":
        return socket.fromshare(sys.stdin.buffer.read()).detach()
    os.set_inheritable(number, False)
    return number

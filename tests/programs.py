"""Programs in separate processes that start faster, because they do not import the package again.

A server process imports the package, and forks for each program. The fork behaves like
`python -c CODE`, `python FILE` or `python -m MODULE`: it has its own `sys.argv`, working folder,
environment, standard streams and signal handlers, and ends with traceback and exit code. It cannot
draw with OpenGL, whose threads do not survive a fork.
"""

from __future__ import annotations

import atexit
import gc
import importlib
import os
import pickle
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import suppress
from functools import cache
from pathlib import Path
from subprocess import DEVNULL, PIPE
from typing import Any

#: Modules that the server imports before it forks, because most programs need them.
MODULES = (
    *("numpy", "mujoco", "rustypot", "pydantic", "rich.console", "tyro", "pliant", "pliant.arm"),
    *("pliant.cli", "pliant.config.factory", "pliant.emulator", "pliant.servo", "pliant.sim"),
)
#: Largest request [byte], and period at which the server checks for the end of a program [s].
REQUEST_SIZE, POLL_PERIOD = 1 << 18, 0.005


def serve(number: int) -> Any:
    """Fork a program for each request on a socket; return, in the fork, the code to run."""
    for name in MODULES:
        with suppress(ImportError):  # if an extra is not installed
            importlib.import_module(name)
    gc.freeze()  # otherwise a collection in a fork would copy the memory of the modules
    with socket.socket(fileno=number) as line:
        while True:
            data, files, _, _ = socket.recv_fds(line, REQUEST_SIZE, 3)
            if not data:
                os._exit(0)
            request = pickle.loads(data)
            if isinstance(request, int):
                pid, status = os.waitpid(request, os.WNOHANG)
                line.send(pickle.dumps(os.waitstatus_to_exitcode(status) if pid else None))
                continue
            pid = os.fork()
            if pid == 0:
                break
            for file in files:
                os.close(file)
            line.send(pickle.dumps(pid))
    for stream, file in enumerate(files):
        os.dup2(file, stream)
        os.close(file)
    if request["session"]:
        os.setsid()
    os.chdir(request["folder"])
    os.environ.clear()
    os.environ.update(request["environment"])
    return _code(request["words"])


def _code(arguments: list[str]) -> Any:
    """Return the code of `-c CODE`, `-m MODULE` or `FILE`, with its arguments in `sys.argv`."""
    if arguments[0] == "-m":
        sys.argv[:] = arguments[1:]
        text = (
            "import runpy, sys; runpy.run_module(sys.argv[0], run_name='__main__', alter_sys=True)"
        )
        return compile(text, "<string>", "exec")
    if arguments[0] == "-c":
        sys.argv[:] = ["-c", *arguments[2:]]
        return compile(arguments[1], "<string>", "exec")
    sys.argv[:] = arguments
    sys.path[0] = str(Path(arguments[0]).parent)
    sys.modules["__main__"].__file__ = arguments[0]
    return compile(Path(arguments[0]).read_text(encoding="utf-8"), arguments[0], "exec")


@cache
def _server() -> tuple[socket.socket, threading.Lock]:
    local, remote = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    start = f"import sys; sys.path.append({str(Path(__file__).parent)!r}); import programs"
    start += f"; sys.path.pop(); exec(programs.serve({remote.fileno()}))"
    server = subprocess.Popen(
        [sys.executable, "-c", start],
        env={**os.environ, "MUJOCO_GL": "disable"},
        stdin=DEVNULL,
        pass_fds=[remote.fileno()],
        start_new_session=True,
    )
    remote.close()

    @atexit.register
    def end() -> None:
        local.close()
        server.wait()

    return local, threading.Lock()


def _ask(request: Any, files: tuple[int, ...] = ()) -> Any:
    line, lock = _server()
    with lock:
        socket.send_fds(line, [pickle.dumps(request)], files)
        return pickle.loads(line.recv(REQUEST_SIZE))


class Program:
    """A running program, used like `subprocess.Popen` with text streams.

    Args:
        *words: Command-line words after `python`.
        stdin, stdout, stderr: A file, `PIPE` or `DEVNULL`.
        cwd: Working folder.
        env: Whole environment; None: that of this process.
        start_new_session: True: start a new session, so that the program's group has no other
            process.
    """

    def __init__(
        self,
        *arguments: str,
        stdin: Any = DEVNULL,
        stdout: Any = PIPE,
        stderr: Any = PIPE,
        cwd: Any = None,
        env: Any = None,
        start_new_session: bool = False,
    ) -> None:
        request = {
            "words": list(arguments),
            "folder": str(cwd or Path.cwd()),
            "environment": dict(os.environ if env is None else env),
            "session": start_new_session,
        }
        remote_ends, local_ends, streams = [], [], (stdin, stdout, stderr)
        for number, stream in enumerate(streams):
            local_end = None
            if stream == PIPE:
                ends = os.pipe()
                local_end, remote_end = ends if number else ends[::-1]
                local_end = os.fdopen(local_end, "r" if number else "w", encoding="utf-8")
            elif stream == DEVNULL:
                remote_end = os.open(os.devnull, os.O_RDWR)
            else:
                remote_end = os.dup(stream if isinstance(stream, int) else stream.fileno())
            local_ends.append(local_end)
            remote_ends.append(remote_end)
        self.stdin, self.stdout, self.stderr = local_ends
        self.returncode: int | None = None
        self.pid: int = _ask(request, tuple(remote_ends))
        for file in remote_ends:
            os.close(file)

    def __enter__(self) -> Program:
        return self

    def __exit__(self, *_: object) -> None:
        self._close()
        self.wait()

    def poll(self) -> int | None:
        """Return the exit code, negative for a signal, or None while it runs."""
        if self.returncode is None:
            self.returncode = _ask(self.pid)
        return self.returncode

    def wait(self, timeout: float = 100.0) -> int:
        """Return the exit code; raise `TimeoutExpired` after `timeout` seconds."""
        deadline = time.monotonic() + timeout
        while self.poll() is None:
            if time.monotonic() > deadline:
                raise subprocess.TimeoutExpired(f"process {self.pid}", timeout)
            time.sleep(POLL_PERIOD)
        assert self.returncode is not None
        return self.returncode

    def communicate(self, timeout: float = 100.0) -> tuple[str, str]:
        """Wait for the end of the program; return the text of stdout and stderr, if piped."""
        deadline, output = time.monotonic() + timeout, {self.stdout: "", self.stderr: ""}
        if self.stdin is not None:
            self.stdin.close()

        def read(stream: Any) -> None:
            output[stream] = stream.read()

        readers = [threading.Thread(target=read, args=[s], daemon=True) for s in output if s]
        for reader in readers:
            reader.start()
        for reader in readers:
            reader.join(max(deadline - time.monotonic(), 0.0))
            if reader.is_alive():
                raise subprocess.TimeoutExpired(f"process {self.pid}", timeout)
        self.wait(max(deadline - time.monotonic(), POLL_PERIOD))
        self._close()
        return output[self.stdout], output[self.stderr]

    def send_signal(self, number: int) -> None:
        """Send a signal to the program, unless it has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """Kill the program."""
        self.send_signal(signal.SIGKILL)

    def _close(self) -> None:
        for stream in filter(None, (self.stdin, self.stdout, self.stderr)):
            stream.close()


def run(
    *arguments: str, timeout: float = 100.0, **options: Any
) -> subprocess.CompletedProcess[str]:
    """Run a program to its end, like `subprocess.run` with captured text."""
    program = Program(*arguments, **options)
    try:
        stdout, stderr = program.communicate(timeout)
    except BaseException:
        program.kill()
        program.wait()
        raise
    return subprocess.CompletedProcess(list(arguments), program.returncode, stdout, stderr)

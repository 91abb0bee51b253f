"""Emulator in a child process, so that emulator and host program do not share an interpreter."""

from __future__ import annotations

import multiprocessing
import shutil
import signal
import sys
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from pliant._core import PliantError, ServoError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from multiprocessing.connection import Connection

    from pliant.emulator.emulator import Emulator

#: Timeout for the child process to import its modules and open its ports [s].
START_TIME = 60.0
#: Timeout for the child process to exit before it is killed [s].
STOP_TIME = 5.0


class EmulatorProcess:
    """Emulator in a child process, which also exits when the parent process ends.

    Args:
        factory: Function or class that returns the emulator; the child process imports it by name.
        *args: Positional arguments of the factory.
        **kwargs: Keyword arguments of the factory.

    Raises:
        PliantError, ImportError: Raised by the factory.
        ServoError: The process did not start.

    Example:
        >>> with EmulatorProcess(Emulator, [Device("STS3215", id=1)]) as bus:
        ...     bus.call("faults.inject", "lose", id=1)
        ...     host = rustypot.Sts3215PyController(bus.port, 1_000_000, 0.1)
    """

    def __init__(self, factory: Callable[..., Emulator], *args: Any, **kwargs: Any) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, child = context.Pipe()
        self._process = context.Process(
            target=_serve, args=(child, factory, args, kwargs), daemon=True, name="pliant-emulator"
        )
        with _without_main(factory):
            self._process.start()
        child.close()
        self.ports: dict[str, str] = {}
        if not self._pipe.poll(START_TIME):
            self.stop()
            raise ServoError(f"the emulator did not start within {START_TIME:g} s")
        self.ports = self._answer()

    @property
    def port(self) -> str:
        """Path of the emulator's first serial port."""
        return next(iter(self.ports.values()))

    def call(self, name: str, *args: Any, **kwargs: Any) -> Any:
        """Call a method of the emulator in the child process and return its result.

        If `name` is an attribute, return its value.

        Args:
            name: Dotted name, relative to the emulator: `advance`, `faults.inject`, `time`.
            *args: Positional arguments of the method.
            **kwargs: Keyword arguments of the method.

        Raises:
            PliantError: Raised by the method.
            ServoError: The process has ended.
        """
        try:
            self._pipe.send((name, args, kwargs))
        except OSError as error:
            raise ServoError(f"the emulator's process is gone: {error}") from error
        return self._answer()

    def kill(self) -> None:
        """Kill the child process, to simulate a crash: its ports hang up."""
        self._process.kill()
        self._process.join()
        for path in self.ports.values():
            shutil.rmtree(Path(path).parent, ignore_errors=True)

    def stop(self) -> None:
        """Close the ports and end the child process; kill it if it has not ended in `STOP_TIME`."""
        self._pipe.close()
        self._process.join(STOP_TIME)
        if self._process.is_alive():
            self.kill()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _answer(self) -> Any:
        try:
            ok, value = self._pipe.recv()
        except (EOFError, OSError) as error:
            raise ServoError(f"the emulator's process is gone: {error!r}") from error
        if not ok:
            raise value
        return value


@contextmanager
def _without_main(factory: Callable[..., Emulator]) -> Iterator[None]:
    """Return a context in which a new child process does not import the host's main script.

    If the main script defines `factory`, the child process imports it nevertheless.
    """
    main = sys.modules["__main__"]
    hidden = {} if factory.__module__ == "__main__" else {"__spec__": None, "__file__": None}
    saved = {name: getattr(main, name) for name in hidden if hasattr(main, name)}
    for name in saved:
        setattr(main, name, None)
    try:
        yield
    finally:
        for name, value in saved.items():
            setattr(main, name, value)


def _serve(
    pipe: Connection, factory: Callable[..., Emulator], args: Any, kwargs: dict[str, Any]
) -> None:
    """Run the emulator in the child process, and execute the calls that `pipe` delivers."""
    # Ignore these signals: a terminal sends them to all its processes, but the host needs the
    # emulated servos to lower the arm.
    for name in ("SIGINT", "SIGHUP", "SIGQUIT"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    try:
        emulator = factory(*args, **kwargs).start()
    except Exception as error:
        pipe.send((False, _portable(error)))
        return
    try:
        pipe.send((True, emulator.ports))
        while True:
            name, args, kwargs = pipe.recv()
            try:
                target: Any = emulator
                for part in name.split("."):
                    target = getattr(target, part)
                pipe.send((True, target(*args, **kwargs) if callable(target) else target))
            except Exception as error:
                pipe.send((False, _portable(error)))
    except (EOFError, OSError):
        pass  # the parent has ended
    finally:
        emulator.stop()


def _portable(error: Exception) -> Exception:
    """Return `error`, or an equivalent error if it cannot be pickled for the parent process."""
    is_portable = isinstance(error, PliantError | ImportError)
    return error if is_portable else ServoError(f"{error!r}")

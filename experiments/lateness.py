"""Cost of a page and a log to the loop: lateness with each off and on, in one run.

``python -m experiments.lateness [--seconds 10] [--rounds 3]`` controls an SO-101 over emulated
bytes at 100 Hz, in turns: bare, with the page (its process, thirty snapshots a second, and a client
that reads all that the page sends), with the log, with both. It prints the table.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast
from urllib.parse import urlsplit

from experiments import program
from pliant import config
from pliant.loop import LatenessHistogram
from pliant.view.ipc import Link
from pliant.view.messages import Stop
from pliant.view.session import Session
from pliant.view.source import Configured

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pliant.view.messages import Message

#: Control rate [Hz].
RATE = 100.0
#: Timeout long enough that a busy machine does not end a run [s].
PATIENCE = 30.0


@dataclass
class Way:
    """One combination of page and log.

    Attributes:
        page, log: True if it is on.
        late: Lateness of all its ticks.
        missed: Ticks skipped.
        sent: Snapshots that the page took.
        seconds: Duration [s].
    """

    page: bool
    log: bool
    late: LatenessHistogram = field(default_factory=LatenessHistogram)
    missed: int = 0
    sent: int = 0
    seconds: float = 0.0

    @property
    def name(self) -> str:
        """Its description."""
        return {
            (False, False): "bare",
            (True, False): "page",
            (False, True): "log",
            (True, True): "page and log",
        }[self.page, self.log]


class Timed:
    """Link that counts snapshots and requests a stop after `ticks`; its page is optional."""

    def __init__(self, link: Link | None, ticks: int) -> None:
        """Start the time."""
        self._link, self._left, self.sent = link, ticks, 0

    def messages(self) -> list[Message]:
        """Return messages of the page, and the stop."""
        self._left -= 1
        heard = [] if self._link is None else self._link.messages()
        return [*heard, Stop()] if self._left == 0 else heard

    def due(self) -> bool:
        """Return True if a snapshot is due; never without a page."""
        return self._link is not None and self._link.due()

    def send(self, word: Any) -> None:
        """Send to the page."""
        if self._link is not None:
            self.sent += 1
            self._link.send(word)


def run(way: Way, link: Link | None, seconds: float, folder: Path) -> None:
    """Control the arm in one combination, and count."""
    source = Configured(
        config.load("so101", backend="emulator"),
        on_exit="leave_enabled",
        handle_signals=False,
        comm_timeout=PATIENCE,
    )
    timed = Timed(link if way.page else None, round(seconds * RATE))
    session = Session(source, cast("Link", timed), folder / "run.mcap" if way.log else None)
    session.run(1)
    assert session.loop is not None
    way.late.counts += session.loop.lateness.counts
    way.late.largest = max(way.late.largest, session.loop.lateness.largest)
    way.missed += session.loop.missed
    way.sent += timed.sent
    way.seconds += (len(session.loop.lateness) + session.loop.missed) / RATE


@contextlib.contextmanager
def reading(link: Link) -> Iterator[None]:
    """Return a process that reads all that the page sends, as a browser does, without drawing."""
    command = [sys.executable, "-m", "experiments.lateness", "--client", link.address]
    with subprocess.Popen(command) as process:
        try:
            yield
        finally:
            process.terminate()


def take_all(address: str) -> None:
    """Run the client."""
    import viser
    from websockets.sync.client import connect

    # A real client runs on another machine, so it must not take the loop's processor here.
    os.nice(19)
    parts = urlsplit(address)
    with connect(
        f"ws://{parts.netloc}/?{parts.fragment}",
        origin=cast("Any", f"http://{parts.netloc}"),
        subprotocols=[cast("Any", f"viser-v{viser.__version__}")],
        max_size=None,
    ) as socket:
        for _ in socket:
            pass


def main(*, seconds: float = 10.0, rounds: int = 3, client: str = "") -> None:
    """Print the table.

    Args:
        seconds: Duration of a run.
        rounds: Runs of each combination.
        client: Address of a page; the program is then its client.
    """
    if client:
        take_all(client)
        return
    ways = [Way(page=page, log=log) for page, log in product((False, True), repeat=2)]
    with tempfile.TemporaryDirectory() as name:
        for _ in range(rounds):
            for way in ways:
                if not way.page:
                    run(way, None, seconds, Path(name))
                    continue
                with Link() as link, reading(link):
                    run(way, link, seconds, Path(name))
    columns = ("SO-101, 100 Hz", "ticks", "late 50 % [ms]", "99 %", "99.9 %", "missed")
    rows = []
    for way in ways:
        late = [f"{1e3 * way.late.percentile(share):.2f}" for share in (50.0, 99.0, 99.9)]
        rate = f"{way.sent / way.seconds:.0f}"
        rows.append((way.name, len(way.late), *late, way.missed, rate))
    print(program.markdown((*columns, "snapshots/s"), rows))
    print(f"load of the machine: {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")


if __name__ == "__main__":
    program.start(main)

"""Effect of the web page of `pliant.view` and of a log file on the lateness of the control loop.

``python -m experiments.lateness [--seconds 10] [--rounds 3]`` controls an SO-101 with emulated
servos at 100 Hz: without page and log, with the page (its process, and a client that reads all its
messages), with the log, and with both, in turn. It prints a table of the delays with which the
ticks of the loop begin.
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

from experiments import command_line, markdown
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
#: `comm_timeout` of the arm [s], so long that a busy computer does not end a run.
PATIENCE = 30.0


@dataclass
class Combination:
    """Combination of web page and log, with the lateness measured over all runs with it.

    Attributes:
        page: True if the web page shows the arm.
        log: True if a log is written.
        late: Histogram of the lateness of all ticks.
        missed: Number of deadlines that the loop missed.
        sent: Number of snapshots sent to the page.
        seconds: Total duration of the runs [s].
    """

    page: bool
    log: bool
    late: LatenessHistogram = field(default_factory=LatenessHistogram)
    missed: int = 0
    sent: int = 0
    seconds: float = 0.0

    @property
    def name(self) -> str:
        """Name of the combination in the table."""
        return {
            (False, False): "bare",
            (True, False): "page",
            (False, True): "log",
            (True, True): "page and log",
        }[self.page, self.log]


class TimedLink:
    """Link between a session and an optional web page, for a run of limited duration.

    It counts the snapshots, and sends the session a stop request after `ticks` ticks.
    """

    def __init__(self, link: Link | None, ticks: int) -> None:
        """Store the link of the page (None: no page) and the number of ticks of the run."""
        self._link, self._left, self.sent = link, ticks, 0

    def messages(self) -> list[Message]:
        """Return the page's messages since the last tick; after the last tick, also a stop request.

        The session calls this once per tick.
        """
        self._left -= 1
        heard = [] if self._link is None else self._link.messages()
        return [*heard, Stop()] if self._left == 0 else heard

    def due(self) -> bool:
        """Return True if a snapshot is due; always False without a page."""
        return self._link is not None and self._link.due()

    def send(self, message: Any) -> None:
        """Send a message to the page, if there is one, and count it."""
        if self._link is not None:
            self.sent += 1
            self._link.send(message)


def run(combination: Combination, link: Link | None, seconds: float, folder: Path) -> None:
    """Control the arm for `seconds` with a combination, and add the lateness to its record.

    Args:
        combination: Combination of page and log.
        link: Link of the page; None without a page.
        seconds: Duration of the run [s].
        folder: Folder of the log.
    """
    source = Configured(
        config.load("so101", backend="emulator"),
        on_exit="leave_enabled",
        handle_signals=False,
        comm_timeout=PATIENCE,
    )
    timed_link = TimedLink(link if combination.page else None, round(seconds * RATE))
    session = Session(
        source, cast("Link", timed_link), folder / "run.mcap" if combination.log else None
    )
    session.run(1)
    assert session.loop is not None
    combination.late.add_all(session.loop.lateness)
    combination.missed += session.loop.missed
    combination.sent += timed_link.sent
    combination.seconds += (len(session.loop.lateness) + session.loop.missed) / RATE


@contextlib.contextmanager
def client_reading(link: Link) -> Iterator[None]:
    """Return a context in which a client process reads all messages of the page of a link."""
    command = [sys.executable, "-m", "experiments.lateness", "--client", link.address]
    with subprocess.Popen(command) as process:
        try:
            yield
        finally:
            process.terminate()


def take_all(address: str) -> None:
    """Read all messages of the page at this address, until the page closes the connection."""
    import viser
    from websockets.sync.client import connect

    # Run the client at the lowest priority. A real one runs on another machine and does not slow
    # the control loop down.
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
    """Print the lateness of all combinations.

    Args:
        seconds: Duration of a run, in seconds.
        rounds: Number of runs of each combination.
        client: Address of a page; the program then only runs the client.
    """
    if client:
        take_all(client)
        return
    combinations = [
        Combination(page=page, log=log) for page, log in product((False, True), repeat=2)
    ]
    with tempfile.TemporaryDirectory() as name:
        for _ in range(rounds):
            for combination in combinations:
                if not combination.page:
                    run(combination, None, seconds, Path(name))
                    continue
                with Link() as link, client_reading(link):
                    run(combination, link, seconds, Path(name))
    columns = ("SO-101, 100 Hz", "ticks", "late 50 % [ms]", "99 %", "99.9 %", "missed")
    rows = []
    for combination in combinations:
        latenesses = [
            f"{1e3 * combination.late.percentile(share):.2f}" for share in (50.0, 99.0, 99.9)
        ]
        rate = f"{combination.sent / combination.seconds:.0f}"
        rows.append(
            (combination.name, len(combination.late), *latenesses, combination.missed, rate)
        )
    print(markdown.table((*columns, "snapshots/s"), rows))
    print(f"load of the machine: {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")


if __name__ == "__main__":
    command_line.start(main)

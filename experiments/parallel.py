"""Jobs of an experiment in one process or several, with a progress line."""

from __future__ import annotations

import sys
from time import monotonic
from typing import TYPE_CHECKING, Protocol, TypeVar

from pliant._extras import missing

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

R_co = TypeVar("R_co", covariant=True)


class Job(Protocol[R_co]):
    """An independent, picklable job."""

    def run(self) -> R_co:
        """Run the job."""


def parallel(work: Sequence[Job[R_co]], processes: int, what: str) -> Iterator[R_co]:
    """Run jobs, in parallel if joblib is installed.

    Args:
        work: The jobs.
        processes: Number of processes.
        what: Name of the experiment, for the progress line on standard error.

    Yields:
        The results in the order of the jobs, as they complete.
    """
    done: Iterable[R_co] = (job.run() for job in work)
    if processes > 1:
        try:
            from joblib import Parallel, delayed
            from joblib.parallel import get_active_backend
        except ImportError:
            print(f"{what}: one process only; {missing('more', 'experiments')}")
        else:
            backend, _ = get_active_backend()
            # Ray's backend returns a list only.
            streams = getattr(backend, "supports_return_generator", False)
            started = Parallel(n_jobs=processes, return_as="generator" if streams else "list")
            done = started(delayed(_run)(job) for job in work)
    # A terminal gets one line that changes, a file one line every half minute.
    live = sys.stderr.isatty()
    begin = last = monotonic()
    for count, result in enumerate(done, 1):
        yield result
        now, over = monotonic(), count == len(work)
        if over or now - last > (1.0 if live else 30.0):
            left, last = (now - begin) * (len(work) - count) / count, now
            said = f"{what}: {count} of {len(work)}, {left:.0f} s left "
            print(
                f"\r{said}" if live else said, end="\n" if over or not live else "", file=sys.stderr
            )


def _run(job: Job[R_co]) -> R_co:
    return job.run()

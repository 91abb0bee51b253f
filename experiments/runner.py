"""Independent jobs in one process or several, by joblib: results in order, and a progress line."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping
from ctypes.util import find_library
from dataclasses import dataclass, field
from time import monotonic
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from pliant._extras import missing

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

R_co = TypeVar("R_co", covariant=True)


class Runnable(Protocol[R_co]):
    """An independent, picklable job."""

    def run(self) -> R_co:
        """Run the job."""


@dataclass(frozen=True)
class Job:
    """One independent call: a run of the simulation, a drawing.

    Attributes:
        key: Its name among the outcomes.
        call: A function of a module, so that another process can import it.
        args, kwargs: Its arguments; they must be picklable.
    """

    key: str
    call: Callable[..., Any]
    args: tuple[Any, ...] = ()
    kwargs: Mapping[str, Any] = field(default_factory=dict)

    def run(self) -> Any:
        """Run the call in this process."""
        return self.call(*self.args, **self.kwargs)


def run_jobs(
    work: Sequence[Runnable[R_co]], processes: int, what: str | None = None
) -> Iterator[R_co]:
    """Run jobs, in parallel if joblib is installed.

    joblib's processes are spawned, not forked: MuJoCo's and EGL's threads do not survive a fork.

    Args:
        work: The jobs.
        processes: Number of processes.
        what: Name of the experiment, for the progress line on standard error; None: no line.

    Yields:
        The results in the order of the jobs, as they complete.
    """
    done: Iterable[R_co] = (job.run() for job in work)
    if processes > 1:
        try:
            from joblib import Parallel, delayed
            from joblib.parallel import get_active_backend
        except ImportError:
            print(f"{what or 'jobs'}: one process only; {missing('more', 'experiments')}")
        else:
            # One thread each: the processes already share the cores.
            os.environ.setdefault("OMP_NUM_THREADS", "1")
            backend, _ = get_active_backend()
            # The joblib backend of Ray cannot return a generator.
            streams = getattr(backend, "supports_return_generator", False)
            started = Parallel(n_jobs=processes, return_as="generator" if streams else "list")
            done = started(delayed(_run)(job) for job in work)
    # On a terminal one line is updated in place; into a file a line is printed every half minute.
    live = sys.stderr.isatty()
    begin = last = monotonic()
    for count, result in enumerate(done, 1):
        yield result
        now, over = monotonic(), count == len(work)
        if what is not None and (over or now - last > (1.0 if live else 30.0)):
            left, last = (now - begin) * (len(work) - count) / count, now
            said = f"{what}: {count} of {len(work)}, {left:.0f} s left "
            print(
                f"\r{said}" if live else said, end="\n" if over or not live else "", file=sys.stderr
            )


def _run(job: Runnable[R_co]) -> R_co:
    return job.run()


def run_by_key(
    jobs: Sequence[Job],
    processes: int,
    what: str | None = None,
    progress: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Run jobs and return their outcomes by key, in the order of the jobs.

    Args:
        jobs: With unique keys.
        processes: Number of processes.
        what: As for `run_jobs`.
        progress: Called with the key of each completed job, in order.

    Raises:
        ValueError: Two jobs have one key.
        Exception: The first error of a job.
    """
    keys = [job.key for job in jobs]
    if len(set(keys)) != len(keys):
        twice = sorted({key for key in keys if keys.count(key) > 1})
        raise ValueError(f"jobs need keys of their own, these appear twice: {', '.join(twice)}")
    outcomes = {}
    for key, outcome in zip(keys, run_jobs(jobs, processes, what), strict=True):
        outcomes[key] = outcome
        if progress is not None:
            progress(key)
    return outcomes


def draw_off_screen() -> None:
    """Let MuJoCo draw without a display, here and in later processes; call before it is loaded.

    Without EGL MuJoCo would not load with it selected: then nothing is drawn, and the report states
    it in place of the pictures.
    """
    if sys.platform == "linux" and not os.environ.get("DISPLAY"):
        os.environ.setdefault("MUJOCO_GL", "egl" if find_library("EGL") else "disable")

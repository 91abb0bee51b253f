"""Execution of independent jobs in one or several processes, with a progress line."""

from __future__ import annotations

import os
import pickle
import sys
from collections.abc import Callable, Mapping
from ctypes.util import find_library
from dataclasses import dataclass, field
from time import monotonic
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from pliant._extras import missing

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path

R_co = TypeVar("R_co", covariant=True)


class Runnable(Protocol[R_co]):
    """Interface of a job that is independent of others and can be sent to another process."""

    def run(self) -> R_co:
        """Run the job and return its result."""


@dataclass(frozen=True)
class Job:
    """Job that calls a function.

    Attributes:
        key: Name of the job's result.
        call: Function at module level, so that another process can import it.
        args, kwargs: Picklable arguments of the function.
    """

    key: str
    call: Callable[..., Any]
    args: tuple[Any, ...] = ()
    kwargs: Mapping[str, Any] = field(default_factory=dict)

    def run(self) -> Any:
        """Call the function in this process and return its result."""
        return self.call(*self.args, **self.kwargs)


def run_jobs(
    work: Sequence[Runnable[R_co]],
    processes: int,
    what: str | None = None,
    resume: Path | None = None,
) -> Iterator[R_co]:
    """Run jobs, in parallel if joblib is installed, by its active backend (loky, Dask, Ray).

    The processes are spawned, because threads of MuJoCo and EGL do not survive a fork.

    Args:
        work: The jobs.
        processes: Number of processes.
        what: Name of the experiment for the progress line on standard error; None: no line.
        resume: Folder with the results of jobs that were run before, one file per hash of a job;
            new results are added. Delete it after a change of the code. None: run all jobs.

    Yields:
        The results in the order of the jobs.
    """
    results = _resumed(work, processes, resume) if resume is not None else _start(work, processes)
    # In a terminal, update one progress line every second; in a file, add a line every half minute.
    live = sys.stderr.isatty()
    begin = last = monotonic()
    for count, result in enumerate(results, 1):
        yield result
        time_now, is_over = monotonic(), count == len(work)
        if what is not None and (is_over or time_now - last > (1.0 if live else 30.0)):
            remaining, last = (time_now - begin) * (len(work) - count) / count, time_now
            line = f"{what}: {count} of {len(work)}, {remaining:.0f} s left "
            print(
                f"\r{line}" if live else line,
                end="\n" if is_over or not live else "",
                file=sys.stderr,
            )


def _start(work: Sequence[Runnable[R_co]], processes: int) -> Iterable[R_co]:
    """Return the results of jobs in their order, as they arrive if the backend can do that."""
    if processes == 1 or not work:
        return (job.run() for job in work)
    try:
        from joblib import Parallel, delayed
        from joblib.parallel import get_active_backend
    except ImportError:
        print(f"jobs: one process only; {missing('more', 'experiments')}")
        return (job.run() for job in work)
    # One thread per process, because the processes already use all cores.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    backend, _ = get_active_backend()
    # Ray's backend cannot return a generator.
    streams = getattr(backend, "supports_return_generator", False)
    started = Parallel(n_jobs=processes, return_as="generator" if streams else "list")
    results: Iterable[R_co] = started(delayed(_run)(job) for job in work)
    return results


def _resumed(work: Sequence[Runnable[R_co]], processes: int, folder: Path) -> Iterator[R_co]:
    """Return saved results, and run and save the jobs that have none."""
    from joblib import hash as hash_of

    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / f"{hash_of((type(job).__qualname__, job))}.pkl" for job in work]
    is_saved = [file.is_file() for file in files]
    absent = [job for job, saved in zip(work, is_saved, strict=True) if not saved]
    run = iter(_start(absent, processes))
    for file, saved in zip(files, is_saved, strict=True):
        if saved:
            yield pickle.loads(file.read_bytes())
            continue
        result = next(run)
        # Write under another name and rename, so that the file is never incomplete.
        part = file.with_suffix(".part")
        part.write_bytes(pickle.dumps(result))
        part.replace(file)
        yield result


def _run(job: Runnable[R_co]) -> R_co:
    return job.run()


def run_by_key(
    jobs: Sequence[Job],
    processes: int,
    what: str | None = None,
    progress: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Run jobs and return their results by key, in the order of the jobs.

    Args:
        jobs: Jobs with unique keys.
        processes: Number of processes.
        what: Name for the progress line, see `run_jobs`.
        progress: Callback with the key of each completed job, in order.

    Raises:
        ValueError: Two jobs have the same key.
        Exception: The error of the first job that failed.
    """
    keys = [job.key for job in jobs]
    if len(set(keys)) != len(keys):
        repeated = sorted({key for key in keys if keys.count(key) > 1})
        raise ValueError(f"jobs need keys of their own, these appear twice: {', '.join(repeated)}")
    outcomes = {}
    for key, outcome in zip(keys, run_jobs(jobs, processes, what), strict=True):
        outcomes[key] = outcome
        if progress is not None:
            progress(key)
    return outcomes


def draw_off_screen() -> None:
    """Select EGL for rendering without a display, in this process and its children.

    Call this function before MuJoCo is loaded. EGL is selected only if it is available, because
    MuJoCo would otherwise fail to load; without EGL the report has no rendered pictures.
    """
    if sys.platform == "linux" and not os.environ.get("DISPLAY"):
        os.environ.setdefault("MUJOCO_GL", "egl" if find_library("EGL") else "disable")

"""Independent runs over a few processes, in a fixed order."""

from __future__ import annotations

import multiprocessing
import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from ctypes.util import find_library
from dataclasses import dataclass, field
from typing import Any

#: Called with the name of a completed job.
Progress = Callable[[str], None]


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


class Workers:
    """A few processes that live across batches; with one job at a time everything runs here.

    Processes are spawned, not forked: MuJoCo's and EGL's threads do not survive a fork.

    Args:
        count: Processes; 1: only this one.
    """

    def __init__(self, count: int) -> None:
        self.count = max(1, count)
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> Workers:
        """Start the processes if there is more than one."""
        if self.count > 1:
            # One thread each: the processes already share the cores.
            os.environ.setdefault("OMP_NUM_THREADS", "1")
            context = multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(self.count, mp_context=context)
        return self

    def __exit__(self, *_: object) -> None:
        """End the processes; jobs that have not begun are dropped."""
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)

    def run(self, jobs: Sequence[Job], progress: Progress = lambda key: None) -> dict[str, Any]:
        """Run jobs and return their outcomes by key, in the order of the jobs.

        Args:
            jobs: With unique keys.
            progress: Called as they end, in any order.

        Raises:
            ValueError: Two jobs have one key.
            Exception: The first error of a job.
        """
        keys = [job.key for job in jobs]
        if len(set(keys)) != len(keys):
            twice = sorted({key for key in keys if keys.count(key) > 1})
            raise ValueError(f"jobs need keys of their own, these appear twice: {', '.join(twice)}")
        if self._pool is None:
            outcomes = {}
            for job in jobs:
                outcomes[job.key] = job.run()
                progress(job.key)
            return outcomes
        futures: dict[Future[Any], str] = {self._pool.submit(job.run): job.key for job in jobs}
        _wait(futures, progress)
        done = {key: future.result() for future, key in futures.items()}
        return {key: done[key] for key in keys}


def draw_off_screen() -> None:
    """Let MuJoCo draw without a display, here and in later processes; call before it is loaded.

    Without EGL MuJoCo would not load with it selected: then nothing is drawn, and the report states
    it in place of the pictures.
    """
    if sys.platform == "linux" and not os.environ.get("DISPLAY"):
        os.environ.setdefault("MUJOCO_GL", "egl" if find_library("EGL") else "disable")


def _wait(futures: Mapping[Future[Any], str], progress: Progress) -> None:
    """Wait for all, or for the first that fails, and cancel the rest then."""
    try:
        for future in as_completed(futures):
            future.result()
            progress(futures[future])
    except BaseException:
        for future in futures:
            future.cancel()
        raise


def prefixed(prefix: str, jobs: Iterable[Job]) -> list[Job]:
    """Return the same jobs with a prefix before their keys."""
    return [Job(f"{prefix}{job.key}", job.call, job.args, job.kwargs) for job in jobs]

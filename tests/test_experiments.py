"""Common code of the experiments: jobs in other processes, and the search for robot files."""

import importlib
import re
import runpy
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

pytest.importorskip("joblib", reason="experiments share their work by joblib (extra experiments)")
pytest.importorskip("mujoco", reason="experiments need the extra experiments")

from joblib import parallel_config, register_parallel_backend
from joblib._parallel_backends import ThreadingBackend

import experiments
from experiments import arms, runner
from experiments.runner import run_jobs

FOLDER = Path(experiments.__file__).parent
#: By module: options with which it lists few jobs, so that it takes less than a second.
SHORT_OPTIONS = {"descent": ["--arm", "so101", "--poses", "1"]}


class Started(Exception):
    pass


@pytest.mark.filterwarnings("ignore:.*found in sys.modules")
@pytest.mark.parametrize(
    "name",
    [
        path.stem
        for path in sorted(FOLDER.glob("*.py"))
        if re.search(r"run_(jobs|by_key)\(.*command_line\.start", path.read_text(), re.DOTALL)
    ],
)
def test_another_process_finds_the_jobs_by_their_module(name, monkeypatch):
    def refuse(work, *_, **__):
        assert work
        for job in work:
            of = job.call if isinstance(job, runner.Job) else type(job)
            assert of.__module__ == f"experiments.{name}"
        raise Started

    module = importlib.import_module(f"experiments.{name}")
    monkeypatch.setattr(runner, "run_jobs", refuse)
    for call in {"run_jobs", "run_by_key"} & vars(module).keys():
        monkeypatch.setattr(module, call, refuse)
    monkeypatch.setattr(sys, "argv", [name, *SHORT_OPTIONS.get(name, [])])
    with pytest.raises(Started):
        runpy.run_module(f"experiments.{name}", run_name="__main__")


@dataclass(frozen=True)
class Square:
    side: int

    def run(self):
        return self.side**2


class ListOnly(ThreadingBackend):
    """A joblib backend that, like Ray's, cannot return its results as a generator."""

    supports_return_generator = False


@pytest.mark.parametrize("backend", ["list-only", "threading"])
def test_results_come_in_order_from_every_backend(backend, capsys):
    register_parallel_backend("list-only", ListOnly)
    with parallel_config(backend=backend):
        results = list(run_jobs([Square(side) for side in range(5)], 2, "squares"))
    assert results == [0, 1, 4, 9, 16]
    assert "squares: 5 of 5" in capsys.readouterr().err


@dataclass(frozen=True)
class Noted:
    """Job that appends a line to a file when it runs."""

    side: int
    notes: Path

    def run(self):
        with self.notes.open("a", encoding="utf-8") as file:
            file.write(f"{self.side}\n")
        return self.side**2


@pytest.mark.parametrize("processes", [1, 2])
def test_a_run_that_was_cut_short_continues_where_it_ended(processes, tmp_path):
    notes, saved = tmp_path / "notes", tmp_path / "saved"
    work = [Noted(side, notes) for side in range(6)]
    cut = run_jobs(work[:3], processes, resume=saved)
    assert list(cut) == [0, 1, 4]
    (saved / "half.part").write_bytes(b"cut short")
    with parallel_config(backend="threading"):
        assert list(run_jobs(work, processes, resume=saved)) == [0, 1, 4, 9, 16, 25]
    assert sorted(notes.read_text().split()) == ["0", "1", "2", "3", "4", "5"]


def test_jobs_run_on_dask():
    import distributed

    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None}
    with (
        distributed.LocalCluster(**options) as cluster,
        distributed.Client(cluster),
        parallel_config(backend="dask"),
    ):
        assert list(run_jobs([Square(side) for side in range(8)], 2)) == [k * k for k in range(8)]


@pytest.mark.full
def test_jobs_run_on_ray():
    ray = pytest.importorskip("ray")
    from ray.util.joblib import register_ray

    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    try:
        register_ray()
        with parallel_config(backend="ray"):
            results = list(run_jobs([Square(side) for side in range(8)], 2))
    finally:
        ray.shutdown()
    assert results == [k * k for k in range(8)]


def test_robots_are_looked_for_beside_a_clone_only(tmp_path, monkeypatch):
    monkeypatch.delenv("PLIANT_ROBOTS", raising=False)
    for root in ("checkout", "venv/lib/python3.11/site-packages"):
        file = tmp_path / root / "experiments" / "arms.py"
        monkeypatch.setattr(arms, "__file__", str(file))
        sibling = file.resolve().parents[1].parent / "shared" / "robots"
        sibling.mkdir(parents=True)
        file.parent.mkdir(parents=True)
        if root.startswith("checkout"):
            (tmp_path / "checkout" / "pyproject.toml").touch()
            assert arms._robots() == sibling
        else:
            assert not arms._robots().is_absolute(), "nothing beside an environment"
        monkeypatch.setenv("PLIANT_ROBOTS", "/elsewhere")
        assert arms._robots() == Path("/elsewhere")
        monkeypatch.delenv("PLIANT_ROBOTS")

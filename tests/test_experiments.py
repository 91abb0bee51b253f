"""Shared code of the experiments: jobs for other processes, workers, and the search for robots."""

import importlib
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
from experiments import campaign_arms
from experiments import parallel as shared
from experiments.parallel import parallel

FOLDER = Path(experiments.__file__).parent
#: Options with which a module makes its jobs within a second.
FEW = {"descent": ["--arms", "so101", "--poses", "1"]}


class Started(Exception):
    pass


@pytest.mark.filterwarnings("ignore:.*found in sys.modules")
@pytest.mark.parametrize(
    "name",
    [
        path.stem
        for path in sorted(FOLDER.glob("*.py"))
        if "list(parallel(" in path.read_text() or "in parallel(" in path.read_text()
    ],
)
def test_another_process_finds_the_jobs_by_their_module(name, monkeypatch):
    def refuse(work, *_):
        assert work
        assert {type(job).__module__ for job in work} == {f"experiments.{name}"}
        raise Started

    module = importlib.import_module(f"experiments.{name}")
    monkeypatch.setattr(shared, "parallel", refuse)
    monkeypatch.setattr(module, "parallel", refuse)
    monkeypatch.setattr(sys, "argv", [name, *FEW.get(name, [])])
    with pytest.raises(Started):
        runpy.run_module(f"experiments.{name}", run_name="__main__")


@dataclass(frozen=True)
class Square:
    side: int

    def run(self):
        return self.side**2


class ListOnly(ThreadingBackend):
    """A backend that returns a list only, as Ray's does."""

    supports_return_generator = False


@pytest.mark.parametrize("backend", ["list-only", "threading"])
def test_results_come_in_order_from_every_backend(backend, capsys):
    register_parallel_backend("list-only", ListOnly)
    with parallel_config(backend=backend):
        found = list(parallel([Square(side) for side in range(5)], 2, "squares"))
    assert found == [0, 1, 4, 9, 16]
    assert "squares: 5 of 5" in capsys.readouterr().err


def test_robots_are_looked_for_beside_a_clone_only(tmp_path, monkeypatch):
    monkeypatch.delenv("PLIANT_ROBOTS", raising=False)
    for root in ("checkout", "venv/lib/python3.11/site-packages"):
        file = tmp_path / root / "experiments" / "campaign_arms.py"
        monkeypatch.setattr(campaign_arms, "__file__", str(file))
        beside = file.resolve().parents[1].parent / "shared" / "robots"
        beside.mkdir(parents=True)
        file.parent.mkdir(parents=True)
        if root.startswith("checkout"):
            (tmp_path / "checkout" / "pyproject.toml").touch()
            assert campaign_arms._robots() == beside
        else:
            assert not campaign_arms._robots().is_absolute(), "nothing beside an environment"
        monkeypatch.setenv("PLIANT_ROBOTS", "/elsewhere")
        assert campaign_arms._robots() == Path("/elsewhere")
        monkeypatch.delenv("PLIANT_ROBOTS")

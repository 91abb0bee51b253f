"""Experiments that are started with `python -m` and share their jobs out to other processes."""

import importlib
import runpy
import sys
from pathlib import Path

import pytest

pytest.importorskip("mujoco", reason="experiments run on the simulator: extra sim")

import pliant.experiments
from pliant.experiments import parallel as shared

FOLDER = Path(pliant.experiments.__file__).parent
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
        assert {type(job).__module__ for job in work} == {f"pliant.experiments.{name}"}
        raise Started

    module = importlib.import_module(f"pliant.experiments.{name}")
    monkeypatch.setattr(shared, "parallel", refuse)
    monkeypatch.setattr(module, "parallel", refuse)
    monkeypatch.setattr(sys, "argv", [name, *FEW.get(name, [])])
    with pytest.raises(Started):
        runpy.run_module(f"pliant.experiments.{name}", run_name="__main__")

"""Benchmarks: all compared libraries compute the same results; counts detect regressions."""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
BENCHES = ROOT / "benches"


@pytest.fixture
def load(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(str(BENCHES))
    monkeypatch.setenv("PEERS_BUILD", str(tmp_path))
    return importlib.import_module


@pytest.fixture
def counts():
    spec = importlib.util.spec_from_file_location("counts", BENCHES / "counts.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    "maker", ["numpy_peer:make", "pliant_peer:make", "cpp_peer:make", "library_peers:pinocchio"]
)
def test_peers_do_the_same_work(maker, load):
    module, function = maker.split(":")
    if "cpp" in module and not shutil.which("c++"):
        pytest.skip("no C++ compiler")
    problem, timing, worker = (load(f"comparison.{n}") for n in ("problem", "timing", "worker"))
    peer = getattr(load(f"comparison.{module}"), function)()
    kinematics = load("comparison.numpy_peer").kinematics_of(problem.bench_arm())
    pairs = [(q, kinematics(a)[0]) for q, a in problem.states(problem.bench_arm())]
    results = worker.results(peer, pairs)
    assert set(results) == set(timing.TASKS)
    assert timing.disagreement(results) == ""
    results["step"][5][1][3] += 1e-8
    assert timing.disagreement(results).startswith("step by 1e-08")
    blocks = worker.blocks_of(peer, pairs)
    assert len(blocks["step/whole"]()) == 1
    assert min(blocks["step/single"]()) > 0.0


def test_the_law_of_the_peers_uses_all_its_parts(load):
    problem, numpy_peer = load("comparison.problem"), load("comparison.numpy_peer")
    arm = problem.bench_arm()
    kinematics, law = numpy_peer.kinematics_of(arm), numpy_peer.law_of(arm)
    for q, twist in problem.states(arm):
        pose, jacobian = kinematics(q)
        target = kinematics(twist)[0]
        goal, limit = law(q, target, pose, jacobian)
        at_rest = law(q, pose, pose, jacobian)[0]
        assert np.abs(goal - at_rest).max() > 1e-3, "the target moves the goal"
        assert np.abs(at_rest - q).max() > 1e-4, "and so does the null space"
        assert (limit > 0.0).all()
    assert np.ptp([kinematics(q)[0] for q, _ in problem.states(arm)], axis=0).max() > 0.05


def test_a_stage_that_grows_is_named(counts):
    stored = {"baseline": {"forward": 1000.0, "step": 200.0}}
    assert counts.regressions({"baseline": {"forward": 1049.0, "step": 150.0}}, stored) == []
    messages = counts.regressions({"baseline": {"forward": 1051.0, "step": 200.0}}, stored)
    assert len(messages) == 1
    assert "forward (baseline) takes 1051 instructions, 5.1% more than the 1000" in messages[0]
    assert counts.regressions({"avx2": {"forward": 9999.0}}, stored) == [], "nothing to compare"


@pytest.mark.parametrize("lacking", ["valgrind", "rustc"])
def test_counting_is_skipped_loudly(lacking, tmp_path):
    for tool in {"valgrind", "rustc"} - {lacking}:
        path = shutil.which(tool)
        if path is None:
            pytest.skip(f"{tool} is not installed")
        (tmp_path / tool).symlink_to(path)
    result = subprocess.run(
        [sys.executable, str(BENCHES / "counts.py")],
        env={**os.environ, "PATH": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    assert "!! SKIPPED: instruction counts" in result.stdout
    assert lacking in result.stdout or "no counts stored" in result.stdout


#: Arguments and constants with which a bench takes a few seconds at most, by program.
SHORT_RUNS: dict[str, tuple[list[str], dict[str, object]]] = {
    "batch": (["--count=100", "--only=kinematics,step_batch"], {"ROUNDS": 1}),
    "boundary": ([], {"ROUNDS": 1}),
    "gym_share": (["Door"], {"ARMS": 2, "STEPS": 1, "REPEATS": 1}),
    "lightness": ([], {"STARTS": 1}),
    "tail": (["--steps=2000", "--turns=1"], {}),
}
#: Programs that other tests run; of `ros`, the parts are run by `tests/ros`.
RUN_ELSEWHERE = {"counts", "latency", "peers", "ros", "tick"}


def test_every_bench_is_run():
    programs = {path.stem for path in BENCHES.glob("*.py")}
    assert programs == set(SHORT_RUNS) | RUN_ELSEWHERE


@pytest.mark.slow
@pytest.mark.parametrize("program", SHORT_RUNS)
def test_a_bench_runs(program, load, monkeypatch, capsys):
    arguments, constants = SHORT_RUNS[program]
    module = load(program)
    monkeypatch.setattr(sys, "argv", [program, *arguments])
    for name, value in constants.items():
        monkeypatch.setattr(module, name, value)
    module.main()
    assert re.search(r"\d", capsys.readouterr().out), "it printed no figure"

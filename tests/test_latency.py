"""`benches/latency.py` (`make bench`): percentiles of a step, choice of the arm, errors."""

import importlib.util
import re
import shlex
import sys
from pathlib import Path

import numpy as np
import pytest

import pliant

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def latency():
    spec = importlib.util.spec_from_file_location("latency", ROOT / "benches" / "latency.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # `dataclass` looks up the module of a class there
    spec.loader.exec_module(module)
    yield module
    del sys.modules[spec.name]


def test_bench_prints_the_time_of_a_step(latency, capsys):
    assert latency.main(["--robot", "koch", "--calls", "2000"]) == 0
    out = capsys.readouterr().out
    assert "koch_like: 5 joints, law cap" in out
    steps, empty = (
        [float(number) for number in re.findall(r"([\d.]+) µs", line)]
        for line in out.splitlines()
        if "µs" in line
    )
    assert len(steps) == len(empty) == 4
    assert steps == sorted(steps)
    assert steps[0] > 0.0
    bins = [int(n.replace(",", "")) for n in re.findall(r"(?:to [\d.]+|above 20) +([\d,]+)", out)]
    assert sum(bins) == 2000, "every call is in the histogram"
    rates = [float(n.replace(",", "")) for n in re.findall(r"([\d,]+) Hz", out)]
    assert len(rates) == 2
    assert rates[0] >= rates[1] > 0.0


@pytest.mark.parametrize("law", ["cap", "paper", "impedance"])
def test_bench_takes_any_urdf(latency, law, tmp_path, capsys):
    file = tmp_path / "arm.urdf"
    body = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    joint = '<joint name="j{0}" type="{1}"><parent link="l{0}"/><child link="l{2}"/>{3}</joint>'
    places = '<origin xyz="0.3 0 0"/><axis xyz="0 0 1"/>'
    limit = places + '<limit lower="-1" upper="2" effort="3" velocity="1"/>'
    links = [f'<link name="l{i}">{body}</inertial></link>' for i in range(4)]
    joints = [
        joint.format(0, "continuous", 1, places),
        joint.format(1, "revolute", 2, limit),
        joint.format(2, "fixed", 3, places),
    ]
    file.write_text(f'<robot name="two">{"".join(links + joints)}</robot>')
    axes = ["--soft", "y", "--axes", "xy"]
    assert latency.main(["--urdf", str(file), "--law", law, "--calls", "200", *axes]) == 0
    assert f"two: 2 joints, law {law}" in capsys.readouterr().out


def test_bench_runs_as_the_docs_say(latency, capsys):
    page = (ROOT / "docs" / "performance.md").read_text("utf-8")
    (flags,) = re.findall(
        r"^make bench ARGS='(--robot so101 --soft \"[^\"]+\")'", page, re.MULTILINE
    )
    assert latency.main([*shlex.split(flags), "--calls", "200"]) == 0
    assert "so101_like: 5 joints" in capsys.readouterr().out


def test_without_soft_an_axis_of_the_task_yields(latency, capsys):
    assert latency.main(["--robot", "koch", "--axes", "x z", "--calls", "200"]) == 0
    assert "5 joints" in capsys.readouterr().out


def test_bench_moves_through_the_ranges(latency):
    model = pliant.robots.arm7()
    path = np.array(latency.path(model))
    assert path.shape == (latency.STATES, model.n)
    assert (path > model.lower).all()
    assert (path < model.upper).all()
    assert len(np.unique(path, axis=0)) == latency.STATES, "no call repeats another"


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (["--calls", "3"], "at least 100"),
        (["--robot", "so999"], "so101"),
        (["--urdf", "nowhere.urdf"], "nowhere.urdf"),
        (["--law", "papper"], "paper"),
        (["--robot", "so101", "--soft", "y yaw"], "yaw is not an axis of the task, which has x, y"),
        (["--robot", "so101", "--soft", "y yaw"], "--axes"),
        (["--soft", "qq"], "--soft 'qq': 'qq' is not an axis"),
        (["--urdf", "a.urdf", "--robot", "so101"], "--urdf a.urdf and --robot so101 are two arms"),
        (["--tip", "tool"], "--tip tool belongs to --urdf"),
    ],
)
def test_what_bench_cannot_do_is_explained(latency, flags, said, capsys):
    assert latency.main([*flags]) == 2
    assert said in capsys.readouterr().err


def test_help_calls_files_and_arms_by_their_names(latency, capsys):
    assert latency.main(["--help"]) == 0
    out = capsys.readouterr().out
    assert not re.search(r"\{None\}\|(STR|PATH)", out)
    assert "--urdf FILE" in out
    assert "--robot ARM" in out

"""The demo's command line: errors are detected early and printed on one line."""

import re

import pytest

import pliant
from experiments.demo import main as demo
from pliant.cli import COMMANDS, main

WITHOUT = (
    "import sys; sys.modules['{name}'] = None; from experiments.demo import main; sys.exit(main())"
)
LIGHT = """
import sys
from pliant.cli import main
assert main(["--help"]) == 0 and main(["--version"]) == 0
assert not {"tyro", "rich", "mujoco", "matplotlib"} & set(sys.modules)
"""


def test_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"pliant {pliant.__version__}\n"


@pytest.mark.parametrize("arguments", [[], ["--help"], ["-h"]])
def test_help_lists_every_command(capsys, arguments):
    assert main(arguments) == 0
    out = capsys.readouterr().out
    assert all(f"  {name}" in out for name in COMMANDS)


def test_help_and_version_load_nothing_heavy(pliant_command):
    result = pliant_command(code=LIGHT)
    assert result.returncode == 0, result.stderr


def test_help_of_the_demo_explains_its_flags(demo_command):
    result = demo_command("--help")
    assert result.returncode == 0
    for flag in ("--out", "--only", "--quick", "--robot", "--urdf", "--base", "--tip", "--jobs"):
        assert flag in result.stdout
    assert "--urdf FILE" in result.stdout
    assert not re.search(r"\{None\}\|(STR|PATH)", result.stdout)


ONE_LINE = [
    (main, ["teech"], "did you mean `pliant teach`"),
    (main, ["--verson"], "no flag '--verson'"),
    (demo, ["--only", "x"], "such as 1,3; got 'x'"),
    (demo, ["--only", "1,9"], "no experiment 9; choose from 1"),
    (demo, ["--jobs", "0"], "--jobs must be from 1 to"),
    (demo, ["--tip", "tool"], "belong to --urdf"),
    (demo, ["--urdf", "nowhere.urdf"], "nowhere.urdf"),
    (demo, ["--robot", "koch", "--only", "5"], "no experiment 5"),
]


@pytest.mark.parametrize(
    ("command", "arguments", "message"), ONE_LINE, ids=lambda v: v if isinstance(v, str) else None
)
def test_errors_are_one_line(capsys, command, arguments, message):
    pytest.importorskip("mujoco")
    assert command(arguments) == 2
    captured = capsys.readouterr()
    assert captured.err.startswith("error: ")
    assert captured.err.count("\n") == 1
    assert message in captured.err


def test_an_unknown_flag_gets_a_suggestion(capsys):
    assert demo(["--qick"]) == 2
    assert "--quick" in capsys.readouterr().err


def test_a_refused_urdf_is_one_line(capsys, tmp_path):
    pytest.importorskip("mujoco")
    file = tmp_path / "bad.urdf"
    file.write_text("<robot name='r'><link name='a'/>", encoding="utf-8")
    assert demo(["--urdf", str(file)]) == 2
    stderr = capsys.readouterr().err
    assert stderr.startswith("error: ")
    assert "bad.urdf" in stderr
    assert "Traceback" not in stderr


@pytest.mark.parametrize("name", ["mujoco", "matplotlib"])
def test_a_missing_extra_names_the_pip_command(demo_command, name):
    result = demo_command(code=WITHOUT.format(name=name))
    assert result.returncode == 2
    assert result.stderr.startswith('error: the demo needs the extra "experiments": ')
    assert result.stderr.strip().endswith(" install 'pliant[experiments]'")


def test_a_folder_that_cannot_be_made_is_one_line(capsys, tmp_path):
    pytest.importorskip("mujoco")
    file = tmp_path / "file"
    file.write_text("", encoding="utf-8")
    assert demo(["--quick", "--only", "1", "--jobs", "1", "--out", str(file)]) == 2
    assert capsys.readouterr().err.splitlines()[-1].startswith("error: ")


def test_missed_bands_are_printed_with_number_and_reason():
    pytest.importorskip("mujoco")
    from experiments.demo import missed
    from experiments.report import Chapter, Check, Figure, Statement

    passed = Check(name="force", value=3.0, high=4.0, unit="N")
    tests = (passed, Check(name="drift", value=0.0123, low=0.001, high=0.01, unit="m"))
    statements = (
        Statement(claim="It holds.", outcome="", checks=(passed,), source="study"),
        Statement(claim="It stays.", outcome="", checks=tests, source="study", because="gears rub"),
        Statement(claim="The paper's.", outcome="", checks=tests),
    )
    figure = Figure(file="f", title="", done="", caption="", statements=statements)
    chapter = Chapter(number=2, title="Held", lead="", figures=(figure,), numbers={})
    (line,) = missed(chapter)
    assert line == "2 not kept: It stays. drift is 0.0123 m, band 0.001 to 0.01; gears rub"

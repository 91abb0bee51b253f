"""A complete run of the demo writes its results and a self-contained report."""

import json
import math
import re
from html import unescape
from html.parser import HTMLParser
from pathlib import Path

import pytest

pytest.importorskip("mujoco")
pytest.importorskip("matplotlib")

SHARED = Path(__file__).resolve().parents[3] / "shared" / "robots"
EMPTY_ELEMENTS = {"meta", "br", "img", "link", "hr", "input"}


class Page(HTMLParser):
    """Parser that collects references and ids of a page, and checks that elements are closed."""

    def __init__(self, text):
        super().__init__()
        self.references, self.ids, self.tags, self.open = [], [], set(), []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.handle_startendtag(tag, attrs)
        if tag not in EMPTY_ELEMENTS:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.add(tag)
        for name, value in attrs:
            if name in {"href", "src", "xlink:href", "srcset", "data", "action"}:
                self.references.append(value)
            if name == "id":
                self.ids.append(value)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def check_page(path):
    text = path.read_text(encoding="utf-8")
    page = Page(text)
    assert page.open == []
    assert "script" not in page.tags
    assert "link" not in page.tags
    outside = [r for r in page.references if not r.startswith(("#", "data:image/"))]
    assert outside == []
    targets = {r[1:] for r in page.references if r.startswith("#")}
    assert targets <= set(page.ids)
    assert len(page.ids) == len(set(page.ids))
    assert not re.search(r"https?://|@import|url\((?!['\"]?#)", text)
    assert "None" not in re.sub(r"<svg.*?</svg>", "", text, flags=re.DOTALL)
    assert "$" not in re.sub(r"<svg.*?</svg>", "", text, flags=re.DOTALL)
    return text


def check_numbers(value, path="results"):
    """Check that results have no NaN, and null only for "not back" and for missing bounds."""
    if isinstance(value, dict):
        for key, item in value.items():
            if item is None:
                assert key in {"returned", "low", "high", "commit"}, f"{path}.{key}"
            check_numbers(item, f"{path}.{key}")
    elif isinstance(value, list):
        for k, item in enumerate(value):
            check_numbers(item, f"{path}[{k}]")
    elif isinstance(value, float):
        assert math.isfinite(value), path


def check_folder(folder, process):
    assert process.returncode == 0, process.stderr
    report, results = folder / "report.html", folder / "results.json"
    assert process.stdout.rstrip().endswith(str(report.resolve()))
    text = check_page(report)
    content = json.loads(results.read_text(encoding="utf-8"))
    check_numbers(content)
    pictures = sorted(folder.glob("figures/*.png"))
    assert pictures
    for picture in pictures:
        assert picture.read_bytes().startswith(b"\x89PNG")
        assert f'id="{picture.stem}"' in text
    return content, text


def test_quick_demo_leaves_a_report_that_needs_nothing(quick_demo):
    content, text = check_folder(*quick_demo[:2])
    assert sorted(content["experiments"]) == ["1", "2", "3", "4", "5", "6"]
    for experiment in content["experiments"].values():
        for statement in experiment["statements"]:
            assert statement["verdict"] in {"agrees", "differs because", "does not agree"}
            assert statement["outcome"] in unescape(text).replace("−", "-")
    assert {"pliant", "numpy", "mujoco", "matplotlib", "Python"} <= set(content["versions"])
    for name, version in content["versions"].items():
        assert f"{name} {version}" in text


def test_processes_do_not_change_a_digit(demo_command, quick_demo, tmp_path):
    """Compare experiment 2 run in one process with the whole demo, which uses two processes."""
    demo_folder, _, saved = quick_demo
    result = demo_command("--quick", "--only", "2", "--jobs", "1", "--out", "1")
    assert result.returncode == 0, result.stderr
    results = json.loads((tmp_path / "1" / "results.json").read_text(encoding="utf-8"))
    second = {"2": saved["experiments"]["2"]}
    assert json.dumps(results) == json.dumps(saved | {"experiments": second})
    figures = list((tmp_path / "1" / "figures").glob("*.svg"))
    assert figures
    for figure in figures:
        assert figure.read_bytes() == (demo_folder / "figures" / figure.name).read_bytes()


def test_a_machine_that_cannot_draw_gets_a_report_without_pictures(demo_command, tmp_path):
    args = ("--quick", "--only", "1", "--jobs", "1", "--out", "here")
    result = demo_command(*args, MUJOCO_GL="disable")
    _, text = check_folder(tmp_path / "here", result)
    assert "data:image/" not in text


# By default one of the two arms is tested: both have five joints and run the same experiments.
@pytest.mark.parametrize("robot", ["so101", pytest.param("koch", marks=pytest.mark.full)])
def test_quick_demo_of_a_small_arm(demo_command, tmp_path, robot):
    result = demo_command("--quick", "--robot", robot, "--out", "here")
    content, _ = check_folder(tmp_path / "here", result)
    assert content["robot"] == robot
    assert content["experiments"]["2"]["numbers"]["soft_axis"] == "y"


#: Arms with five, six and seven joints that are always tested; the others are marked `full`.
ALWAYS = {"so101", "ur5e", "panda"}


def robots():
    """Return the reference arms whose URDF is available, with base and tip of their chains."""
    result = []
    for file in sorted(SHARED.glob("*/reference_fk.json")):
        entry = json.loads(file.read_text(encoding="utf-8"))
        robot = (file.parent / entry["urdf"], entry["base"], entry["tip"])
        marks = () if file.parent.name in ALWAYS else pytest.mark.full
        result.append(pytest.param(robot, id=file.parent.name, marks=marks))
    return result


@pytest.mark.skipif(not robots(), reason="../shared/robots is absent: no reference arms to try")
@pytest.mark.parametrize("robot", robots())
def test_quick_demo_of_a_urdf(demo_command, tmp_path, robot):
    urdf, base, tip = robot
    args = ["--urdf", str(urdf), "--base", base, "--tip", tip]
    args += ["--only", "2", "--jobs", "1", "--out", "here"]
    result = demo_command("--quick", *args)
    _, text = check_folder(tmp_path / "here", result)
    assert "guessed from the effort" in text

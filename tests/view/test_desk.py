"""`SettingsEditor`: every preset, law and switch of the page, for every kind of task."""

from __future__ import annotations

import pytest

import pliant
from pliant.view import messages
from pliant.view.settings_editor import FILE_PRESET, LAWS, SettingsEditor

TASKS = {
    "arm7": ("x y z roll pitch yaw", "xyz", "x y yaw"),
    "so101": ("xyz", "x z pitch", "x z", "y"),
    "koch": ("xyz", "z pitch"),
}
CASES = [(robot, task) for robot, tasks in TASKS.items() for task in tasks]


def own_files(task):
    """Return settings of configuration files by name: soft, firm, with two axes, without axes."""
    names = pliant.Task(axes=task).names
    return {
        "soft all": pliant.Settings.soft(" ".join(names), task=task),
        "firm": pliant.Settings.firm(task=task),
        "by hand": pliant.Settings(
            task=task,
            axes={
                names[-1]: pliant.Axis(hold=1.0),
                names[0]: pliant.Axis(yields="+", adaptation=0.5),
            },
        ),
        "nothing": pliant.Settings(task=task),
    }


def begin(robot, task, file_settings=None):
    model = pliant.robots.load(robot)
    editor = SettingsEditor(task, 100.0, file_settings)
    return editor, pliant.Controller(model, editor.effective)


@pytest.mark.parametrize(("robot", "task"), CASES)
def test_every_preset_law_and_switch_works(robot, task):
    editor, controller = begin(robot, task)
    for preset in editor.presets:
        for law in LAWS:
            editor.apply(messages.Preset(1, preset), controller)
            editor.apply(messages.Law(2, law), controller)
            soft = {n: a.yields for n, a in controller.axes.items()}
            editor.apply(messages.Firm(3, True), controller)
            assert controller.settings.law == law
            assert {a.yields for a in controller.axes.values()} == {"none"}
            editor.apply(messages.Firm(4, False), controller)
            assert {n: a.yields for n, a in controller.axes.items()} == soft


@pytest.mark.parametrize("kind", ["soft all", "firm", "by hand", "nothing"])
@pytest.mark.parametrize(("robot", "task"), CASES)
def test_own_settings_take_every_law_and_every_edit(robot, task, kind):
    editor, controller = begin(robot, task, own_files(task)[kind])
    has_no_profile = kind in {"firm", "nothing"}
    assert editor.preset == (editor.presets[1] if has_no_profile else FILE_PRESET)
    for law in LAWS:
        editor.apply(messages.Law(1, law), controller)
        for name in pliant.Task(axes=task).names:
            for yields in ("both", "+", "-", "none"):
                editor.apply(
                    messages.Change(2, name, {"yields": yields, "adaptation": 0.5}), controller
                )
                assert controller.axes[name].yields == yields
        editor.apply(messages.Adaptation(3, 0.7), controller)
        editor.apply(messages.Firm(4, True), controller)
        editor.apply(messages.Firm(5, False), controller)
    editor.apply(messages.Preset(6, FILE_PRESET), controller)


def test_file_that_names_no_soft_axis_begins_like_the_simulated_arm():
    file_settings = pliant.Settings(
        task="xyz",
        max_tool_speed=0.1,
        paper_options=pliant.functional.PaperOptions(posture_weights=[1.0, 2.0, 1.0, 1.0, 1.0]),
    )
    with_file, _ = begin("so101", "xyz", file_settings)
    without_file, _ = begin("so101", "xyz")
    assert (with_file.preset, with_file.settings.axes) == (
        without_file.preset,
        without_file.settings.axes,
    )
    assert with_file.settings.max_tool_speed[0] == 0.1
    assert list(with_file.settings.paper_options.posture_weights) == list(
        file_settings.paper_options.posture_weights
    )


def test_no_preset_goes_faster_than_the_file():
    file_settings = pliant.Settings(task="xyz", max_tool_speed=(0.1, 0.2))
    editor, controller = begin("so101", "xyz", file_settings)
    for preset in editor.presets:
        editor.apply(messages.Preset(1, preset), controller)
        assert controller.settings.max_tool_speed <= (0.1, 0.2)

"""What a recorder is given, and when."""

import pytest

pytest.importorskip("mcap", reason="logs need the extra log")

import pliant
from pliant.log import Recorder, read


@pytest.fixture
def arm():
    with pliant.connect("sim:so101", on_exit="leave_enabled") as live:
        yield live


@pytest.mark.parametrize(
    ("change", "kind", "said"),
    [
        ({"path": 3}, TypeError, r"path must be that of a file, got 3 \(int\)"),
        ({"arm": "so101"}, TypeError, "arm must be an Arm, as pliant.connect makes one, got"),
        ({"controller": 5}, TypeError, "controller must be a Controller, or None without one"),
        ({"config": "so101"}, TypeError, "config must be what pliant.config.load gives"),
        ({"note": 5}, TypeError, "note must be a str"),
        ({"rate": "fast"}, pliant.ConfigError, r"rate must be a number"),
        ({"rate": float("nan")}, pliant.OutOfRangeError, r"rate \[Hz\] must be in"),
        ({"rate": 0.0}, pliant.OutOfRangeError, r"rate \[Hz\] must be above 0"),
    ],
)
def test_arguments_of_another_kind_are_named(change, kind, said, arm, tmp_path):
    given = {"path": tmp_path / "x.mcap", "arm": arm, **change}
    with pytest.raises(kind, match=said):
        Recorder(given.pop("path"), given.pop("arm"), **given)
    assert not list(tmp_path.iterdir())


def test_a_tick_after_the_end_is_refused(arm, tmp_path):
    path = tmp_path / "x.mcap"
    recorder = Recorder(path, arm)
    for tick in pliant.Loop(arm, duration=0.05):
        recorder.add(tick)
    with pytest.raises(TypeError, match=r"tick must be a Tick, as pliant\.Loop yields them"):
        recorder.add(5)
    recorder.close()
    recorder.close()
    with pytest.raises(pliant.ConfigError, match=r"x\.mcap is closed: add ticks within"):
        recorder.add(tick)
    assert len(read(path)) == recorder.ticks == 5

"""Flags of `pliant log` that contradict each other, rejected before the log is read."""

import pytest

from pliant.cli import main


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["export", "--output", "x.csv"], "writes .npz (--parquet writes .parquet), got .csv"),
        (["export", "--output", "x"], "got no suffix"),
        (["export", "--parquet", "--output", "x.npz"], "writes .parquet, got .npz"),
        (["plot", "--output", "x.bmp"], "pliant log plot writes .png, .svg, .pdf, got .bmp"),
        (["plot", "--output", "nowhere/x.png"], "there is no folder"),
        (["plot", "--parquet"], "Unrecognized options: --parquet"),
        (["export", "--verify"], "Unrecognized options: --verify"),
        (["info", "--output", "x.png"], "Unrecognized options: --output"),
    ],
)
def test_flags_that_do_not_go_together(arguments, message, tmp_path, capsys, monkeypatch):
    pytest.importorskip("mcap", reason="logs need the extra log")
    monkeypatch.chdir(tmp_path)
    verb, *flags = arguments
    assert main(["log", verb, "run.mcap", *flags]) == 2
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())

"""Standard streams that are closed, or that cannot encode every character."""

import os
import subprocess
import sys

import pytest

pytest.importorskip("mujoco", reason="runs need the extra sim")

PLIANT = (sys.executable, "-m", "pliant.cli")


@pytest.mark.parametrize("descriptors", [">&-", "<&- >&- 2>&-"])
def test_a_command_runs_with_closed_streams(descriptors):
    shell = ("/bin/sh", "-c", f'exec "$@" {descriptors}', "sh")
    result = subprocess.run(
        [*shell, *PLIANT, "arms", "koch"], capture_output=True, timeout=100, check=False
    )
    assert (result.returncode, result.stdout, result.stderr) == (0, b"", b"")


def test_characters_that_the_locale_does_not_have_are_replaced(monkeypatch):
    monkeypatch.setenv("LC_ALL", "C")
    monkeypatch.setenv("PYTHONUTF8", "0")
    monkeypatch.setenv("PYTHONCOERCECLOCALE", "0")
    monkeypatch.setenv("PYTHONIOENCODING", "ascii")
    result = subprocess.run(
        [*PLIANT, "run", "so101", "--backend", "sim", "--duration", "0.1", "--quiet"],
        capture_output=True,
        timeout=100,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    assert b" ?s (50, 99, 99.9 %)" in result.stdout


@pytest.mark.parametrize("command", [["arms"], ["servos", "doctor", "so101", "--backend", "sim"]])
def test_a_reader_that_has_gone_is_not_a_declined_prompt(command):
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "wb") as stream:
        result = subprocess.run(
            [*PLIANT, *command], stdout=stream, stderr=subprocess.PIPE, timeout=100, check=False
        )
    assert (result.returncode, result.stderr) == (141, b"")

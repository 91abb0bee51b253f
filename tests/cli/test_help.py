"""Help texts of the command line."""

import re
import subprocess
import sys

import pytest

from pliant.cli import COMMANDS, main


@pytest.mark.parametrize("name", COMMANDS)
def test_help_calls_files_arms_and_devices_by_their_names(name, capsys):
    assert main([*name.split(), "--help"]) == 0
    out = capsys.readouterr().out
    assert not re.search(r"\{None\}\|(STR|PATH)", out)
    assert ("--urdf FILE" in out) == ("--urdf" in out)
    assert "ARM" in out or name in {"servos scan", "arms"} or name.startswith("log ")


def test_help_starts_without_what_commands_need():
    code = (
        "import sys, pliant.cli; pliant.cli.main(['--help']); "
        "print([m for m in ('tyro', 'pydantic', 'rich', 'mujoco') if m in sys.modules])"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    assert result.stdout.splitlines()[-1] == "[]"

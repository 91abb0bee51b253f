"""LeRobot's own test of its programs, with our robot in place of LeRobot's mock."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

CHECKOUT = os.environ.get("LEROBOT_CHECKOUT")


@pytest.mark.skipif(CHECKOUT is None, reason="LEROBOT_CHECKOUT names no clone of LeRobot 0.6.1")
def test_lerobots_own_test_passes_with_our_robot(tmp_path):
    paths = [str(Path(__file__).parent), str(CHECKOUT), os.environ.get("PYTHONPATH", "")]
    environment = {
        "PYTHONPATH": os.pathsep.join(filter(None, paths)),
        "HF_LEROBOT_HOME": str(tmp_path / "home"),
        "HF_HUB_OFFLINE": "1",
    }
    test = ("-p", "upstream_mocks", "-q", "tests/test_control_robot.py")
    run = subprocess.run(
        [sys.executable, "-m", "pytest", *test],
        cwd=CHECKOUT,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        timeout=900.0,
        check=False,
    )
    assert run.returncode == 0, run.stdout[-6000:] + run.stderr[-2000:]
    assert " passed" in run.stdout

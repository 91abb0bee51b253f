"""LeRobot's programs as processes, and emulated arms; `make test-lerobot` runs these tests."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

pytest.importorskip("lerobot", reason="needs LeRobot: make test-lerobot")

import pliant
from pliant.config.factory import make_emulator
from pliant.emulator.process import EmulatorProcess

# A job that a shell runs in the background ignores SIGINT; its programs would inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)

HERE = Path(__file__).parent
MOTORS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")


class Program:
    """One of LeRobot's programs in a separate process group, as in a terminal."""

    def __init__(self, name: str, options: list[str], home: Path) -> None:
        paths = [str(HERE), os.environ.get("PYTHONPATH", "")]
        environment = {
            "HF_LEROBOT_HOME": str(home),
            "HF_HUB_OFFLINE": "1",
            "PYTHONPATH": os.pathsep.join(filter(None, paths)),
            "PYTHONUNBUFFERED": "1",
        }
        self.text = ""
        self._process = subprocess.Popen(
            [Path(sys.executable).with_name(f"lerobot-{name}"), *options],
            env=os.environ | environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        for line in iter(self._process.stdout.readline, b""):
            self.text += line.decode(errors="replace")

    def wait_for(self, text: str, seconds: float = 90.0) -> None:
        """Wait until the program has written a text."""
        end = time.monotonic() + seconds
        while text not in self.text:
            assert time.monotonic() < end, f"no {text!r} within {seconds} s:\n{self.text[-4000:]}"
            assert self._process.poll() is None, f"ended without {text!r}:\n{self.text[-4000:]}"
            time.sleep(0.05)

    def interrupt(self) -> None:
        """Send SIGINT to the whole process group, as Ctrl-C in a terminal does."""
        os.killpg(self._process.pid, signal.SIGINT)

    @property
    def ended(self) -> bool:
        """True if the program has ended."""
        return self._process.poll() is not None

    def end(self, seconds: float = 120.0) -> int:
        """Wait for the end; return the exit code."""
        try:
            code = self._process.wait(seconds)
        except subprocess.TimeoutExpired:
            os.killpg(self._process.pid, signal.SIGKILL)
            raise AssertionError(f"still running:\n{self.text[-4000:]}") from None
        self._reader.join(5.0)
        self._process.stdout.close()
        return code


@pytest.fixture
def program(tmp_path):
    """Start programs; kill those that still run at the end."""
    started = []

    def start(name, *options):
        started.append(Program(name, list(options), tmp_path / "home"))
        return started[-1]

    yield start
    for running in started:
        if running._process.poll() is None:
            os.killpg(running._process.pid, signal.SIGKILL)


def calibration(middle=2047):
    """Return LeRobot's calibration of an arm whose joint zeros are at the count `middle`."""
    return {
        motor: {
            "id": i,
            "drive_mode": 0,
            "homing_offset": 0,
            "range_min": middle - 1200,
            "range_max": middle + 1201,
        }
        for i, motor in enumerate(MOTORS, 1)
    }


@contextmanager
def emulated(arm, folder, **options):
    """Start a calibrated emulated arm; yield its process and its calibration file."""
    path = folder / "emulated.json"
    path.write_text(json.dumps(calibration()), "utf-8")
    file = pliant.config.load(arm, calibration=path)
    emulator = EmulatorProcess(make_emulator, file, **options)
    try:
        yield emulator, path
    finally:
        emulator.stop()

"""Recorder of a run: sends the data of each control cycle to a process that writes the log."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pliant._core import ConfigError, Controller, __version__
from pliant._files import check_output
from pliant._processes import child_options, end_real_time_priority
from pliant._validation import format_value, instance
from pliant.arm._checks import check_same_robot
from pliant.log import frames, layout, serialization
from pliant.log.journal import Journal

if TYPE_CHECKING:
    from collections.abc import Callable

    from pliant.arm import Arm
    from pliant.config import Config
    from pliant.loop import Commanded, Tick

#: Longest time for which `close` waits until the writer process takes data, and until it ends [s].
#: On a busy machine the process may still be starting.
CLOSE_TIMEOUT = 10.0


class Recorder:
    """Writes a run to an MCAP file in another process, so that the loop never waits for a disk.

    Pass the recorder to `pliant.Loop`, which starts it, adds every tick and closes it. If the
    program is killed, the writer process still completes the file.

    Args:
        path: Path of the log. An existing log is replaced; another file is not overwritten.
        config: Configuration of the arm, to be stored in the log.
        note: Comment to be stored in the log.

    Attributes:
        path: Path of the log.
        ticks: Number of recorded ticks (control cycles) so far.

    Raises:
        ConfigError: The file exists and is not a log, or the system has no non-blocking pipes.
        TypeError: An argument has the wrong type.
        OSError: The file cannot be written.
        ImportError: The extra `log` is not installed.

    Example:
        >>> loop = pliant.Loop(arm, controller, recorder=pliant.log.Recorder("run.mcap"))
        >>> for tick in loop:
        ...     tick.step(target)
    """

    def __init__(self, path: str | Path, *, config: Config | None = None, note: str = "") -> None:
        instance(note, str, "note")
        if not isinstance(path, str | PathLike):
            raise TypeError(f"path must be the path of a file, got {format_value(path)}")
        if config is not None and not hasattr(config, "model_dump_json"):
            raise TypeError(
                f"config must be what pliant.config.load gives, got {format_value(config)}"
            )
        if not hasattr(os, "set_blocking"):
            raise ConfigError("a log on Windows needs Python 3.12 or newer: leave the log out")
        self.path, self.ticks = Path(path), 0
        self._config, self._note = config, note
        self._process: subprocess.Popen[bytes] | None = None
        self._closed = False
        self._journal: Journal | None = None
        check_output(self.path, "log")

    def start(self, arm: Arm, controller: Any | None, rate: float) -> Any:
        """Start the writer process; `pliant.Loop` calls this method.

        Args:
            arm: The arm.
            controller: A `pliant.Controller` before its first step, whose calls are recorded. For
                None or another object, such as `HandGuiding`, the log has only ticks and commands.
            rate: Control rate [Hz], from which the writer computes the size of its buffer.

        Returns:
            A wrapper of the `pliant.Controller` that records every call; any other object is
            returned unchanged.

        Raises:
            ConfigError: The recorder has been started already, or the controller has made steps
                or belongs to another arm.
        """
        if self._process is not None:
            raise ConfigError(f"{self.path} belongs to another loop: make a Recorder for each")
        original = controller
        controller = controller if isinstance(controller, Controller) else None
        if controller is not None and controller.commands_made:
            raise ConfigError(
                "the controller has made steps that would be missing from the log: give the "
                "recorder to the loop of its first step, or make a new controller"
            )
        if controller is not None:
            check_same_robot(controller.model, arm.model)
        self._extra = tuple(arm.grippers)
        self._counters: Callable[[], dict[str, int]] = lambda: arm.counters
        axes = None if controller is None else controller.settings.task.names
        vector = layout.tick(arm.model.n, None if axes is None else len(axes), len(self._extra))
        self._row, self._axes = np.empty(vector.size), axes
        self._slots = vector.split(self._row)
        run = {
            "version": layout.VERSION,
            "pliant": __version__,
            "note": self._note,
            "rate": float(rate),
            "joints": arm.model.joint_names,
            "extra": self._extra,
            "axes": axes,
            "model": serialization.describe(arm.model if controller is None else controller.model),
            "servos": arm.servos if controller is None else controller.servos,
            "settings": None if controller is None else controller.settings,
            "config": None if self._config is None else self._config.model_dump_json(by_alias=True),
            "wall": time.time(),
            "clock": arm.clock.now(),
        }
        self._process = subprocess.Popen(
            [sys.executable, "-m", "pliant.log.writer", str(self.path)],
            stdin=subprocess.PIPE,
            # Protect the writer from Ctrl-C and a closed terminal; it ends when its pipe closes.
            **child_options(),
        )
        end_real_time_priority(self._process.pid)
        assert self._process.stdin is not None
        self._sender = frames.Sender(self._process.stdin.fileno())
        self._sender.send(frames.RUN, serialization.write(run).encode())
        if controller is None:
            return original
        self._journal = Journal(controller, self._sender)
        return self._journal

    @property
    def dropped(self) -> int:
        """Number of records dropped because the writer process was too slow or has ended."""
        return 0 if self._process is None else self._sender.dropped

    def add(self, tick: Tick, command: Commanded | None = None) -> None:
        """Record a tick and its command, without waiting; `pliant.Loop` calls this method."""
        slots, state = self._slots, tick.state
        self._row.fill(np.nan)
        slots["time"][0] = state.time
        slots["dt"][0], slots["index"][0] = tick.dt, tick.index
        slots["lag"][0] = tick.began - state.time
        for name in layout.STATE:
            value = getattr(state, name)
            if value is not None:
                slots[name][:] = value
        if command is not None:
            slots["goal"][:] = command.goal
            slots["torque_limit"][:] = command.torque_limit
            speed_limit = getattr(command, "speed_limit", None)
            if speed_limit is not None:
                slots["speed_limit"][:] = speed_limit
        if self._extra:
            slots["extra"][:] = [state.extra.get(name, np.nan) for name in self._extra]
        if self._journal is not None:
            self._store_controller_state(self._journal)
        self._sender.send(frames.TICK, self._row.tobytes())
        self.ticks += 1

    def _store_controller_state(self, journal: Journal) -> None:
        """Copy the controller's state after its step into the record of the present tick."""
        target, slots = journal.target, self._slots
        if target is None:  # no step in this tick
            return
        last = journal.inner.diagnostics
        slots["delay"][0] = journal.delay
        slots["target"][:] = target.reshape(-1)
        slots["reference"][:] = last.reference.reshape(-1)
        slots["activation"][:] = last.activation.reshape(-1)
        for name in (*layout.AXES, *layout.JOINT):
            value = getattr(last, name)
            if value.size == slots[name].size:
                slots[name][:] = value
        for name in layout.SCALARS:
            slots[name][0] = getattr(last, name)

    def close(self) -> None:
        """Send all buffered data and wait until the writer process has completed the file.

        Raises:
            OSError: The writer process failed, or neither took data nor ended for `CLOSE_TIMEOUT`.
                The file can be read up to its last record.
        """
        process = self._process
        if self._closed or process is None or process.stdin is None:
            return
        self._closed = True
        counts = {"counters": self._counters(), "dropped": self.dropped}
        self._sender.send(frames.END, serialization.write(counts).encode())
        is_sent = self._sender.finish(CLOSE_TIMEOUT)
        process.stdin.close()
        try:
            code = process.wait(CLOSE_TIMEOUT)
        except subprocess.TimeoutExpired:
            raise OSError(f"{self.path}: the disk is slow; the writer process continues") from None
        if code != 0:
            raise OSError(f"{self.path}: the log could not be written to its end")
        if not is_sent:
            raise OSError(
                f"{self.path}: the log ends early, because the disk is slow or the computer busy"
            )

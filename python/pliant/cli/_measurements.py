"""Measurements file of `pliant identify --report` and `pliant servos doctor --measure`.

docs/first_measurements.md describes the file: JSON without paths, serial numbers or names of people
and computers.
"""

from __future__ import annotations

import json
import math
import os
import platform
import time
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

import numpy as np

from pliant._core import ConfigError
from pliant._files import check_output, read_text, replacing
from pliant.cli._console import make_table
from pliant.config.doctor import time_readings, wire_read_time
from pliant.servo import ServoBus
from pliant.servo._port import latency_timer

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from rich.table import Table

    from pliant import identify
    from pliant.arm import Arm
    from pliant.config import Config

#: Values of the keys `format` and `units`.
FORMAT = "pliant-measurements 1"
UNITS = "SI (m, kg, s, N, N·m, rad, V); temperature in °C, scale in g, gain in register units"
#: Significant digits of the numbers in the file.
DIGITS = 5
#: Smallest height of the tool above a table in the pose in which joints swing [m].
MIN_HEIGHT = 0.15


class Measurements:
    """Contents of a measurements file, which a session completes step by step.

    Attributes:
        path: Path of the file.
        data: Contents of the file.
        steps: Results of the completed steps by name, a part of `data`.
    """

    def __init__(self, path: Path, inputs: Iterable[Path | str | None] = ()) -> None:
        """Read the file if it exists; write nothing.

        Raises:
            ConfigError: The file cannot be written, or is not a measurements file.
        """
        self.path = path
        self.data: dict[str, Any] = {}
        self.steps: dict[str, Any] = {}
        if check_output(path, "measurements file", inputs):
            try:
                self.data = json.loads(read_text(path))
                self.steps = self.data["steps"]
                is_valid = self.data["format"] == FORMAT
                _identity(self.data), self.table()
            except (ValueError, LookupError, TypeError, AttributeError, RecursionError):
                is_valid = False
            if not is_valid:
                raise ConfigError(
                    f"{path} cannot be continued: its format is not {FORMAT!r}; name another file"
                )

    def add(self, step: str, values: Any) -> None:
        """Store the values of a step; `save` writes the file."""
        self.steps[step] = _plain(values)

    def save(self) -> None:
        """Write the file.

        Raises:
            OSError: The folder or the disk rejects the file.
        """
        text = json.dumps(self.data, indent=1, ensure_ascii=False, allow_nan=False)
        with replacing(self.path) as path:
            path.write_text(text + "\n", encoding="utf-8")

    def start(self, arm: Arm, config: Config) -> None:
        """Store environment and servos of an open arm, and measure its bus; torque stays as it is.

        Raises:
            ConfigError: The arm has no servo bus, or the file is of other servos.
        """
        chain = arm.drive
        if not isinstance(chain, ServoBus):
            raise ConfigError(
                f"a measurements file is about servos on a bus, and backend {config.backend!r} has "
                "none: use backend bus, or emulator for a rehearsal"
            )
        torque = dict(zip(chain.names, chain.servos.max_torque, strict=True))
        rows = {spec.name: spec.row for spec in chain.specs}
        servos = [
            {
                "joint": info.joint,
                "id": info.id,
                "model": info.model,
                "model_number": rows[info.joint].model_number,
                "firmware": info.firmware,
                "gain": chain.gains[info.joint],
                "voltage": info.voltage,
                "temperature": info.temperature,
                "return_delay": info.return_delay,
                "max_torque_assumed": torque[info.joint],
            }
            for info in chain.found
        ]
        packages = {name: version(name) for name in ("pliant", "numpy", "rustypot")}
        header = {
            "format": FORMAT,
            "units": UNITS,
            "date": time.strftime("%Y-%m-%d", time.gmtime()),
            "environment": packages
            | {
                "python": platform.python_version(),
                "system": f"{platform.system()} {platform.release()} {platform.machine()}",
                "cpu_count": os.cpu_count(),
            },
            "arm": {
                "backend": config.backend,
                "robot": config.robot.builtin or "urdf",
                "joints": arm.model.joint_names,
                "rate": arm.rate,
                "baud": [port.baud for port in config.port],
            },
            "servos": servos,
        }
        if self.steps and _identity(self.data) != _identity(header):
            raise ConfigError(
                f"{self.path} is of other servos than those of this arm: name another file"
            )
        self.data = _plain(header) | {"steps": self.steps}
        times, lost = time_readings(chain)
        bus = {
            "read_median": np.median(times),
            "read_99": np.quantile(times, 0.99),
            "read_lost": lost,
            "read_wire": wire_read_time(chain, config.port[0].baud),
            "adapter_latency": [
                latency_timer(p) for p in {spec.port: None for spec in chain.specs}
            ],
        }
        self.add("bus", bus)

    def add_servos(self, identification: identify.Identification) -> None:
        """Store identified servo parameters."""
        columns = {
            "friction": identification.friction,
            **{key: getattr(identification.servos, key) for key in KEYS},
        }
        assumed = {
            f"{key}_assumed": getattr(identification.assumed, key) for key in ("kp", "friction")
        }
        sigmas = {f"{key}_sigma": identification.sigma[key] for key in ("kp", "friction")}
        values = {
            "joints": per_joint(identification.joint_names, columns | assumed | sigmas),
            "delay": identification.delay,
            "delay_sigma": identification.delay_sigma,
            "extra_mass": identification.payload.mass,
            "extra_mass_sigma": identification.payload.mass_sigma,
            "spread": identification.residual_ratio,
            "undriven": identification.undriven,
        }
        self.add("servos", values)

    def table(self) -> Table:
        """Return a table of assumed, predicted and measured values, to be printed."""
        out = make_table("", "assumed", "measured", "ratio")
        for step, how in (("servos", ""), ("weight", " by weight")):
            for joint in self.steps.get(step, {}).get("joints", ()):
                for key, name in (("kp", f"k_p{how}, N·m/rad"), ("friction", "friction, N·m")):
                    if (value := joint.get(key)) is not None:
                        bars = f"{value:.3g} ± {2.0 * joint[f'{key}_sigma']:.2g}"
                        old = joint[f"{key}_assumed"]
                        ratio = f"{value / old:.2f}" if old else ""
                        out.add_row(f"{joint['joint']} {name}", f"{old:.3g}", bars, ratio)
        for push in self.steps.get("push", ()):
            old, value = push["promised"], push["measured"]
            name = f"force along {push['axis']} toward {push['toward']}, N"
            out.add_row(name, f"{old:.3g}", f"{value:.3g}", f"{value / old:.2f}")
        for step, key, name, unit in (
            ("weight", "extra_mass", "mass that the model lacks, g", 1e-3),
            ("bus", "read_median", "reading all joints, ms", 1e-3),
            ("loop", "write_median", "writing all joints, ms", 1e-3),
            ("loop", "late_99", "lateness of ticks, 99 %, ms", 1e-3),
            ("ending", "seconds", "lowering, s", 1.0),
            ("ending", "drop_after_torque_off", "drop after torque off, mm", 1e-3),
        ):
            if (value := self.steps.get(step, {}).get(key)) is not None:
                out.add_row(name, "", f"{value / unit:.3g}")
        return out


#: Fields of `pliant.Servos` in the file, apart from the friction at the load of the pose.
KEYS = ("kp", "load_friction", "damping", "kv")


def per_joint(names: Iterable[str], columns: dict[str, Any]) -> list[dict[str, Any]]:
    """Return one dict per joint; a column has one entry per joint (n,), or is a scalar for all."""
    joints = tuple(names)
    full = {key: np.broadcast_to(value, len(joints)) for key, value in columns.items()}
    return [
        {"joint": name, **{key: column[i] for key, column in full.items()}}
        for i, name in enumerate(joints)
    ]


def _identity(data: Any) -> Any:
    """Return the values that identify the servos of a file."""
    keys = ("joint", "id", "model_number", "firmware")
    return [[servo[key] for key in keys] for servo in data["servos"]]


def _plain(value: Any) -> Any:
    """Return a value for JSON: rounded numbers, lists, None in place of NaN and infinity."""
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_plain(each) for each in value]
    if isinstance(value, float):  # also np.float64
        return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None
    return value


def height_error(arm: Arm) -> str | None:
    """Return an error text if the tool is too low above a table for joints to swing."""
    height = arm.model.forward_kinematics(arm.read().q)[2, 3] - (arm.table or 0.0)
    if arm.table is None or height >= MIN_HEIGHT:
        return None
    needed = f"needed are {MIN_HEIGHT * 100:.0f} cm: hold it higher"
    return f"the tool is {height * 100:.0f} cm above the table, {needed}"

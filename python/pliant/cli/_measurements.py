"""Measurements file of `pliant identify --report` and `pliant servos doctor --measure`.

The file is self-contained JSON without serial numbers, paths or names of people and computers.
docs/first_measurements.md describes it.
"""

from __future__ import annotations

import json
import math
import os
import platform
import time
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table

from pliant._core import ConfigError
from pliant._files import check_output, read_text, replacing
from pliant.config.doctor import time_readings, wire_read_time
from pliant.servo import ServoBus
from pliant.servo._port import latency_timer

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from pliant import identify
    from pliant.arm import Arm
    from pliant.config import Config

#: Value of the key `format`. Files of another value are not continued.
FORMAT = "pliant measurements 1"
#: Unit of each key with a number or numbers.
UNITS = {
    "cpu_count": "1",
    "gain": "register units",
    "gear_ratio": "1",
    "id": "1",
    "firmware": "1",
    "model_number": "1",
    "temperature": "°C",
    "voltage": "V",
    "rate": "Hz",
    "baud": "bit/s",
    "adapter_latency": "s",
    "return_delay": "s",
    "read_median": "s",
    "read_99": "s",
    "read_lost": "1",
    "read_wire": "s",
    "write_median": "s",
    "write_99": "s",
    "late_median": "s",
    "late_99": "s",
    "late_max": "s",
    "ticks": "1",
    "missed": "1",
    "missing": "1",
    "counters": "1",
    "q": "rad",
    "max_torque_assumed": "N·m",
    "kp": "N·m/rad",
    "kp_assumed": "N·m/rad",
    "kp_sigma": "N·m/rad",
    "friction": "N·m",
    "friction_assumed": "N·m",
    "friction_sigma": "N·m",
    "load_friction": "1",
    "damping": "N·m·s/rad",
    "kv": "N·m·s/rad",
    "delay": "s",
    "delay_sigma": "s",
    "extra_mass": "kg",
    "extra_mass_sigma": "kg",
    "spread": "1",
    "scale": "g",
    "promised": "N",
    "friction_force": "N",
    "measured": "N",
    "deviation": "m",
    "torque": "N·m",
    "lead": "rad",
    "lead_sigma": "rad",
    "mass": "kg",
    "mass_by_table": "kg",
    "mass_by_identified": "kg",
    "seconds": "s",
    "distance": "m",
    "drop": "m",
    "drop_after_torque_off": "m",
}
#: Significant digits of the numbers in the file.
DIGITS = 5


class Measurements:
    """Contents of a measurements file, which a session completes step by step.

    Attributes:
        path: Path of the file.
        data: Contents; `data["steps"]` has the completed steps by name.
    """

    def __init__(self, path: Path, inputs: Iterable[Path | str | None] = ()) -> None:
        """Read the file if it exists; write nothing.

        Raises:
            ConfigError: The file cannot be written, or is not a measurements file.
        """
        self.path = path
        self.data: dict[str, Any] = {"format": FORMAT, "steps": {}}
        if check_output(path, "measurements file", inputs):
            try:
                self.data = json.loads(read_text(path))
                known = self.data["format"] == FORMAT and isinstance(self.data["steps"], dict)
            except (ValueError, KeyError, TypeError) as error:
                raise ConfigError(
                    f"{path} cannot be continued: {error!r}; name another file"
                ) from error
            if not known:
                raise ConfigError(
                    f"{path} has the format {self.data['format']!r}, needed is {FORMAT!r}: name "
                    "another file"
                )

    def __contains__(self, step: str) -> bool:
        """Return True if a step is complete."""
        return step in self.data["steps"]

    def __getitem__(self, step: str) -> Any:
        """Return the values of a complete step."""
        return self.data["steps"][step]

    def add(self, step: str, values: Any) -> None:
        """Store the values of a step; `save` writes the file."""
        self.data["steps"][step] = _plain(values)

    def save(self) -> None:
        """Write the file.

        Raises:
            OSError: The folder or the disk rejects the file.
        """
        text = json.dumps(self.data, indent=1, ensure_ascii=False, allow_nan=False)
        with replacing(self.path) as path:
            path.write_text(text + "\n", encoding="utf-8")

    def start(self, arm: Arm, config: Config) -> None:
        """Store environment and servos of an arm, and measure the latency of its bus.

        The arm is open; torque stays as it is.

        Raises:
            ConfigError: The arm has no servo bus, or the file is of other servos.
        """
        chain = arm.drive
        if not isinstance(chain, ServoBus):
            raise ConfigError(
                f"a measurements file is of servos on a bus, and backend {config.backend!r} has "
                "none: use backend bus, or emulator for a rehearsal"
            )
        servos = _plain(_servos(chain))
        if "servos" in self.data and _identity(self.data["servos"]) != _identity(servos):
            raise ConfigError(
                f"{self.path} is of other servos than those of this arm: name another file"
            )
        units = {"units": UNITS, "date": time.strftime("%Y-%m-%d", time.gmtime())}
        environment = {"environment": _environment(), "arm": _arm(arm, config), "servos": servos}
        steps = self.data["steps"]
        self.data = {"format": FORMAT, **units, **_plain(environment), "steps": steps}
        if "bus" not in self:
            self.add("bus", _bus(chain, config))

    def add_servos(self, found: identify.Identification, q: Any) -> None:
        """Store identified servo parameters; q are the joint positions (n,) [rad]."""
        table, old = found.servos, found.assumed
        n = len(found.joint_names)
        columns = {
            "kp": table.kp,
            "kp_sigma": found.errors["kp"],
            "kp_assumed": np.broadcast_to(old.kp, n),
            "friction": found.friction,
            "friction_sigma": found.errors["friction"],
            "friction_assumed": np.broadcast_to(old.friction, n),
            "load_friction": table.load_friction,
            "damping": table.damping,
            "kv": table.kv,
        }
        joints = [
            {"joint": name, **{key: column[i] for key, column in columns.items()}}
            for i, name in enumerate(found.joint_names)
        ]
        values = {
            "q": q,
            "joints": joints,
            "delay": found.delay,
            "delay_sigma": found.delay_sigma,
            "extra_mass": found.payload.mass,
            "extra_mass_sigma": found.payload.mass_sigma,
            "spread": found.spread,
            "undriven": found.undriven,
        }
        self.add("servos", values)

    def table(self) -> Table:
        """Return a table of assumed and promised values beside measured ones, for people."""
        out = Table("", "assumed", "measured", "ratio", box=SIMPLE_HEAD, pad_edge=False)
        steps = self.data["steps"]
        for step, how in (("servos", ""), ("weight", " by weight")):
            for joint in steps.get(step, {}).get("joints", ()):
                for key, name in (("kp", f"k_p{how}, N·m/rad"), ("friction", "friction, N·m")):
                    if joint.get(key) is not None:
                        columns = (joint[f"{key}_assumed"], joint[key], joint[f"{key}_sigma"])
                        _row(out, f"{joint['joint']} {name}", *columns)
        for push in steps.get("push", ()):
            name = f"force along {push['axis']} toward {push['toward']}, N"
            _row(out, name, push["promised"], push["measured"])
        if weight := steps.get("weight"):
            for by in ("table", "identified"):
                if (felt := weight.get(f"mass_by_{by}")) is not None:
                    _row(out, f"weight by k_p, {by}, kg", weight["mass"], felt)
            if weight["extra_mass"] is not None:
                out.add_row("mass that the model lacks, kg", "0", f"{weight['extra_mass']:.3g}")
        for step, key, name in (
            ("bus", "read_median", "reading all joints, median, ms"),
            ("loop", "write_median", "writing all joints, median, ms"),
            ("loop", "late_99", "lateness of ticks, 99 %, ms"),
            ("ending", "seconds", "lowering, s"),
            ("ending", "drop_after_torque_off", "drop after torque off, mm"),
        ):
            if (value := steps.get(step, {}).get(key)) is not None:
                out.add_row(name, "", f"{value * (1.0 if name.endswith(' s') else 1e3):.3g}")
        return out


def _row(table: Table, name: str, old: float, new: float, sigma: float | None = None) -> None:
    bars = "" if sigma is None else f" ± {2 * sigma:.2g}"
    table.add_row(name, f"{old:.3g}", f"{new:.3g}{bars}", f"{new / old:.2f}" if old else "")


def _plain(value: Any) -> Any:
    """Return a value for JSON: rounded numbers, lists, no NaN and infinity (None)."""
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_plain(each) for each in value]
    if isinstance(value, float | np.floating):
        return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None
    return value.item() if isinstance(value, np.generic) else value


def _environment() -> dict[str, Any]:
    """Return versions of the program, its libraries and the system."""
    packages = {}
    for name in ("pliant", "numpy", "rustypot"):
        try:
            packages[name] = version(name)
        except PackageNotFoundError:
            packages[name] = "unknown"
    return packages | {
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.release()}",
        "machine": platform.machine(),
        "cpu_count": os.cpu_count(),
    }


def _arm(arm: Arm, config: Config) -> dict[str, Any]:
    """Return what a reader needs to know of the configuration; names of files are left out."""
    return {
        "backend": config.backend,
        "robot": config.robot.builtin or "urdf",
        "joints": arm.model.joint_names,
        "rate": arm.rate,
        "baud": [port.baud for port in config.port],
        "payload_in_file": config.robot.payload is not None,
    }


def _servos(chain: ServoBus) -> list[dict[str, Any]]:
    rows = {spec.name: spec for spec in chain.specs}
    torque = dict(zip(chain.names, chain.servos.max_torque, strict=True))
    return [
        {
            "joint": info.joint,
            "id": info.id,
            "model": info.model,
            "model_number": rows[info.joint].row.model_number,
            "firmware": info.firmware,
            "gain": chain.gains[info.joint],
            "gear_ratio": rows[info.joint].gear_ratio,
            "voltage": info.voltage,
            "temperature": info.temperature,
            "return_delay": info.return_delay,
            "max_torque_assumed": torque[info.joint],
        }
        for info in chain.found
    ]


def _identity(servos: Any) -> Any:
    keys = ("joint", "id", "model", "firmware")
    return [[servo.get(key) for key in keys] for servo in servos]


def _bus(chain: ServoBus, config: Config) -> dict[str, Any]:
    times, lost = time_readings(chain)
    ports = dict.fromkeys(spec.port for spec in chain.specs)
    return {
        "read_median": np.median(times),
        "read_99": np.quantile(times, 0.99),
        "read_lost": lost,
        "read_wire": wire_read_time(chain, config.port[0].baud),
        "adapter_latency": [latency_timer(port) for port in ports],
    }

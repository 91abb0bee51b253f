"""Loading of a TOML file, or of a built-in one by name, into a checked `Config`."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from pliant._core import ConfigError
from pliant._files import read_text
from pliant.config._messages import explain, suggest
from pliant.config._settings_table import check_preset, resolve
from pliant.config.schema import Config, Loop

if TYPE_CHECKING:
    from importlib.resources.abc import Traversable


def load(
    source: str | Path,
    *,
    port: str | None = None,
    backend: str | None = None,
    urdf: str | Path | None = None,
    calibration: str | Path | None = None,
    table: float | bool | None = None,
) -> Config:
    """Read a configuration file.

    Args:
        source: Path of a TOML file, or the name of a ready one (`pliant.config.names()`).
        port: Serial device, overrides a file with a single port; or `auto`.
        backend: `bus`, `emulator` or `sim`, overrides the file.
        urdf: URDF file, overrides the file; relative to the working folder. Not allowed for a
            built-in model, because the signs in the file belong to that model.
        calibration: LeRobot calibration file, overrides the file; relative to the working folder.
        table: Height of the table [m], overrides the file; False: no table.

    Returns:
        The configuration, checked as a whole.

    Raises:
        ConfigError: The file is missing, is not TOML, or has errors. The message lists all wrong
            keys and values, with the allowed ones. Conditions across tables (ids on a port, names
            of ports) are checked once each table is valid by itself.
    """
    path = Path(source).expanduser()
    name = str(source)
    if path.is_file():
        text, folder, label = _read(path), path.resolve().parent, str(source)
    elif path.suffix != ".toml" and name in names():
        text, folder, label = builtin_text(name), Path.cwd(), f"{name} (ready file)"
    elif path.suffix == ".toml" or len(path.parts) > 1:
        raise ConfigError(f"there is no file {name}; ready files: {', '.join(names())}")
    else:
        raise ConfigError(
            f"{name!r} is neither a file nor the name of a ready one; {suggest(name, names())}"
        )
    overrides = Overrides(port, backend, urdf, calibration, table)
    return parse(text, source=label, folder=folder, overrides=overrides)


@dataclass(frozen=True)
class Overrides:
    """Values that override the file; see `load`."""

    port: str | None = None
    backend: str | None = None
    urdf: str | Path | None = None
    calibration: str | Path | None = None
    table: float | bool | None = None

    def apply(self, table: dict[str, Any], source: str) -> None:
        """Write the values into the table.

        Raises:
            ConfigError: A port is given for a file with several ports or none, or a URDF for a
                built-in model.
        """
        if self.backend is not None:
            table["backend"] = self.backend
        if self.urdf is not None and isinstance(table.get("robot"), dict):
            if "builtin" in table["robot"]:
                raise ConfigError(
                    f"{source} is written for the built-in model {table['robot']['builtin']!r}: "
                    f"its signs and zeros are wrong for {self.urdf}, which may count joints the "
                    "other way round. Write a file with urdf, base and tip in [robot] and the "
                    "signs of that URDF (docs/robots/so101.md has one), without --urdf"
                )
            table["robot"]["urdf"] = Path(self.urdf).expanduser().resolve()
        if self.table is not None and isinstance(table.get("robot"), dict):
            if self.table is True:
                raise ConfigError("table is a height [m], or False for none; got True")
            table["robot"].pop("table", None)
            if self.table is not False:
                table["robot"]["table"] = self.table
        if self.calibration is not None:
            table["calibration"] = Path(self.calibration).expanduser().resolve()
        if self.port is None:
            return
        backend = table.get("backend", "bus")
        if backend in {"sim", "emulator"}:
            raise ConfigError(
                f"port {self.port} is for servos on a bus, and backend {backend!r} opens none of "
                "yours: leave the port out, or say backend 'bus'"
            )
        ports: Any = table.get("port", [{}])
        if not isinstance(ports, list) or len(ports) != 1:
            raise ConfigError(
                f"{source} does not name just one port: a path from outside cannot replace them; "
                "write the paths into the file"
            )
        table["port"] = [{**ports[0], "path": self.port}]


def parse(
    text: str,
    *,
    source: str = "configuration",
    folder: str | Path = ".",
    overrides: Overrides = Overrides(),
) -> Config:
    """Check the text of a configuration.

    Args:
        text: TOML.
        source: Name of the text in errors.
        folder: Folder for relative paths.
        overrides: Values that override the text.

    Raises:
        ConfigError: As in `load`.
    """
    if text.lstrip().startswith("<"):
        raise ConfigError(
            f"{source} is no TOML but XML: a URDF goes into [robot] urdf of a configuration file "
            "(docs/config.md), or behind --urdf where a ready file has none of its own"
        )
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        if text.lstrip().startswith("<"):
            raise ConfigError(
                f"{source} is XML, not a configuration: a URDF is named in one, [robot] "
                'urdf = "arm.urdf"; docs/config.md has a whole file'
            ) from error
        raise ConfigError(f"{source} is no TOML: {error}") from error
    overrides.apply(table, source)
    try:
        config = Config.model_validate(table)
    except ValidationError as error:
        messages = [line for sentence in explain(error, Config) for line in sentence.splitlines()]
        raise _all_wrong(source, [*messages, *_settings(table)]) from None
    if wrong := _settings(table):
        raise _all_wrong(source, wrong)
    return config.at(Path(folder), source)


def _all_wrong(source: str, wrong: list[str]) -> ConfigError:
    """Create an error with all errors of a file, a line each."""
    if len(wrong) == 1:
        return ConfigError(f"{source}: {wrong[0]}")
    return ConfigError("\n".join([f"{source} has {len(wrong)} mistakes:", *wrong]))


def _settings(table: dict[str, Any]) -> list[str]:
    """Return the errors of the settings, also if other parts of the table are wrong."""
    fields, preset, loop = table.get("settings", {}), table.get("preset"), table.get("loop", {})
    # Errors of loop and preset are reported already: check the settings without them.
    try:
        rate = Loop.model_validate(loop).rate
    except ValueError:
        rate = Loop().rate
    try:
        check_preset(preset)
    except ValueError:
        preset = None
    if not isinstance(fields, dict):
        return []
    return [f"settings: {messages}" for messages in resolve(fields, preset, rate)[1]]


def _read(path: Path) -> str:
    try:
        return read_text(path)
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path} cannot be read: {error}") from error


def _builtin_files() -> dict[str, Traversable]:
    folder = files("pliant.config").joinpath("arms")
    found = {f.name.removesuffix(".toml"): f for f in folder.iterdir() if f.name.endswith(".toml")}
    return dict(sorted(found.items()))


def names() -> tuple[str, ...]:
    """Return the names of the ready files."""
    return tuple(_builtin_files())


def builtin_text(name: str) -> str:
    """Return the text of a ready file."""
    return _builtin_files()[name].read_text(encoding="utf-8")


def describe(name: str) -> str:
    """Return the description of a ready file: the comment at its top."""
    lines = []
    for line in builtin_text(name).splitlines():
        if not line.startswith("#"):
            break
        lines.append(line.removeprefix("#").strip())
    return " ".join(lines)

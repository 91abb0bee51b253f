"""Loading of a configuration, a TOML file or a built-in arm, into a validated `Config`."""

from __future__ import annotations

import tomllib
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict, Unpack

from pydantic import ValidationError

from pliant._core import ConfigError
from pliant._files import read_text
from pliant.config._messages import explain, suggest
from pliant.config._settings_table import check_preset, resolve
from pliant.config.schema import Config, Loop

if TYPE_CHECKING:
    from importlib.resources.abc import Traversable


class Overrides(TypedDict, total=False):
    """Values that replace values of a configuration file.

    Attributes:
        port: Serial device, for a file with a single port; or `auto`.
        backend: `bus`, `emulator` or `sim`.
        urdf: URDF file, relative to the working folder. Not allowed for a built-in model, because
            the joint signs in the configuration file belong to that model.
        calibration: LeRobot calibration file, relative to the working folder.
        table: Height of the table [m]; False: no table.
    """

    port: str | None
    backend: str | None
    urdf: str | Path | None
    calibration: str | Path | None
    table: float | bool | None


def load(source: str | Path, **overrides: Unpack[Overrides]) -> Config:
    """Return the configuration in a file.

    Args:
        source: Path of a TOML file, or name of a built-in file (`pliant.config.list_arms()`).
        **overrides: Values that replace those of the file: `port`, a serial device or `auto`;
            `backend`; `urdf` and `calibration`, relative to the working folder; `table`, a height
            [m] or False.

    Returns:
        The validated configuration.

    Raises:
        ConfigError: The file is missing, is not TOML, or has errors. The message lists all invalid
            keys and values, with the allowed ones. Conditions between tables (unique ids on a port,
            existing port names) are checked only if every single table is valid.
    """
    path = Path(source).expanduser()
    name = arm = str(source)
    if path.is_file():
        arm = path.stem
        text, folder, label = _read(path), path.resolve().parent, str(source)
    elif path.suffix != ".toml" and name in list_arms():
        text, folder, label = builtin_text(name), Path.cwd(), f"{name} (ready file)"
    elif path.is_dir():
        raise ConfigError(f"{name} is a folder: name a configuration file in it")
    elif path.suffix == ".toml" or len(path.parts) > 1:
        raise ConfigError(f"there is no file {name}; ready files: {', '.join(list_arms())}")
    else:
        raise ConfigError(
            f"{name!r} is neither a file nor the name of a ready one; {suggest(name, list_arms())}"
        )
    return parse(text, source=label, folder=folder, **overrides).at(folder, label, arm)


def _override(
    data: dict[str, Any],
    source: str,
    *,
    port: str | None = None,
    backend: str | None = None,
    urdf: str | Path | None = None,
    calibration: str | Path | None = None,
    table: float | bool | None = None,
) -> None:
    """Write the override values into `data`, the tables of a file; for arguments see `Overrides`.

    Raises:
        ConfigError: A port is given for a file with several ports or none, or a URDF for a
            built-in model.
    """
    if backend is not None:
        data["backend"] = backend
    robot = data.get("robot")
    if urdf is not None and isinstance(robot, dict):
        if "builtin" in robot:
            raise ConfigError(
                f"{source} is written for the built-in model {robot['builtin']!r}: its signs and "
                f"zeros are wrong for {urdf}, whose joint angles may have opposite signs. Write a "
                "file with urdf, base and tip in [robot] and the signs of that URDF "
                "(docs/robots/so101.md has one), without --urdf"
            )
        robot["urdf"] = Path(urdf).expanduser().resolve()
    if table is not None and isinstance(robot, dict):
        if table is True:
            raise ConfigError("table is a height [m], or False for none; got True")
        robot.pop("table", None)
        if table is not False:
            robot["table"] = table
    if calibration is not None:
        data["calibration"] = Path(calibration).expanduser().resolve()
    if port is None:
        return
    if data.get("backend", "bus") in {"sim", "emulator"}:
        raise ConfigError(
            f"port {port} is for servos on a bus, and backend {data['backend']!r} opens no serial "
            "port: leave the port out, or use backend 'bus'"
        )
    ports: Any = data.get("port", [{}])
    if not isinstance(ports, list) or len(ports) != 1:
        raise ConfigError(
            f"{source} does not name just one port: a path from outside cannot replace them; "
            "write the paths into the file"
        )
    data["port"] = [{**ports[0], "path": port}]


def parse(
    text: str,
    *,
    source: str = "configuration",
    folder: str | Path = ".",
    **overrides: Unpack[Overrides],
) -> Config:
    """Return the configuration in a string.

    Args:
        text: Text in TOML.
        source: Name of the text in error messages.
        folder: Folder that relative paths in the text start from.
        **overrides: Values that replace those of the text, see `load`.

    Raises:
        ConfigError: The text is not TOML, or has errors; see `load`.
    """
    if text.lstrip().startswith("<"):
        raise ConfigError(
            f"{source} is not TOML but XML: a URDF goes into [robot] urdf of a configuration file "
            "(docs/config.md), or behind --urdf where a ready file has none of its own"
        )
    try:
        # Editors of Windows begin a file with a byte order mark.
        table = tomllib.loads(text.removeprefix("\ufeff"))
    except tomllib.TOMLDecodeError as error:
        cause = str(error)
        if "Unescaped" in cause or "hex value" in cause:  # "C:\Users\..."
            cause += "; write a path with / or in single quotes"
        elif "Expected '='" in cause:
            cause += "; a name with spaces, as URDFs have, is in quotes"
        raise ConfigError(f"{source} is not TOML: {cause}") from error
    except RecursionError as error:
        raise ConfigError(f"{source} is not TOML: it is nested too deeply") from error
    except ValueError as error:  # an integer of more digits than Python reads
        raise ConfigError(f"{source} is not TOML: {error}") from error
    _override(table, source, **overrides)
    try:
        config = Config.model_validate(table)
    except ValidationError as error:
        messages = [line for sentence in explain(error, Config) for line in sentence.splitlines()]
        raise _error_of(source, [*messages, *_settings(table)]) from None
    if messages := _settings(table):
        raise _error_of(source, messages)
    return config.at(Path(folder), source)


def _error_of(source: str, messages: list[str]) -> ConfigError:
    """Return a `ConfigError` with all error messages of a file, one per line."""
    if len(messages) == 1:
        return ConfigError(f"{source}: {messages[0]}")
    return ConfigError("\n".join([f"{source} has {len(messages)} mistakes:", *messages]))


def _settings(table: dict[str, Any]) -> list[str]:
    """Return the errors in the file's table `settings`; invalid other tables are ignored."""
    fields, preset, loop = table.get("settings", {}), table.get("preset"), table.get("loop", {})
    # The schema already reports an invalid loop or preset, so use defaults in their place here.
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
    return [f"settings: {message}" for message in resolve(fields, preset, rate)[1]]


def _read(path: Path) -> str:
    try:
        return read_text(path)
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path} cannot be read: {error}") from error


def _builtin_files() -> dict[str, Traversable]:
    folder = files("pliant.config").joinpath("arms")
    arms = {f.name.removesuffix(".toml"): f for f in folder.iterdir() if f.name.endswith(".toml")}
    return dict(sorted(arms.items()))


def list_arms() -> tuple[str, ...]:
    """Return the names of the built-in configuration files, one per arm."""
    return tuple(_builtin_files())


def builtin_text(name: str) -> str:
    """Return the text of a built-in configuration file."""
    return _builtin_files()[name].read_text(encoding="utf-8")


def describe_arm(name: str) -> str:
    """Return the description of a built-in configuration file: the comment at its top."""
    lines = []
    for line in builtin_text(name).splitlines():
        if not line.startswith("#"):
            break
        lines.append(line.removeprefix("#").strip())
    return " ".join(lines)

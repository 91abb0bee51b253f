"""Reading a log into arrays, also an incomplete one."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pliant._core import ConfigError, Controller, Model, Servos, Settings
from pliant.log import layout, words
from pliant.log._mcap import Attachment, Channel, DecoderFactory, Message, Schema
from pliant.log.records import CutShortError, DamagedError, records

if TYPE_CHECKING:
    from pliant._typing import Array


#: Fields of the description of a run: name, types, and True if it may be None.
RUN: tuple[tuple[str, Any, bool], ...] = (
    ("pliant", str, False),
    ("note", str, False),
    ("rate", (int, float), False),
    ("joints", (list, tuple), False),
    ("extra", (list, tuple), False),
    ("axes", (list, tuple), True),
    ("model", dict, False),
    ("servos", Servos, True),
    ("settings", Settings, True),
    ("config", str, True),
)
#: Errors that a malformed file can raise.
FOREIGN = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)


@dataclass
class Log:
    """A run of N ticks, n joints and k axes; NaN for missing measurements.

    Every column of a tick is an attribute and an entry of `columns`: `time` (N,) [s] of the
    positions (0 at the beginning of the first tick), `q`, `dq`, `load`, `goal`, `torque_limit`
    (N, n), `target`, `reference` (N, 4, 4), `deviation`, `compliance` (N, k), `activation`
    (N, n, k + 1), and the others listed in docs/logs.md.

    Attributes:
        run: Description of the run: joints, axes, rate, settings, servos, version, note.
        columns: Arrays by name.
        calls: All calls of the controller in order: messages with the fields of a call.
        whole: True if the file was completed and is undamaged. If False, the program or the
            machine died, or see `damage`.
        damage: Description of the damage, empty if none; the data before it are here.
        end: Counts when the recorder was closed: `counters` of the bus and records `dropped`;
            empty if the program died before.
    """

    run: dict[str, Any]
    columns: dict[str, Array]
    calls: list[Any] = field(repr=False)
    whole: bool
    end: dict[str, Any] = field(default_factory=dict, repr=False)
    damage: str = ""

    def __getattr__(self, name: str) -> Array:
        columns: dict[str, Array] = self.__dict__.get("columns", {})
        if name in columns:
            return columns[name]
        raise AttributeError(f"a log has no column {name!r}; it has: {', '.join(columns)}")

    def __len__(self) -> int:
        return len(self.columns["time"])

    def __repr__(self) -> str:
        joints, axes = len(self.run["joints"]), len(self.run["axes"] or ())
        return f"<Log: {len(self)} ticks of {joints} joints and {axes} axes>"

    @property
    def missing(self) -> int:
        """Number of controller calls that are missing from the log."""
        return self.calls[-1].sequence + 1 - len(self.calls) if self.calls else 0

    @property
    def settings(self) -> Settings | None:
        """Settings at the beginning."""
        settings: Settings | None = self.run["settings"]
        return settings

    @property
    def servos(self) -> Servos | None:
        """Servo table of the controller."""
        servos: Servos | None = self.run["servos"]
        return servos

    def model(self) -> Model:
        """The arm, from the attached URDF."""
        return words.model(self.run["model"])


def read(path: str | Path) -> Log:
    """Read a log of `Recorder`, up to its end or its damage.

    Raises:
        ConfigError: The file is no log, or ends before the first record.
        OSError: It cannot be read.
    """
    try:
        return _read(Path(path))
    except FOREIGN as error:
        kind = type(error).__name__
        raise ConfigError(f"{path} is no log of pliant: {kind}: {error}") from error


def _read(path: Path) -> Log:
    run: dict[str, Any] | None = None
    ticks: list[Any] = []
    calls: list[Any] = []
    rows = {"/pliant/tick": ticks, "/pliant/call": calls}
    whole, damage, end = False, "", {}
    decode = _Decoder()
    with path.open("rb") as stream:
        try:
            for record in records(stream, path.stat().st_size):
                if isinstance(record, Attachment) and record.name == layout.RUN:
                    run = words.read(record.data.decode())
                elif isinstance(record, Attachment) and record.name == layout.END:
                    end = words.read(record.data.decode())
                elif isinstance(record, Schema):
                    decode.schemas[record.id] = record
                elif isinstance(record, Channel):
                    decode.channels[record.id] = record
                elif isinstance(record, Message):
                    wanted = rows.get(decode.channels[record.channel_id].topic)
                    if wanted is not None:
                        wanted.append(decode(record))
            whole = True
        except (CutShortError, DamagedError) as error:
            if run is None:
                short = "it ends before its first record"
                why = short if isinstance(error, CutShortError) else error
                raise ConfigError(f"{path} is no log of pliant: {why}") from error
            damage = str(error) if isinstance(error, DamagedError) else ""
    if run is None:
        raise ConfigError(f"{path} is no log of pliant: it has no attachment {layout.RUN!r}")
    if not isinstance(run, dict) or "version" not in run:
        raise ConfigError(f"{path} is no log of pliant: its description has no version")
    if run["version"] != layout.VERSION:
        raise ConfigError(
            f"{path} has layout {run['version']}, this pliant reads {layout.VERSION}: read it with "
            f"pliant {run.get('pliant')}"
        )
    try:
        _check(run)
    except ConfigError as error:
        raise ConfigError(f"{path} is no log of pliant: {error}") from error
    columns = _columns(run, ticks)
    if len(columns["time"]):
        # As `Tick.time`: 0 at the beginning of the first tick.
        columns["time"] -= columns["time"][0] + columns["lag"][0]
    return Log(run, columns, calls, whole, end, damage)


class _Decoder:
    """Decodes the messages of the channels read so far."""

    def __init__(self) -> None:
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self._factory = DecoderFactory()
        self._decoders: dict[int, Callable[[bytes], Any]] = {}

    def __call__(self, message: Message) -> Any:
        made = self._decoders.get(message.channel_id)
        if made is None:
            channel = self.channels[message.channel_id]
            found = self._factory.decoder_for("cdr", self.schemas[channel.schema_id])
            if found is None:
                raise ConfigError(f"no decoder for {channel.topic}")
            made = self._decoders[message.channel_id] = found
        return made(message.data)


def _check(run: Any) -> None:
    """Check that the description of a run has all fields used later.

    Raises:
        ConfigError: A field is missing or has a wrong type.
    """
    if not isinstance(run, dict):
        raise ConfigError(f"the description of the run is no table, but {type(run).__name__}")
    for name, kinds, optional in RUN:
        value = run.get(name)
        fits = value is None if optional and value is None else isinstance(value, kinds)
        if not fits or isinstance(value, bool):
            said = "has no" if value is None else f"has {type(value).__name__} for"
            raise ConfigError(f"the description of the run {said} {name!r}")
    for name in ("joints", "extra", "axes"):
        if not all(isinstance(one, str) for one in run[name] or ()):
            raise ConfigError(f"the description of the run has {name!r} that are no names")
    if not 0.0 < run["rate"] < math.inf:
        raise ConfigError(f"the description of the run has a rate of {run['rate']} Hz")
    model = words.model(run["model"])
    if tuple(run["joints"]) != model.joint_names:
        raise ConfigError("the description of the run has other joints than its model")
    if run["axes"] is not None and run["settings"] is None:
        raise ConfigError("the description of the run has axes and no settings")
    if run["settings"] is not None:
        if tuple(run["axes"] or ()) != run["settings"].task.names:
            raise ConfigError("the description of the run has other axes than its settings")
        Controller(model, run["settings"], run["servos"])
    if run["config"] is not None:
        json.loads(run["config"])


def _columns(run: dict[str, Any], ticks: list[Any]) -> dict[str, Array]:
    """Return the arrays of all ticks."""
    n, axes = len(run["joints"]), run["axes"]
    vector = layout.tick(n, None if axes is None else len(axes), len(run["extra"]))
    out: dict[str, Array] = {}
    for name, length in vector.pieces:
        values: Array = np.full((len(ticks), length), np.nan)
        for row, message in zip(values, ticks, strict=True):
            value = getattr(message, name)
            if not hasattr(value, "__len__"):
                row[0] = value
            elif len(value):
                row[:] = value
        shape: tuple[int, ...] = (-1, length)
        if name in {"target", "reference"}:
            shape = (-1, 4, 4)
        elif name == "activation":
            shape = (-1, n, length // n)
        elif name in layout.SINGLE:
            shape = (-1,)
        out[name] = values.reshape(len(ticks), *shape[1:])
    return out


def arguments(call: Any) -> dict[str, Any]:
    """Return the arguments of a call other than a step."""
    read = words.read(call.arguments) if call.arguments else {}
    if not (isinstance(read, dict) and all(isinstance(name, str) for name in read)):
        raise ConfigError(f"the arguments of the call {call.what!r} are no table of names")
    return read

"""Reader of logs: ticks as arrays, and calls of the controller. It also reads incomplete logs."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from mcap.records import Attachment, Channel, Message, Schema
from mcap_ros2.decoder import DecoderFactory

from pliant._core import ConfigError, Controller, Model, Servos, Settings
from pliant._files import check_regular
from pliant.log import layout, serialization
from pliant.log.records import CutShortError, DamagedError, records

if TYPE_CHECKING:
    from pliant._typing import Array


#: Fields of the description of a run: name, type, and True if the value can be None.
RUN_FIELDS: tuple[tuple[str, Any, bool], ...] = (
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


@dataclass
class Log:
    """A logged run of N ticks (control cycles) with n joints and k task axes.

    Each column is an attribute and an entry of `columns`; missing values are NaN. Columns: `time`
    (N,) [s], when the positions were sampled (0 at the beginning of the first tick); `q`, `dq`,
    `load`, `goal`, `torque_limit` (N, n); `target`, `reference` (N, 4, 4); `deviation`,
    `compliance` (N, k); `activation` (N, n, k + 1); and those listed in docs/logs.md.

    Attributes:
        run: Description of the run: joints, axes, rate, settings, servos, version, note.
        columns: Arrays of all columns by name.
        calls: Recorded calls of the controller in order, as decoded messages.
        whole: True if the file is complete and undamaged. False if the program or the machine died,
            or the file is damaged.
        damage: Description of the damage; empty if there is none. The log contains the data before
            the damage.
        end: `counters` of the bus and number of `dropped` records when the recorder was closed;
            empty if it was not closed.
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
        """Settings at the beginning of the run; None if the run had no `Controller`."""
        settings: Settings | None = self.run["settings"]
        return settings

    @property
    def servos(self) -> Servos | None:
        """Servo parameters of the run; None if there were none."""
        servos: Servos | None = self.run["servos"]
        return servos

    def model(self) -> Model:
        """Return the model of the arm, created from the recorded URDF and options."""
        return serialization.model(self.run["model"])


def read(path: str | Path) -> Log:
    """Read a log written by `Recorder`; a damaged log is read up to its last valid record.

    Raises:
        ConfigError: The path is not a file; or the file is not a log, is of another layout version,
            or ends before the first record.
        OSError: The file cannot be read.
    """
    try:
        return _read(Path(path))
    except ConfigError:  # which is a ValueError too
        raise
    except serialization.PARSE_ERRORS as error:
        kind = type(error).__name__
        raise ConfigError(f"{path} is not a log of pliant: {kind}: {error}") from error


def _read(path: Path) -> Log:
    run: dict[str, Any] | None = None
    ticks: list[Any] = []
    calls: list[Any] = []
    rows = {"/pliant/tick": ticks, "/pliant/call": calls}
    whole, damage, end = False, "", {}
    decode = _Decoder()
    check_regular(path)
    with path.open("rb") as stream:
        try:
            for record in records(stream, path.stat().st_size):
                if isinstance(record, Attachment) and record.name == layout.RUN:
                    run = serialization.read(record.data.decode())
                elif isinstance(record, Attachment) and record.name == layout.END:
                    end = serialization.read(record.data.decode())
                elif isinstance(record, Schema):
                    decode.schemas[record.id] = record
                elif isinstance(record, Channel):
                    decode.channels[record.id] = record
                elif isinstance(record, Message):
                    messages = rows.get(decode.channels[record.channel_id].topic)
                    if messages is not None:
                        messages.append(decode(record))
            whole = True
        except (CutShortError, DamagedError) as error:
            if run is None:
                short = "it ends before its first record"
                why = short if isinstance(error, CutShortError) else error
                raise ConfigError(f"{path} is not a log of pliant: {why}") from error
            damage = str(error) if isinstance(error, DamagedError) else ""
    if run is None:
        raise ConfigError(f"{path} is not a log of pliant: it has no attachment {layout.RUN!r}")
    if not isinstance(run, dict) or "version" not in run:
        raise ConfigError(f"{path} is not a log of pliant: its description has no version")
    if run["version"] != layout.VERSION:
        raise ConfigError(
            f"{path} has layout {run['version']}, this pliant reads {layout.VERSION}: read it with "
            f"pliant {run.get('pliant')}"
        )
    try:
        _check(run)
    except ConfigError as error:
        raise ConfigError(f"{path} is not a log of pliant: {error}") from error
    columns = _columns(run, ticks)
    if len(columns["time"]):
        # Shift the times so that 0 is the beginning of the first tick, as in `pliant.loop.Tick`.
        columns["time"] -= columns["time"][0] + columns["lag"][0]
    return Log(run, columns, calls, whole, end, damage)


class _Decoder:
    """Decoder of MCAP messages; it uses the schema and channel records that were read before."""

    def __init__(self) -> None:
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self._factory = DecoderFactory()
        self._decoders: dict[int, Callable[[bytes], Any]] = {}

    def __call__(self, message: Message) -> Any:
        decoder = self._decoders.get(message.channel_id)
        if decoder is None:
            channel = self.channels[message.channel_id]
            message_decoder = self._factory.decoder_for("cdr", self.schemas[channel.schema_id])
            if message_decoder is None:
                raise ConfigError(f"no decoder for {channel.topic}")
            decoder = self._decoders[message.channel_id] = message_decoder
        return decoder(message.data)


def _check(run: Any) -> None:
    """Check the fields of the description of a run.

    Raises:
        ConfigError: A field is missing, has the wrong type, or contradicts another.
    """
    if not isinstance(run, dict):
        raise ConfigError(f"the description of the run is not a table, but {type(run).__name__}")
    for name, kinds, optional in RUN_FIELDS:
        value = run.get(name)
        fits = value is None if optional and value is None else isinstance(value, kinds)
        if not fits or isinstance(value, bool):
            problem = "has no" if value is None else f"has {type(value).__name__} for"
            raise ConfigError(f"the description of the run {problem} {name!r}")
    for name in ("joints", "extra", "axes"):
        if not all(isinstance(entry, str) for entry in run[name] or ()):
            raise ConfigError(f"the description of the run has {name!r} that are not names")
    if not 0.0 < run["rate"] < math.inf:
        raise ConfigError(f"the description of the run has a rate of {run['rate']} Hz")
    model = serialization.model(run["model"])
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
    """Return the columns of a log by name: arrays with one row per message in `ticks`."""
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
    """Return the arguments, by name, of a recorded controller call that is not a step."""
    values = serialization.read(call.arguments) if call.arguments else {}
    if not (isinstance(values, dict) and all(isinstance(name, str) for name in values)):
        raise ConfigError(f"the arguments of the call {call.what!r} are not a table of names")
    return values

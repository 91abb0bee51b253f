"""Error messages for a configuration file: key, value, and allowed values."""

from __future__ import annotations

import difflib
from typing import TYPE_CHECKING, Any, get_args

from pydantic import BaseModel

from pliant.config._toml import toml_key

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from pydantic import ValidationError
    from pydantic_core import ErrorDetails


#: Remedy for a top-level key that stands in a table of the file.
AT_THE_TOP = "{} belongs at the top of the file, before its first table"


def explain(error: ValidationError, schema: type[BaseModel]) -> list[str]:
    """Return a sentence for each validation error: key, value and allowed values."""
    return list(dict.fromkeys(_sentence(detail, schema) for detail in error.errors()))


def suggest(word: str, known: Iterable[str]) -> str:
    """Return the text `did you mean 'x'? there are: ...` for an unknown word."""
    names = sorted(known)
    close = difflib.get_close_matches(word, names, n=1, cutoff=0.5)
    hint = f"did you mean {close[0]!r}? " if close else ""
    return f"{hint}there are: {', '.join(names) or 'none'}"


def _sentence(detail: ErrorDetails, schema: type[BaseModel]) -> str:
    key = _path(detail["loc"])
    kind = detail["type"]
    if kind == "extra_forbidden":
        word, *above = str(detail["loc"][-1]), *detail["loc"][:-1]
        if above and word in keys(schema, ()):
            return f"{key} is not a key here: {AT_THE_TOP.format(word)}"
        return f"{key} is not a key here; {suggest(word, keys(schema, above))}"
    if kind == "missing":
        return f"{key} is missing"
    if kind == "list_type" and isinstance(detail["input"], dict):
        return f"{key} is a list of tables: [[{key}]] in double brackets begins each of them"
    if kind == "model_type":
        known = ", ".join(sorted(keys(schema, detail["loc"])))
        return f"{key} = {_short(detail['input'])}: must be a table; its keys are {known}"
    if kind == "tuple_type":
        return f"{key} = {_short(detail['input'])}: must be a list of numbers, in brackets"
    message = detail["msg"].removeprefix("Value error, ")
    message = message[:1].lower() + message[1:]
    if kind in {"value_error", "assertion_error"}:
        return f"{key}: {message}" if key else message
    return f"{key} = {_short(detail['input'])}: {message}"


def keys(schema: type[BaseModel], path: Sequence[int | str]) -> set[str]:
    """Return the keys that the schema allows in the table at `path`."""
    table: Any = schema
    for step in path:
        if _is_model(table):
            field = _field(table, str(step))
            table = field.annotation if field is not None else None
        else:
            table = next((a for a in get_args(table) if a is not str), None)
        table = _without_none(table)
    if not _is_model(table):
        return set()
    return {field.alias or name for name, field in table.model_fields.items()}


def _field(table: type[BaseModel], name: str) -> Any:
    for key, field in table.model_fields.items():
        if name in {key, field.alias}:
            return field
    return None


def _is_model(table: Any) -> bool:
    return isinstance(table, type) and issubclass(table, BaseModel)


def _without_none(kind: Any) -> Any:
    """Return a type without None: `X` for `X | None`, any other type unchanged."""
    parts = get_args(kind)
    if type(None) in parts:
        return next((part for part in parts if part is not type(None)), None)
    return kind


def _path(location: Sequence[int | str]) -> str:
    out = ""
    for step in location:
        if isinstance(step, int):
            out += f"[{step}]"
        else:
            out += f"{'.' if out else ''}{toml_key(step)}"
    return out


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."

"""Text of keys and strings in TOML, for lines and messages that users copy into their files."""

from __future__ import annotations

import json
import re


def toml_key(name: str) -> str:
    """Return a name as a TOML key: in quotes if it has characters other than A-Z a-z 0-9 _ -."""
    return name if re.fullmatch(r"[\w-]+", name, re.ASCII) else toml_string(name)


def toml_string(text: str) -> str:
    """Return a text as a TOML string on one line, in double quotes."""
    # TOML has the escapes of JSON, but allows no surrogate pairs and no bare delete character.
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")

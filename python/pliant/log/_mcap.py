"""The one place that imports MCAP, so that a missing extra is one clear line."""

from __future__ import annotations

try:
    from mcap.exceptions import McapError
    from mcap.records import Attachment, Channel, Footer, Message, Schema
    from mcap.stream_reader import StreamReader
    from mcap_ros2.decoder import DecoderFactory
    from mcap_ros2.writer import Writer
except ImportError as error:
    from pliant.extras import missing

    raise ImportError(missing("pliant.log", "log")) from error

__all__ = [
    "Attachment",
    "Channel",
    "DecoderFactory",
    "Footer",
    "McapError",
    "Message",
    "Schema",
    "StreamReader",
    "Writer",
]

"""Imports of the MCAP libraries; if they are missing, the error contains the install command."""

from __future__ import annotations

try:
    from mcap.data_stream import ReadDataStream
    from mcap.exceptions import McapError
    from mcap.opcode import Opcode
    from mcap.records import Attachment, Channel, Chunk, McapRecord, Message, Schema, Statistics
    from mcap.stream_reader import breakup_chunk
    from mcap_ros2.decoder import DecoderFactory
    from mcap_ros2.writer import Writer
    from zstandard import ZstdError, frame_content_size
except ImportError as error:
    from pliant._extras import missing

    raise ImportError(missing("pliant.log", "log")) from error

__all__ = [
    "Attachment",
    "Channel",
    "Chunk",
    "DecoderFactory",
    "McapError",
    "McapRecord",
    "Message",
    "Opcode",
    "ReadDataStream",
    "Schema",
    "Statistics",
    "Writer",
    "ZstdError",
    "breakup_chunk",
    "frame_content_size",
]

"""Reader of MCAP records that checks all lengths, checksums and counts.

The reader of the `mcap` package trusts lengths, skips unknown records and does not check the CRCs
of attachments. With it, a damaged byte could become a wrong number in a log.
"""

from __future__ import annotations

import struct
import zlib
from io import BytesIO
from typing import TYPE_CHECKING, BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Chunk, McapRecord, Message, Statistics
from mcap.stream_reader import breakup_chunk
from zstandard import ZstdError, frame_content_size

if TYPE_CHECKING:
    from collections.abc import Iterator

#: First and last bytes of an MCAP file.
MAGIC = b"\x89MCAP0\r\n"
#: Maximum unpacked size of a chunk [bytes]; the half-second chunks of a `Recorder` are smaller.
MAX_CHUNK = 1 << 26
#: The maximum unpacked size of all chunks together is the larger of `MAX_UNPACKED` [bytes] and
#: `MAX_EXPANSION` times the size of the file.
MAX_UNPACKED, MAX_EXPANSION = 1 << 28, 200
#: Largest possible ratio of unpacked to packed size with LZ4 compression [1].
LZ4_EXPANSION = 255
_HEADER = struct.Struct("<BQ")
_CRC = struct.Struct("<I")
_OPCODES = frozenset(map(int, Opcode))


class CutShortError(Exception):
    """The file ends early; the data before the end are valid."""


class DamagedError(Exception):
    """The file is damaged; the data before the damage are valid."""


def records(stream: BinaryIO, size: int) -> Iterator[McapRecord]:
    """Yield all attachments, and all records inside chunks, in the order of the file.

    Args:
        stream: The open file, at its beginning.
        size: Size of the file [bytes].

    Raises:
        CutShortError: The file ends early.
        DamagedError: A record is damaged or missing.
    """
    if stream.read(len(MAGIC)) != MAGIC:
        raise DamagedError("it does not begin as MCAP does")
    messages = attachments = unpacked = 0
    statistics: Statistics | None = None
    for offset, opcode, body in _bodies(stream, size):
        try:
            if opcode == Opcode.CHUNK:
                chunk = Chunk.read(_stream(body))
                unpacked += _unpacked(chunk)
                if unpacked > max(MAX_UNPACKED, MAX_EXPANSION * size):
                    raise DamagedError(f"it unpacks to more than {unpacked / 1e6:.0f} MB")
                for record in breakup_chunk(chunk, validate_crc=True):
                    if isinstance(record, Message):
                        if record.sequence != messages:
                            raise DamagedError(f"message {messages} is missing")
                        messages += 1
                    yield record
            elif opcode == Opcode.ATTACHMENT:
                if _CRC.unpack(body[-_CRC.size :])[0] != zlib.crc32(body[: -_CRC.size]):
                    raise DamagedError(f"the attachment at byte {offset} has a wrong checksum")
                attachments += 1
                yield Attachment.read(_stream(body))
            elif opcode == Opcode.STATISTICS:
                statistics = Statistics.read(_stream(body))
        except (McapError, ValueError, struct.error, MemoryError, ZstdError) as error:
            raise DamagedError(f"the record at byte {offset}: {error}") from error
    if statistics is None or (statistics.message_count, statistics.attachment_count) != (
        messages,
        attachments,
    ):
        raise DamagedError("it holds other records than were counted when it was written")


def _bodies(stream: BinaryIO, size: int) -> Iterator[tuple[int, int, bytes]]:
    """Yield offset [bytes], opcode and body of every record up to the footer."""
    stream.seek(max(size - len(MAGIC), 0))
    has_end = size >= 2 * len(MAGIC) and stream.read(len(MAGIC)) == MAGIC
    stream.seek(len(MAGIC))
    opcode = None
    while opcode != Opcode.FOOTER:
        offset = stream.tell()
        header = stream.read(_HEADER.size)
        length = 0
        if len(header) == _HEADER.size:
            opcode, length = _HEADER.unpack(header)
        if len(header) < _HEADER.size or offset + _HEADER.size + length > size:
            if has_end:
                raise DamagedError(f"the record at byte {offset} is longer than the file")
            raise CutShortError(f"it ends within the record at byte {offset}")
        if opcode not in _OPCODES:
            raise DamagedError(f"the record at byte {offset} has an unknown kind, {opcode}")
        yield offset, opcode, stream.read(length)


def _unpacked(chunk: Chunk) -> int:
    """Return a bound on the unpacked size of a chunk [bytes], before unpacking it.

    It is the larger of the size in the chunk's header and the size that the packed data imply.

    Raises:
        DamagedError: The size exceeds `MAX_CHUNK`.
    """
    size = chunk.uncompressed_size
    if chunk.compression == "zstd":
        size = max(size, frame_content_size(chunk.data))
    elif chunk.compression == "lz4":
        size = max(size, LZ4_EXPANSION * len(chunk.data))
    if size > MAX_CHUNK:
        raise DamagedError(f"a chunk unpacks to {size / 1e6:.0f} MB, at most {MAX_CHUNK / 1e6:.0f}")
    return size


def _stream(body: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(body))

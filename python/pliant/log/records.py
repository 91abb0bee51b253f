"""Records of an MCAP file, with all checks that the format offers: lengths, CRCs, counts.

MCAP's own reader trusts lengths, skips unknown records and does not check the CRCs of attachments.
A damaged byte could thus become a wrong number, or an error of a library.
"""

from __future__ import annotations

import struct
import zlib
from io import BytesIO
from typing import TYPE_CHECKING, BinaryIO

from pliant.log._mcap import (
    Attachment,
    Chunk,
    McapError,
    McapRecord,
    Message,
    Opcode,
    ReadDataStream,
    Statistics,
    ZstdError,
    breakup_chunk,
    frame_content_size,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

#: First and last bytes of an MCAP file.
MAGIC = b"\x89MCAP0\r\n"
#: Largest chunk [bytes]; a recorder's holds half a second.
LARGEST_CHUNK = 1 << 26
#: Largest sum of the chunks: in bytes, or as a multiple of the file's size.
MOST_UNPACKED, RATIO = 1 << 28, 200
#: Largest expansion factor of LZ4.
LZ4_RATIO = 255
_HEAD = struct.Struct("<BQ")
_CRC = struct.Struct("<I")
_KINDS = frozenset(map(int, Opcode))


class CutShortError(Exception):
    """The file ends early; the data before the end are valid."""


class DamagedError(Exception):
    """The file is damaged; the data before the damage are valid."""


def records(stream: BinaryIO, size: int) -> Iterator[McapRecord]:
    """Yield attachments and the records of the chunks, in file order.

    Args:
        stream: The file, at its beginning.
        size: Its length [bytes].

    Raises:
        CutShortError: The file ends early.
        DamagedError: A record is damaged or missing.
    """
    if stream.read(len(MAGIC)) != MAGIC:
        raise DamagedError("it does not begin as MCAP does")
    messages = attachments = unpacked = 0
    counted: Statistics | None = None
    for place, opcode, body in _bodies(stream, size):
        try:
            if opcode == Opcode.CHUNK:
                chunk = Chunk.read(_stream(body))
                unpacked += _unpacked(chunk)
                if unpacked > max(MOST_UNPACKED, RATIO * size):
                    raise DamagedError(f"it unpacks to more than {unpacked / 1e6:.0f} MB")
                for record in breakup_chunk(chunk, validate_crc=True):
                    if isinstance(record, Message):
                        if record.sequence != messages:
                            raise DamagedError(f"message {messages} is missing")
                        messages += 1
                    yield record
            elif opcode == Opcode.ATTACHMENT:
                if _CRC.unpack(body[-_CRC.size :])[0] != zlib.crc32(body[: -_CRC.size]):
                    raise DamagedError(f"the attachment at byte {place} has another checksum")
                attachments += 1
                yield Attachment.read(_stream(body))
            elif opcode == Opcode.STATISTICS:
                counted = Statistics.read(_stream(body))
        except (McapError, ValueError, struct.error, MemoryError, ZstdError) as error:
            raise DamagedError(f"the record at byte {place}: {error}") from error
    if counted is None or (counted.message_count, counted.attachment_count) != (
        messages,
        attachments,
    ):
        raise DamagedError("it holds other records than were counted when it was written")


def _bodies(stream: BinaryIO, size: int) -> Iterator[tuple[int, int, bytes]]:
    """Yield position, kind and bytes of every record up to the footer."""
    stream.seek(max(size - len(MAGIC), 0))
    complete = size >= 2 * len(MAGIC) and stream.read(len(MAGIC)) == MAGIC
    stream.seek(len(MAGIC))
    opcode = None
    while opcode != Opcode.FOOTER:
        place = stream.tell()
        head = stream.read(_HEAD.size)
        length = 0
        if len(head) == _HEAD.size:
            opcode, length = _HEAD.unpack(head)
        if len(head) < _HEAD.size or place + _HEAD.size + length > size:
            if complete:
                raise DamagedError(f"the record at byte {place} is longer than the file")
            raise CutShortError(f"it ends within the record at byte {place}")
        if opcode not in _KINDS:
            raise DamagedError(f"the record at byte {place} is of no kind, {opcode}")
        yield place, opcode, stream.read(length)


def _unpacked(chunk: Chunk) -> int:
    """Return the unpacked size of a chunk [bytes]: the larger of its header's and its data's.

    Raises:
        DamagedError: It is larger than any chunk of a recorder.
    """
    size = chunk.uncompressed_size
    if chunk.compression == "zstd":
        size = max(size, frame_content_size(chunk.data))
    elif chunk.compression == "lz4":
        size = max(size, LZ4_RATIO * len(chunk.data))
    if size > LARGEST_CHUNK:
        raise DamagedError(
            f"a chunk unpacks to {size / 1e6:.0f} MB, at most {LARGEST_CHUNK / 1e6:.0f}"
        )
    return size


def _stream(body: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(body))

"""Frames between the loop and the process that writes: a pipe that never makes the loop wait."""

from __future__ import annotations

import os
import select
import struct
import time
from typing import IO

HEAD = struct.Struct("<BI")
#: Kinds of frames: what the run is, a tick, a step, another call, what was counted.
RUN, TICK, STEP, CALL, END = range(5)
#: Most bytes that wait for the writer; what comes while it is that far behind is dropped.
MOST = 8_000_000


class Sender:
    """The loop's end: sends what fits, keeps a bounded rest, drops and counts what is beyond.

    Attributes:
        dropped: Frames that were not sent.
        broken: Whether the writer is gone.
    """

    def __init__(self, descriptor: int, most: int = MOST) -> None:
        """Make the pipe one that does not wait."""
        os.set_blocking(descriptor, False)
        self._descriptor, self._most = descriptor, most
        self._rest = bytearray()
        self.dropped, self.broken = 0, False

    def send(self, kind: int, *parts: bytes) -> bool:
        """Send a frame; return whether it will arrive."""
        size = sum(map(len, parts))
        if self.broken:
            self.dropped += 1
            return False
        if len(self._rest) + size > self._most:
            self._push()
            if len(self._rest) + size > self._most:
                self.dropped += 1
                return False
        self._rest += HEAD.pack(kind, size)
        for part in parts:
            self._rest += part
        self._push()
        return True

    def _push(self) -> None:
        """Write as much as the pipe takes now."""
        try:
            while self._rest:
                del self._rest[: os.write(self._descriptor, self._rest)]
        except BlockingIOError:
            pass
        except OSError:
            self.broken = True

    def finish(self, patience: float) -> None:
        """Send the rest, waiting for the writer, but no longer than `patience` [s]."""
        end = time.monotonic() + patience
        self._push()
        while self._rest and not self.broken and (left := end - time.monotonic()) > 0.0:
            select.select([], [self._descriptor], [], left)
            self._push()


def receive(stream: IO[bytes]) -> tuple[int, bytes] | None:
    """The next frame; None at the end, also in the middle of one."""
    head = stream.read(HEAD.size)
    if len(head) < HEAD.size:
        return None
    kind, size = HEAD.unpack(head)
    body = stream.read(size)
    return (kind, body) if len(body) == size else None

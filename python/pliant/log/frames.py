"""Frames from the loop to the writer process, by a pipe that never blocks the loop."""

from __future__ import annotations

import os
import select
import struct
import time
from typing import IO

HEAD = struct.Struct("<BI")
#: Kinds of frames: description of the run, tick, step, other call, counters at the end.
RUN, TICK, STEP, CALL, END = range(5)
#: Largest backlog for the writer [bytes]; further frames are dropped.
MOST = 8_000_000


class Sender:
    """Sending end, in the loop: sends what fits, buffers up to a bound, drops and counts the rest.

    Attributes:
        dropped: Frames that were not sent.
        broken: True if the writer has ended.
    """

    def __init__(self, descriptor: int, most: int = MOST) -> None:
        """Set the pipe to non-blocking."""
        os.set_blocking(descriptor, False)
        self._descriptor, self._most = descriptor, most
        self._rest = bytearray()
        self.dropped, self.broken = 0, False

    def send(self, kind: int, *parts: bytes) -> bool:
        """Send a frame; return False if it is dropped."""
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
        """Write as much as the pipe accepts now."""
        try:
            while self._rest:
                del self._rest[: os.write(self._descriptor, self._rest)]
        except BlockingIOError:
            pass
        except OSError:
            self.broken = True

    def finish(self, patience: float) -> None:
        """Send the backlog; wait for the writer for at most `patience` [s]."""
        end = time.monotonic() + patience
        self._push()
        while self._rest and not self.broken and (left := end - time.monotonic()) > 0.0:
            select.select([], [self._descriptor], [], left)
            self._push()


def receive(stream: IO[bytes]) -> tuple[int, bytes] | None:
    """Return the next frame; None at the end, also in the middle of a frame."""
    head = stream.read(HEAD.size)
    if len(head) < HEAD.size:
        return None
    kind, size = HEAD.unpack(head)
    body = stream.read(size)
    return (kind, body) if len(body) == size else None

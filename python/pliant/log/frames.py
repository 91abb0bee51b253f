"""Binary frames of a log: the control loop sends them to the writer by a pipe, without blocking."""

from __future__ import annotations

import os
import struct
import time
from typing import IO

#: Header of a frame: kind of the frame, and length of its body [bytes].
HEADER = struct.Struct("<BI")
#: Kinds of frames: description of the run, control cycle, call of the controller's `step`, another
#: call of the controller, counters at the end of the run.
RUN, TICK, STEP, CALL, END = range(5)
#: Maximum size of frames that wait for the writer process [bytes]; further frames are dropped.
MAX_BACKLOG = 8_000_000
#: Time between two attempts of `finish` to send frames [s]; Windows cannot wait for a pipe.
FLUSH_PERIOD = 0.005


class Sender:
    """End of the pipe in the control loop: buffers frames up to a bound, drops further ones.

    Attributes:
        dropped: Number of dropped frames.
        broken: True if the writer process has ended, so that the pipe is broken.
    """

    def __init__(self, descriptor: int, max_backlog: int = MAX_BACKLOG) -> None:
        """Create a sender for the file descriptor of a pipe, which becomes non-blocking.

        `max_backlog` is the maximum size of the buffer [bytes].
        """
        os.set_blocking(descriptor, False)
        self._descriptor, self._max_backlog = descriptor, max_backlog
        self._backlog = bytearray()
        self.dropped, self.broken = 0, False

    def send(self, kind: int, *parts: bytes) -> bool:
        """Send or buffer a frame; return False if it is dropped."""
        size = sum(map(len, parts))
        if self.broken:
            self.dropped += 1
            return False
        if len(self._backlog) + size > self._max_backlog:
            self._flush()
            if len(self._backlog) + size > self._max_backlog:
                self.dropped += 1
                return False
        self._backlog += HEADER.pack(kind, size)
        for part in parts:
            self._backlog += part
        self._flush()
        return True

    def _flush(self) -> None:
        """Write as many buffered bytes as the pipe accepts without blocking."""
        try:
            while self._backlog:
                del self._backlog[: os.write(self._descriptor, self._backlog)]
        except BlockingIOError:
            pass
        except OSError:
            self.broken = True

    def finish(self, timeout: float) -> bool:
        """Send all buffered frames, and return True if the pipe has accepted them.

        `timeout` is the longest time for which the pipe may accept nothing [s].
        """
        size, end = len(self._backlog), time.monotonic() + timeout
        self._flush()
        while self._backlog and not self.broken:
            if len(self._backlog) < size:
                size, end = len(self._backlog), time.monotonic() + timeout
            if time.monotonic() > end:
                break
            time.sleep(min(timeout, FLUSH_PERIOD))
            self._flush()
        return not self._backlog and not self.broken


def receive(stream: IO[bytes]) -> tuple[int, bytes] | None:
    """Return kind and body of the next frame; None at the end, or if the rest is incomplete."""
    header = stream.read(HEADER.size)
    if len(header) < HEADER.size:
        return None
    kind, size = HEADER.unpack(header)
    body = stream.read(size)
    return (kind, body) if len(body) == size else None

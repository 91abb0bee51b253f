"""A pseudo-terminal in place of a serial port; its path survives unplugging."""

from __future__ import annotations

import errno
import os
import shutil
import struct
import tempfile
from pathlib import Path

from pliant._core import ServoError

try:
    import fcntl
    import termios
    import tty
except ImportError:  # Windows
    fcntl = termios = tty = None  # type: ignore[assignment]

#: `struct termios2` of Linux: four flags, line, 19 characters, two speeds; and its ioctl.
_TERMIOS2, _TCGETS2 = "=4IB19B2I", 0x802C542A


class Pty:
    """One port.

    Attributes:
        path: Path for the host; a link to the present pseudo-terminal.
        master: The emulator's end, None while the port is gone.
    """

    def __init__(self, name: str) -> None:
        """Open it.

        Raises:
            ServoError: This system has no pseudo-terminals.
        """
        if termios is None:
            raise ServoError("the emulator needs pseudo-terminals, which Windows has not")
        self._folder = Path(tempfile.mkdtemp(prefix="pliant-emulator-"))
        self.path = str(self._folder / f"tty-{name}")
        self.master: int | None = None
        self._slave: int | None = None
        self.open()

    def open(self) -> None:
        """Make a fresh pseudo-terminal under the same path."""
        self.hang_up()
        # The slave stays open here; otherwise the host's first close would hang up the line.
        self.master, self._slave = os.openpty()
        os.set_blocking(self.master, False)
        tty.setraw(self._slave)
        Path(self.path).symlink_to(os.ttyname(self._slave))

    def hang_up(self) -> None:
        """Pull the cable: the host's open port fails, and the path is gone."""
        for end in (self.master, self._slave):
            if end is not None:
                os.close(end)
        self.master = self._slave = None
        Path(self.path).unlink(missing_ok=True)

    def close(self) -> None:
        """Hang up and remove the path."""
        self.hang_up()
        shutil.rmtree(self._folder, ignore_errors=True)

    def baud(self) -> int | None:
        """Return the host's speed [bit/s]; None where the system does not report it."""
        if self._slave is None:
            return None
        try:
            answer = fcntl.ioctl(self._slave, _TCGETS2, bytes(struct.calcsize(_TERMIOS2)))
        except OSError:
            return None
        return int(struct.unpack(_TERMIOS2, answer)[-1])

    def read(self) -> bytes:
        """Return the bytes from the host; may be empty."""
        if self.master is None:
            return b""
        try:
            return os.read(self.master, 65536)
        except OSError as error:
            if error.errno in {errno.EIO, errno.EAGAIN}:
                return b""
            raise

    def write(self, data: bytes) -> None:
        """Send to the host; a host that does not read loses bytes, as with a real port."""
        if self.master is not None:
            try:
                os.write(self.master, data)
            except BlockingIOError:
                return

    def mark(self, marker: bytes) -> None:
        """Put a mark behind all bytes of the host so far."""
        if self._slave is not None:
            os.write(self._slave, marker)

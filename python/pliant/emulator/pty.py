"""Pseudo-terminal in place of a serial port; unplugging does not change its path."""

from __future__ import annotations

import errno
import os
import select
import shutil
import struct
import tempfile
from contextlib import suppress
from pathlib import Path

from pliant._core import ServoError

try:
    import fcntl
    import termios
    import tty
except ImportError:  # Windows
    fcntl = termios = tty = None  # type: ignore[assignment]

#: Linux' `struct termios2` in the format of `struct` (four flags, line discipline, 19 characters,
#: two speeds), and the ioctl number TCGETS2, which reads it.
_TERMIOS2, _TCGETS2 = "=4IB19B2I", 0x802C542A


class Pty:
    """Pseudo-terminal of one port.

    Attributes:
        path: Path for the host: a symbolic link to the present pseudo-terminal.
        master: File descriptor of the emulator's end, None while the port is unplugged.
    """

    def __init__(self, name: str) -> None:
        """Open the pseudo-terminal.

        Raises:
            ServoError: This system has no pseudo-terminals.
        """
        if termios is None:
            raise ServoError("the emulator needs pseudo-terminals, which Windows lacks")
        self._folder = Path(tempfile.mkdtemp(prefix="pliant-emulator-"))
        self.path = str(self._folder / f"tty-{name}")
        self.master: int | None = None
        self._slave: int | None = None
        self.open()

    def open(self) -> None:
        """Open a new pseudo-terminal, and make the link `path` refer to it."""
        self.hang_up()
        # Keep the slave end open: otherwise the line hangs up when the host closes its port.
        self.master, self._slave = os.openpty()
        os.set_blocking(self.master, False)
        tty.setraw(self._slave)
        Path(self.path).symlink_to(os.ttyname(self._slave))

    def hang_up(self) -> None:
        """Close both ends of the pseudo-terminal: the host's open port fails, its path vanishes."""
        for end in (self.master, self._slave):
            if end is not None:
                os.close(end)
        self.master = self._slave = None
        Path(self.path).unlink(missing_ok=True)

    def close(self) -> None:
        """Close the pseudo-terminal, and remove the folder of its path."""
        self.hang_up()
        shutil.rmtree(self._folder, ignore_errors=True)

    def baud(self) -> int | None:
        """Return the baud rate that the host has set [bit/s]; None if the system hides it."""
        if self._slave is None:
            return None
        try:
            answer = fcntl.ioctl(self._slave, _TCGETS2, bytes(struct.calcsize(_TERMIOS2)))
        except OSError:
            return None
        return int(struct.unpack(_TERMIOS2, answer)[-1])

    def has_input(self) -> bool:
        """Return True if bytes from the host wait; those on the way through the kernel count."""
        return self.master is not None and bool(select.select([self.master], [], [], 0.0)[0])

    def read(self) -> bytes:
        """Return the bytes received from the host, without waiting; may be empty."""
        if self.master is None:
            return b""
        try:
            data = os.read(self.master, 65536)
        except OSError as error:
            if error.errno in {errno.EIO, errno.EAGAIN}:
                return b""
            raise
        # Clear the flag for exclusive use: the open slave end would keep it after the host was
        # killed. On a real port, the flag ends with the host.
        with suppress(OSError):
            fcntl.ioctl(self._slave or 0, termios.TIOCNXCL)
        return data

    def write(self, data: bytes) -> None:
        """Send bytes to the host; they are lost when the host's buffer is full, as on a port."""
        if self.master is not None:
            try:
                os.write(self.master, data)
            except BlockingIOError:
                return

    def mark(self, marker: bytes) -> None:
        """Append `marker` to the bytes that the host has sent; `read` returns it after them."""
        if self._slave is not None:
            os.write(self._slave, marker)

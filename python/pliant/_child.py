"""Start of child processes that share sockets with the program, on POSIX and on Windows."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import Any


def child_options(*sockets: int) -> dict[str, Any]:
    """Return arguments of `subprocess.Popen` for a process that Ctrl-C does not reach.

    Args:
        sockets: Sockets that the process inherits under the same numbers: file descriptors, on
            Windows handles.
    """
    if sys.platform == "win32":
        for handle in sockets:
            os.set_handle_inheritable(handle, True)
        start = subprocess.STARTUPINFO(lpAttributeList={"handle_list": list(sockets)})
        return {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP, "startupinfo": start}
    return {"pass_fds": sockets, "start_new_session": True}


def keep_private(socket: int) -> None:
    """Exclude an inherited socket from the child processes of this process."""
    if sys.platform == "win32":
        os.set_handle_inheritable(socket, False)
    else:
        os.set_inheritable(socket, False)

"""Child process of tests/test_child.py: reports its sockets, then waits for an answer.

It sends two characters, "1" or "0". The first is "1" if its own children would inherit the socket,
the second if it has inherited the other end too. Exit code 0: the answer was "."; 7: the socket was
closed.
"""

import os
import socket
import sys

from pliant._processes import take_socket

number, other = map(int, sys.argv[1:])
handle = take_socket(number)
inherits = os.get_inheritable if os.name == "posix" else os.get_handle_inheritable
pipe = socket.socket(fileno=handle)
pipe.sendall(b"1" if inherits(handle) else b"0")
try:
    socket.socket(fileno=other).detach()
    pipe.sendall(b"1")
except OSError:
    pipe.sendall(b"0")
sys.exit({b".": 0, b"": 7}[pipe.recv(1)])

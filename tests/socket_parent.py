"""Program of tests/test_child.py: starts `socket_child` and waits for Ctrl-C."""

import socket
import sys
import time

from pliant._processes import start_module, take_socket

with socket.socket(fileno=take_socket(int(sys.argv[1]))) as pipe:
    process = start_module("socket_child", pipe, "9999")
try:
    time.sleep(60)
except KeyboardInterrupt:
    sys.exit(process.wait())

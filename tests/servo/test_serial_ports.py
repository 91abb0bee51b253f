"""Serial ports of Windows, with a registry of the test's own."""

import contextlib
import sys
from types import SimpleNamespace

from pliant.servo import serial_ports


def registry(values):
    """Return a module `winreg` whose key of serial ports has these values; None: no such key."""

    def open_key(root, path):
        assert (root, path) == ("machine", r"HARDWARE\DEVICEMAP\SERIALCOMM")
        if values is None:
            raise FileNotFoundError
        return contextlib.nullcontext("key")

    return SimpleNamespace(
        HKEY_LOCAL_MACHINE="machine",
        OpenKey=open_key,
        QueryInfoKey=lambda key: (0, len(values), 0),
        EnumValue=lambda key, i: (f"\\Device\\Serial{i}", values[i], 1),
    )


def test_ports_come_from_the_registry(monkeypatch):
    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.setitem(sys.modules, "winreg", registry(["COM7", "COM3"]))
    assert serial_ports() == ("COM3", "COM7")


def test_a_machine_that_never_had_a_port(monkeypatch):
    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.setitem(sys.modules, "winreg", registry(None))
    assert serial_ports() == ()

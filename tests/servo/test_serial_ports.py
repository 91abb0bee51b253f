"""Serial ports of Linux and of Windows, with a simulated registry; dropped ports."""

import contextlib
import os
import sys
from types import SimpleNamespace

import pytest

from pliant.servo import serial_ports, transport
from pliant.servo.transport import drop_port


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


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no paths of ports")
def test_an_adapter_is_listed_once_by_its_stable_name(tmp_path, monkeypatch):
    for name in ("ttyACM0", "ttyUSB1"):
        (tmp_path / name).touch()
    stable = tmp_path / "serial" / "by-id" / "usb-1a86_USB_Single_Serial-if00"
    stable.parent.mkdir(parents=True)
    stable.symlink_to("../../ttyACM0")
    find = transport.glob
    monkeypatch.setattr(transport, "glob", lambda path: find(path.replace("/dev", str(tmp_path))))
    assert serial_ports() == (str(stable), str(tmp_path / "ttyUSB1"))


@pytest.mark.pty
def test_a_dropped_port_is_the_null_device_and_not_inherited():
    ends = os.openpty()
    before = set(os.listdir("/dev/fd"))
    drop_port(os.ttyname(ends[1]))
    assert os.fstat(ends[1]).st_rdev == os.stat(os.devnull).st_rdev
    assert os.fstat(ends[0]).st_rdev != os.stat(os.devnull).st_rdev
    assert not os.get_inheritable(ends[1])
    assert set(os.listdir("/dev/fd")) == before
    for end in ends:
        os.close(end)

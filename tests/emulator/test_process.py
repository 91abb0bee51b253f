"""`EmulatorProcess`: an emulator in a child process."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from emulator.helpers import Host, le16, p1, without_extra

from pliant import ConfigError, ServoError
from pliant.emulator import Device, Emulator, EmulatorProcess


@pytest.fixture(scope="module")
def remote():
    with EmulatorProcess(Emulator, [Device("STS3215", 1)], clock="steps") as emulator:
        yield emulator


def test_the_process_replies_and_executes_commands(remote):
    with Host(remote.port) as host:
        os.write(host.fd, p1(0xFE, 3, 48, *le16(321)))
        remote.call("advance", 0.05)
    assert remote.call("time") == pytest.approx(0.05)
    (write,) = remote.call("log.writes", "torque_limit")
    assert write.values == {"torque_limit": 321}


def test_errors_come_back(remote):
    with pytest.raises(ConfigError, match="no fault 'x'"):
        remote.call("faults.inject", "x")
    with pytest.raises(ServoError, match="AttributeError"):
        remote.call("nothing")


def test_a_failing_factory_gives_the_reason():
    with pytest.raises(ConfigError, match="at least one"):
        EmulatorProcess(Emulator, [])


def test_a_missing_extra_keeps_its_message():
    with pytest.raises(ImportError, match=r'^pliant\.sim needs the extra "sim": \S.* install'):
        EmulatorProcess(without_extra)


def test_killed_it_hangs_up():
    emulator = EmulatorProcess(Emulator, [Device("STS3215", 1)])
    folder = Path(emulator.port).parent
    with Host(emulator.port) as host:
        emulator.kill()
        with pytest.raises(OSError, match="Input/output"):
            os.write(host.fd, b"x")
    with pytest.raises(ServoError, match="gone"):
        emulator.call("time")
    emulator.stop()
    assert not folder.exists()

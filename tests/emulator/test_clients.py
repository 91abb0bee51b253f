"""The makers' SDKs and other installed drivers as clients of the emulator's pseudo-terminal."""

from __future__ import annotations

import pytest

pytest.importorskip("rustypot", reason="needs the extra servo")
pytest.importorskip("dynamixel_sdk", reason="needs the vendors' SDKs of the extra test")
pytest.importorskip("scservo_sdk", reason="needs the vendors' SDKs of the extra test")

import dynamixel_sdk as dxl
import rustypot
import scservo_sdk as scs
from emulator.helpers import le16, le32

from pliant.emulator import Device, Emulator

BAUD = 1_000_000
IDS = [1, 2, 3]


def bus(model, **registers):
    devices = [Device(model, id, **registers) for id in IDS]
    return Emulator(devices, clock="steps")


@pytest.fixture
def open_sdk(monkeypatch):
    """Open a port with a vendor's SDK, with a timeout for a busy machine, and close it."""
    ports = []

    def open_port(sdk, path):
        monkeypatch.setattr(sdk.port_handler, "LATENCY_TIMER", 1000.0)
        port = sdk.PortHandler(path)
        assert port.openPort()
        assert port.setBaudRate(BAUD)
        ports.append(port)
        return port

    yield open_port
    for port in ports:
        port.closePort()


def goals(servos):
    return [servo.get("goal_position") for servo in servos]


def test_rustypot_sts():
    with bus("STS3215") as emulator:
        host = rustypot.Sts3215PyController(emulator.port, BAUD, 2.0)
        assert all(host.ping(id) for id in IDS)
        host.sync_write_raw_data(IDS, 42, [[*le16(2100), 0, 0, 0, 0, *le16(500)]] * 3)
        answers = host.sync_read_raw_data_with_error(IDS, 42, 8)
        assert [bytes(data)[:2] for data, _ in answers] == [bytes(le16(2100))] * 3
        emulator.advance(0.5)
        position = host.read_raw_data_with_error(1, 56, 2)
        assert int.from_bytes(bytes(position[0]), "little") == pytest.approx(2100, abs=6)
        assert host.write_raw_data_with_error(1, 40, [0]) == 0
        assert not emulator.servo(1).enabled
        host.close()


def test_rustypot_p1():
    with Emulator([Device("EX-106+", 1), Device("RX-64", 2), Device("MX-64", 3)]) as emulator:
        host = rustypot.MxPyController(emulator.port, BAUD, 2.0)
        host.sync_write_raw_data(IDS, 30, [[*le16(600), *le16(0), *le16(700)]] * 3)
        assert [bytes(host.read_raw_data(id, 30, 6)) for id in IDS] == [
            bytes([*le16(600), *le16(0), *le16(700)])
        ] * 3
        host.set_timeout(0.05)
        with pytest.raises(RuntimeError, match="timed out"):
            host.sync_read_raw_data(IDS, 36, 2)
        assert not host.ping(9)
        host.close()


@pytest.mark.parametrize("fast", [False, True])
def test_rustypot_p2(fast):
    with bus("XM430-W350", operating_mode=5) as emulator:
        host = rustypot.Xl430PyController(emulator.port, BAUD, 2.0)
        host.set_fast_sync_read(fast)
        assert host.write_raw_data_with_error(1, 64, [1]) == 0
        host.sync_write_raw_data(IDS, 102, [list(le16(150))] * 3)
        host.sync_write_raw_data(IDS, 116, [list(le32(2100))] * 3)
        answers = host.sync_read_raw_data_with_error(IDS, 116, 4)
        assert [bytes(data) for data, _ in answers] == [bytes(le32(2100))] * 3
        assert host.write_raw_data_with_error(1, 11, [3]) == 7
        assert host.write_raw_data_with_error(1, 102, list(le16(1200))) == 4
        assert host.reboot(1)
        emulator.advance(0.4)
        assert bytes(host.read_raw_data(1, 64, 1)) == b"\0"
        instructions = {transaction.instruction for transaction in emulator.log}
        assert ("fast_sync_read" in instructions) == fast
        host.close()


def test_dynamixel_sdk_p1(open_sdk):
    with bus("MX-28") as emulator:
        port, packets = open_sdk(dxl, emulator.port), dxl.PacketHandler(1.0)
        assert packets.ping(port, 2) == (29, dxl.COMM_SUCCESS, 0)
        assert packets.write2ByteTxRx(port, 1, 34, 300) == (dxl.COMM_SUCCESS, 0)
        assert packets.read2ByteTxRx(port, 1, 34) == (300, dxl.COMM_SUCCESS, 0)
        assert packets.write2ByteTxRx(port, 1, 34, 2000) == (dxl.COMM_SUCCESS, 8)
        assert packets.regWriteTxRx(port, 1, 30, 2, list(le16(1500))) == (dxl.COMM_SUCCESS, 0)
        assert packets.action(port, 0xFE) == dxl.COMM_SUCCESS
        write = dxl.GroupSyncWrite(port, packets, 30, 6)
        for id in (2, 3):
            assert write.addParam(id, [*le16(1600), *le16(100), *le16(400)])
        assert write.txPacket() == dxl.COMM_SUCCESS
        emulator.sync()
        assert goals(emulator.servos) == [1500, 1600, 1600]


def test_dynamixel_sdk_p2(open_sdk):
    with bus("XM430-W350", operating_mode=5) as emulator:
        port, packets = open_sdk(dxl, emulator.port), dxl.PacketHandler(2.0)
        assert packets.ping(port, 1) == (1020, dxl.COMM_SUCCESS, 0)
        assert packets.write1ByteTxRx(port, 1, 64, 1) == (dxl.COMM_SUCCESS, 0)
        assert packets.write1ByteTxRx(port, 1, 11, 3) == (dxl.COMM_SUCCESS, 7)
        write = dxl.GroupSyncWrite(port, packets, 102, 18)
        for id in IDS:
            block = [*le16(100), *le32(0), *le32(0), *le32(0), *le32(2300)]
            assert write.addParam(id, block)
        assert write.txPacket() == dxl.COMM_SUCCESS
        reader = dxl.GroupSyncRead(port, packets, 116, 4)
        for id in IDS:
            assert reader.addParam(id)
        for transfer in (reader.txRxPacket, reader.fastSyncRead):
            assert transfer() == dxl.COMM_SUCCESS
            assert [reader.getData(id, 116, 4) for id in IDS] == [2300] * 3
        bulk = dxl.GroupBulkRead(port, packets)
        assert bulk.addParam(1, 144, 2)
        assert bulk.addParam(2, 146, 1)
        assert bulk.txRxPacket() == dxl.COMM_SUCCESS
        assert (bulk.getData(1, 144, 2), bulk.getData(2, 146, 1)) == (120, 25)
        group = dxl.GroupBulkWrite(port, packets)
        assert group.addParam(2, 116, 4, list(le32(2222)))
        assert group.addParam(3, 65, 1, [1])
        assert group.txPacket() == dxl.COMM_SUCCESS
        emulator.sync()
        assert goals(emulator.servos) == [2300, 2222, 2300]
        assert emulator.servo(3).get("led") == 1
        assert packets.reboot(port, 1) == (dxl.COMM_SUCCESS, 0)


def test_dynamixel_sdk_p2_broadcast_ping(open_sdk):
    with bus("XL430-W250") as emulator:
        port, packets = open_sdk(dxl, emulator.port), dxl.PacketHandler(2.0)
        servos, result = packets.broadcastPing(port)
        assert result == dxl.COMM_SUCCESS
        assert servos == {id: [1060, 46] for id in IDS}


def test_feetech_sdk(open_sdk):
    with bus("STS3215") as emulator:
        port, packets = open_sdk(scs, emulator.port), scs.PacketHandler(0)
        assert packets.ping(port, 1) == (777, scs.COMM_SUCCESS, 0)
        assert packets.write2ByteTxRx(port, 1, 48, 450) == (scs.COMM_SUCCESS, 0)
        assert packets.read2ByteTxRx(port, 1, 48) == (450, scs.COMM_SUCCESS, 0)
        write = scs.GroupSyncWrite(port, packets, 42, 8)
        for id in IDS:
            assert write.addParam(id, [*le16(2200), 0, 0, 0, 0, *le16(300)])
        assert write.txPacket() == scs.COMM_SUCCESS
        reader = scs.GroupSyncRead(port, packets, 42, 8)
        for id in IDS:
            assert reader.addParam(id)
        assert reader.txRxPacket() == scs.COMM_SUCCESS
        assert [reader.getData(id, 42, 2) for id in IDS] == [2200] * 3
        assert [reader.getData(id, 48, 2) for id in IDS] == [300] * 3


def test_a_stale_answer_reaches_a_driver_that_retries_at_once():
    # A driver that does not drain the line after a timeout takes the late reply to the first
    # request for the reply to the second.
    with bus("STS3215") as emulator:
        host = rustypot.Sts3215PyController(emulator.port, BAUD, 0.05)
        emulator.faults.inject("late", 1)
        with pytest.raises(RuntimeError, match="timed out"):
            host.read_raw_data(1, 56, 2)
        emulator.servo(1).shaft.angle += 1.0
        host.set_timeout(2.0)
        stale = int.from_bytes(bytes(host.read_raw_data(1, 56, 2)), "little")
        assert stale == 2048
        assert emulator.servo(1).position == pytest.approx(2700, abs=1)
        host.close()

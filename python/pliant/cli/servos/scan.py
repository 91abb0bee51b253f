"""`pliant servos scan`: find the servos on all ports, at all baud rates, with their ids."""

from __future__ import annotations

from pliant._core import ConfigError, ServoError
from pliant.cli._console import Console, make_table, print_line
from pliant.cli._flags import Device
from pliant.servo import serial_ports
from pliant.servo.scan import ALL, BAUDRATES, USUAL, ScannedServo, scan


def run(*, port: Device = None, baud: int | None = None, deep: bool = False) -> None:
    """Find servos by asking every id at every common baud rate, in both protocols; write nothing.

    Args:
        port: Serial port. Default: all ports of this machine.
        baud: Baud rate [bit/s]. Default: all common ones.
        deep: Ask all 253 ids instead of 0 to 40.
    """
    if baud is not None and baud <= 0:
        raise ConfigError(f"--baud must be above 0 bit/s, got {baud}")
    ports = serial_ports() if port is None else (port,)
    if not ports:
        raise ServoError(
            "there is no serial port on this machine: plug the adapter in; on Linux it appears as "
            "/dev/ttyUSB0 or /dev/ttyACM0, and `lsusb` shows it"
        )
    console, scanned = Console(), list[ScannedServo]()
    with console.status("") as status:
        for path in ports:
            try:
                scanned += scan(
                    path,
                    baudrates=BAUDRATES if baud is None else (baud,),
                    ids=ALL if deep else USUAL,
                    progress=status.update,
                )
            except ServoError as error:
                if len(ports) == 1:
                    raise
                print_line(f"{error}", console)
    if not scanned:
        raise ServoError(
            f"no servo answers on {', '.join(ports)}: is the servos' power on, is the cable in?"
            + ("" if deep else " `pliant servos scan --deep` asks all ids")
        )
    _show(console, scanned)


def _show(console: Console, scanned: list[ScannedServo]) -> None:
    for port in dict.fromkeys(servo.port for servo in scanned):
        console.print(port, highlight=False, soft_wrap=True)
        table = make_table("id", "model", "bit/s", "protocol", "note", right={"id"})
        for servo in (servo for servo in scanned if servo.port == port):
            speed, protocol = str(servo.baudrate), f"{servo.protocol[1]}.0"
            table.add_row(str(servo.id), _model(servo), speed, protocol, servo.note)
        console.print(table)


def _model(servo: ScannedServo) -> str:
    """Return the model name; for models with the same number, the common start of their names."""
    if len(servo.models) > 1:
        return f"{servo.models[0].partition('-')[0]} (one of {len(servo.models)} variants)"
    if servo.models:
        return servo.models[0]
    return "?" if servo.number is None else f"number {servo.number}"

"""Latency of replies on the emulated bus: wire, servo delays, USB adapter."""

from __future__ import annotations

from dataclasses import dataclass

from pliant._core import ConfigError

#: Payload of one USB packet of a full-speed FTDI adapter [bytes].
USB_PACKET = 62


@dataclass(frozen=True, kw_only=True)
class Timing:
    """Latencies between servos and host; by default there are none.

    Attributes:
        wire: True: each byte takes the time of ten bits at the baud rate, and servos delay their
            replies. False: both take no time.
        turnaround: Delay of a reply in addition to the register Return Delay Time [s].
        usb_latency: Latency timer of the adapter [s], which delays short replies. The default of
            an FTDI adapter is 0.016, often set to 0.001; 0: an adapter without latency timer.
    """

    wire: bool = False
    turnaround: float = 30e-6
    usb_latency: float = 0.0

    def __post_init__(self) -> None:
        """Raise `ConfigError` unless all attributes are valid."""
        for name in ("turnaround", "usb_latency"):
            value = getattr(self, name)
            if not 0.0 <= value < 1.0:
                raise ConfigError(f"Timing.{name} must be in [0, 1) s, got {value!r}")

    @property
    def off(self) -> bool:
        """True if there are no latencies."""
        return not self.wire and self.usb_latency == 0.0

    def span(self, length: int, baud: int) -> float:
        """Return the time that `length` bytes take on the wire [s] at `baud` [bit/s]."""
        return 10.0 * length / baud if self.wire else 0.0

    def deliveries(self, packets: list[tuple[float, float, bytes]]) -> list[tuple[float, bytes]]:
        """Return the portions of the replies that reach the host: time of arrival [s] and bytes.

        Args:
            packets: Start and end of each reply on the wire [s], and its bytes.
        """
        if self.usb_latency == 0.0:
            return [(end, data) for _, end, data in packets]
        arrivals = [
            (begin + (end - begin) * (k + 1) / len(data), byte)
            for begin, end, data in packets
            for k, byte in enumerate(data)
        ]
        out: list[tuple[float, bytes]] = []
        for start in range(0, len(arrivals), USB_PACKET):
            part = arrivals[start : start + USB_PACKET]
            full = len(part) == USB_PACKET
            when = part[-1][0] if full else max(part[-1][0], part[0][0] + self.usb_latency)
            out.append((when, bytes(byte for _, byte in part)))
        return out

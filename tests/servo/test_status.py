"""Error messages for status bytes: rejected instructions, and alerts without a rejection."""

from pliant.servo import get_model
from pliant.servo._status import conditions, hardware, refusal

STS, P1, X = (get_model(name).family for name in ("STS3215-7.4V", "RX-64", "XM430-W350"))


def test_feetech_bits_are_conditions_and_never_refusals():
    for status in range(256):
        assert refusal(STS, status) is None
    assert "overload" in conditions(STS, 0x20)[0]
    assert conditions(STS, 0) == ()


def test_protocol_1_tells_refusals_from_conditions():
    assert "out of range" in refusal(P1, 1 << 3)
    assert "checksum" in refusal(P1, 1 << 4)
    assert refusal(P1, 1 << 5) is None
    overload = conditions(P1, 1 << 5 | 1 << 3)
    assert len(overload) == 1
    assert "pliant servos setup" in overload[0]


def test_every_bit_of_protocol_1_is_a_refusal_or_a_condition():
    refusals = {1: "outside its angle limits", 3: "out of range", 4: "checksum", 6: "instruction"}
    for bit in range(7):
        text = refusal(P1, 1 << bit)
        assert (text is not None) is (bit in refusals)
        assert refusals.get(bit, "") in (text or "")
        assert bool(conditions(P1, 1 << bit)) is (bit not in refusals)


def test_protocol_2_has_a_number_and_an_alert():
    assert "locked while torque is on" in refusal(X, 0x07)
    assert "above the servo's own limit" in refusal(X, 0x86)
    assert refusal(X, 0x80) is None
    assert conditions(X, 0x80)
    assert conditions(X, 0x07) == ()
    assert [text[:8] for text in hardware(1 << 5 | 1 << 2)] == ["too hot:", "overload"]

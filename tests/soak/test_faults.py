"""Some rows of the table in docs/faults.md; `python -m experiments.faults` measures all rows."""

from __future__ import annotations

import pytest

pytest.importorskip("mujoco", reason="the arm behind the servos needs the extra sim")
pytest.importorskip("rustypot", reason="the bus needs the extra servo")
pytest.importorskip("pydantic", reason="the configurations need the extra config")

from experiments.faults import FAULT_CASES, WHEN, run_fault

BY_TITLE = {case.title: case for case in FAULT_CASES}
#: Reply timeout of cases in which every servo replies, long enough for a busy computer [s].
BUSY = 0.3
#: Name of a row of the table, and the reaction of the arm.
POWERED = {
    "one reply with a wrong checksum": "goes on",
    "a policy returns NaN for goals": "is lowered",
    "the line is shorted for 1 s": "is lowered",
    "the firmware does not take the elbow's limit": "is lowered",
}


def test_there_are_twenty_and_more():
    assert len(FAULT_CASES) >= 20
    assert len(BY_TITLE) == len(FAULT_CASES)


def jumped(shift=0.0):
    """Let the target jump while a hand holds the tool.

    `shift` [s] is the time within a tick at which the hand takes hold.
    """
    case = BY_TITLE["the target jumps by 1 m for 1 s, back"]
    return run_fault(case, held=True, when=WHEN + shift, patience=BUSY)


def throws_neither_the_arm_nor_a_hand(found):
    assert found.ending == "goes on"
    assert found.speed < 0.4
    # The bound grows with the speed of the joints, so the force has one of its own.
    assert 5.0 < found.force <= found.allowed
    assert found.force < 12.0


def test_a_target_that_jumps_throws_neither_the_arm_nor_a_hand_and_repeats_to_the_bit():
    found = jumped()
    throws_neither_the_arm_nor_a_hand(found)
    assert found == jumped()


@pytest.mark.parametrize("title", POWERED)
def test_an_arm_with_power_and_host_stays_up(title):
    found = run_fault(BY_TITLE[title])
    assert found.ending == POWERED[title]
    assert found.drop < 0.002
    assert found.speed < 0.02
    assert found.lowered < 0.2


def test_without_a_host_a_hand_meets_no_more_than_the_report_says():
    found = run_fault(BY_TITLE["SIGKILL"], held=True)
    assert found.ending == "keeps its last order"
    assert 5.0 < found.force <= found.allowed


def test_an_arm_whose_servos_restarted_does_not_get_up_by_itself():
    found = run_fault(BY_TITLE["brown-out: all servos reboot"])
    assert "torque went off" in found.reason
    assert not found.torque
    assert found.drop > 0.1


# The worst case depends on where within a tick the hand takes hold.
@pytest.mark.full
@pytest.mark.parametrize("shift", [0.002, 0.004, 0.006, 0.008])
def test_a_jump_at_another_time_within_a_tick_is_no_worse(shift):
    throws_neither_the_arm_nor_a_hand(jumped(shift))


@pytest.mark.full
def test_a_run_without_a_fault_repeats_to_the_bit():
    runs = [run_fault(BY_TITLE["no fault"], held=True, patience=BUSY) for _ in range(2)]
    assert runs[0] == runs[1]


@pytest.mark.full
@pytest.mark.parametrize("title", [m.title for m in FAULT_CASES if m.state != "no torque"])
def test_no_hand_feels_more_than_is_allowed(title):
    found = run_fault(BY_TITLE[title], held=True)
    assert found.force <= found.allowed

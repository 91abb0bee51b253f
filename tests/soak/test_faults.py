"""Reactions of an emulated arm to faults of bus, servos, host and policy.

The faults are some rows of the table in docs/faults.md, which `python -m experiments.faults`
measures. Attributes of an outcome such as `drop` [m], `speed` and `lowered` [m/s] are those of
`FaultResult`.
"""

from __future__ import annotations

import pytest

pytest.importorskip("mujoco", reason="the arm behind the servos needs the extra sim")
pytest.importorskip("rustypot", reason="the bus needs the extra servo")
pytest.importorskip("pydantic", reason="the configurations need the extra config")

from experiments.faults import FAULT_CASES, WHEN, run_fault

BY_TITLE = {case.title: case for case in FAULT_CASES}
#: Reply timeout for cases in which every servo replies, long enough for a busy computer [s].
REPLY_TIMEOUT = 0.3
#: Rows of the table in which servos and host keep power, with the reaction of the arm.
POWERED = {
    "one reply with a wrong checksum": "goes on",
    "a policy returns NaN for goals": "is lowered",
    "the line is shorted for 1 s": "is lowered",
    "the firmware does not take the elbow's limit": "is lowered",
}


def test_the_table_has_at_least_20_different_cases():
    assert len(FAULT_CASES) >= 20
    assert len(BY_TITLE) == len(FAULT_CASES)


def run_jump(shift=0.0):
    """Return the outcome of a jump of the target by 1 m while a hand holds the tool.

    `shift` [s] is the time within a tick at which the hand takes hold.
    """
    case = BY_TITLE["the target jumps by 1 m for 1 s, back"]
    return run_fault(case, held=True, when=WHEN + shift, patience=REPLY_TIMEOUT)


def assert_harmless(outcome):
    assert outcome.ending == "goes on"
    assert outcome.speed < 0.4
    assert 5.0 < outcome.force <= outcome.allowed
    # `allowed` grows with the speed of the joints, so it does not bound the force alone.
    assert outcome.force < 12.0


def test_a_target_that_jumps_throws_neither_the_arm_nor_a_hand_and_repeats_to_the_bit():
    outcome = run_jump()
    assert_harmless(outcome)
    assert outcome == run_jump()


@pytest.mark.parametrize("title", POWERED)
def test_an_arm_with_power_and_host_goes_on_or_is_lowered(title):
    outcome = run_fault(BY_TITLE[title])
    assert outcome.ending == POWERED[title]
    assert outcome.drop < 0.002
    assert outcome.speed < 0.02
    assert outcome.lowered < 0.2


def test_without_a_host_a_hand_meets_no_more_than_the_report_says():
    outcome = run_fault(BY_TITLE["SIGKILL"], held=True)
    assert outcome.ending == "keeps its last order"
    assert 5.0 < outcome.force <= outcome.allowed


def test_an_arm_whose_servos_restarted_does_not_get_up_by_itself():
    outcome = run_fault(BY_TITLE["brown-out: all servos reboot"])
    assert "torque went off" in outcome.reason
    assert not outcome.torque
    assert outcome.drop > 0.1


# The worst case depends on where within a tick the hand takes hold.
@pytest.mark.full
@pytest.mark.parametrize("shift", [0.002, 0.004, 0.006, 0.008])
def test_a_jump_at_another_time_within_a_tick_is_no_worse(shift):
    assert_harmless(run_jump(shift))


@pytest.mark.full
def test_a_run_without_a_fault_repeats_to_the_bit():
    runs = [run_fault(BY_TITLE["no fault"], held=True, patience=REPLY_TIMEOUT) for _ in range(2)]
    assert runs[0] == runs[1]


@pytest.mark.full
@pytest.mark.parametrize("title", [m.title for m in FAULT_CASES if m.state != "no torque"])
def test_no_hand_feels_more_than_is_allowed(title):
    outcome = run_fault(BY_TITLE[title], held=True)
    assert outcome.force <= outcome.allowed

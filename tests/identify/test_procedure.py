"""`Procedure` and `run_procedure`: they run in any loop and restore the settings."""

import numpy as np
import pytest

import pliant
from pliant import Command
from pliant.identify import Procedure, run_procedure


class Still:
    """Minimal arm that reaches each goal one tick later."""

    def __init__(self, n=2):
        self.q, self.sent = np.zeros(n), []

    def read(self):
        return self

    def write(self, goal, limit):
        self.sent.append((goal, limit))

    def advance(self):
        self.q = np.array(self.sent[-1][0])


def counting(ticks, log):
    def start(q):
        try:
            for k in range(ticks):
                q = yield Command(q + 1.0, np.ones(2))
                log.append(k)
            return q
        finally:
            log.append("put back")

    return start


def test_positions_are_passed_and_the_last_command_is_kept():
    log = []
    procedure = Procedure(counting(3, log), 2)
    orders = [procedure.step([float(k), 0.0]).goal[0] for k in range(5)]
    assert orders == [1.0, 2.0, 3.0, 3.0, 3.0]
    assert procedure.done
    np.testing.assert_array_equal(procedure.result, [3.0, 0.0])
    assert log == [0, 1, 2, "put back"]


def test_drive_runs_an_arm_that_advances():
    arm = Still()
    result = run_procedure(arm, Procedure(counting(4, []), 2))
    np.testing.assert_array_equal(result, [4.0, 4.0])
    assert len(arm.sent) == 5  # four steps; the last command is sent twice


def test_settings_are_restored_when_the_arm_fails():
    log = []

    class Failing(Still):
        def advance(self):
            raise pliant.ServoTimeoutError("gone")

    with pytest.raises(pliant.ServoTimeoutError):
        run_procedure(Failing(), Procedure(counting(3, log), 2))
    assert log == ["put back"]


def test_a_loop_that_ends_first_is_an_error():
    log = []
    with pytest.raises(pliant.ServoError, match="ended before"):
        run_procedure(Still(), Procedure(counting(3, log), 2), loop=[])
    assert log == []


@pytest.mark.parametrize("q", [[np.nan, 0.0], 1.0, [[0.0]]])
def test_bad_positions_are_refused_before_anything_moves(q):
    procedure = Procedure(counting(3, []), 2)
    with pytest.raises(pliant.ShapeError):
        procedure.step(q)
    assert procedure.step([0.0, 0.0]).goal[0] == 1.0


def test_there_is_no_result_before_the_end():
    procedure = Procedure(counting(3, []), 2)
    procedure.step([0.0, 0.0])
    with pytest.raises(pliant.ConfigError, match="no result yet"):
        _ = procedure.result

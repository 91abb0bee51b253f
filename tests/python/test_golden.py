"""The golden cases (Pinocchio and NumPy) through the functions and through the controller."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import pliant

GOLDEN = Path(__file__).resolve().parents[1] / "data" / "golden"
TOLERANCE = 1e-10


def _cases():
    raw = json.loads((GOLDEN / "golden.json").read_text(encoding="utf-8"))
    return [{k: np.array(v) if isinstance(v, list) else v for k, v in case.items()} for case in raw]


CASES = _cases()
each_case = pytest.mark.parametrize("case", CASES, ids=range(len(CASES)))


def close(actual, expected, scale=1.0):
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=TOLERANCE * max(1.0, scale))


def pose(position, rotation):
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = rotation, position
    return out


@each_case
def test_model(case):
    model = pliant.Model.from_urdf(GOLDEN / "arm7.urdf", tip="tool")
    matrix, jacobian = model.kinematics(case["q"])
    close(matrix, pose(case["p"], case["R"]))
    close(jacobian, case["J"])
    close(model.gravity(case["q"]), case["gravity"])


@each_case
def test_functions(case):
    actual, target = pose(case["p"], case["R"]), pose(case["target_p"], case["target_R"])
    inverse = pliant.functional.damped_pseudo_inverse(case["J"], case["lam"])
    size = np.abs(case["Jp"]).max()
    close(inverse, case["Jp"], size)
    projector = pliant.functional.null_space_projector(case["J"], case["lam"], kind="paper")
    close(projector, case["N"])
    e = pliant.functional.pose_error(actual, target)
    close(e, case["d_rotvec"])

    # The reference implementation scales each component of the deviation by 1 − η. For rotations
    # about several axes, `adapt_target` does something else.
    mask = case["mask"]
    adapted = np.where(mask, (1.0 - case["eta"]) * e, e)
    error = pliant.functional.pose_error(
        actual, pliant.functional.adapt_target(actual, target, case["eta"], mask)
    )
    close(error, adapted)
    close(case["Kx"] * adapted, case["dx"])

    # The gradient of the reference has the opposite sign; A and R depend on its size only.
    gradient = -case["grad"]
    dq = inverse @ case["dx"] - case["alpha"] * projector @ gradient
    close(case["Kq"] * dq, case["dq"], np.abs(case["dq"]).max())
    shares = pliant.functional.activation(inverse, projector, gradient)
    close(shares, case["A"])
    load = pliant.functional.responsibility(inverse, case["dx"], projector, gradient, case["alpha"])
    close(load[:, :6], np.abs(inverse * case["dx"]), size)
    close(load[:, 6], case["alpha"] * np.abs(projector @ gradient))

    c = pliant.functional.compliance(adapted, case["d_minus"], case["d_plus"])
    close(c, case["c"])
    strength = pliant.functional.holding_torque(
        c, case["tau_min"], case["tau_max"], case["tau_stiff"], mask
    )
    close(strength, case["tau_x"])
    limits = pliant.functional.joint_torque_limits(shares, [*strength, case["tau_null"]])
    close(limits, case["tau_q"])


def _settings(case):
    """Return settings; the reference's `compliant_pos` yields to pushes toward -: `yields="-"`."""
    axes = {}
    for i, name in enumerate(pliant.Task().names):
        sides = bool(case["compliant_pos"][i]), bool(case["compliant_neg"][i])
        hold = float(case["tau_stiff"][i])
        letter = {(True, True): "both", (True, False): "-", (False, True): "+"}.get(sides, "none")
        axes[name] = pliant.Axis(
            soft=float(case["tau_min"][i]),
            firm=min(float(case["tau_max"][i]), hold),
            hold=hold,
            yields=letter,
            adaptation=0.0 if letter == "none" else case["eta"],
            soft_until=float(case["d_minus"][i]),
            firm_from=float(case["d_plus"][i]),
            max_velocity=float("inf"),
            soft_step_limit=float("inf"),
        )
    return pliant.Settings.paper(
        axes=axes,
        null_space=pliant.NullSpace(
            projector="paper", gain=case["alpha"], max_torque=case["tau_null"]
        ),
        tracking=pliant.Tracking(
            damping=case["lam"], gain=case["Kx"], joint_speed=[float("inf")] * 7
        ),
        paper_options=pliant.functional.PaperOptions(kq=case["Kq"], posture_weights=[0.0] * 7),
    )


@each_case
def test_controller(case):
    model = pliant.Model.from_urdf(GOLDEN / "arm7.urdf", tip="tool")
    controller = pliant.Controller(model, _settings(case))
    target = pose(case["target_p"], case["target_R"])
    command = controller.step(case["q"], target, gradient=-case["grad"])
    close(controller.diagnostics.deviation, case["d_rotvec"])
    close(controller.diagnostics.task_velocity, case["dx"])
    close(controller.diagnostics.compliance, case["c"])
    close(controller.diagnostics.gravity, case["gravity"])
    assert np.array_equal(controller.diagnostics.softness > 0.5, case["mask"])

    goal = case["q"] + 0.25 * case["dq"]
    if ((goal <= model.lower) | (goal >= model.upper)).any():
        assert controller.diagnostics.locked.any()
        return
    close((command.goal - case["q"]) / 0.25, case["dq"], np.abs(case["dq"]).max())
    close(controller.diagnostics.activation, case["A"])
    if (case["tau_max"] <= case["tau_stiff"]).all():  # `Axis` rejects other values
        close(controller.diagnostics.axis_strength, case["tau_x"])
        close(command.torque_limit, np.minimum(case["tau_q"], model.effort_limit), 10.0)


def test_some_cases_are_compared_in_full():
    model = pliant.Model.from_urdf(GOLDEN / "arm7.urdf", tip="tool")
    goals = np.array([case["q"] + 0.25 * case["dq"] for case in CASES])
    is_inside = ((goals > model.lower) & (goals < model.upper)).all(axis=1)
    assert len(CASES) == 24
    assert is_inside.sum() >= 8

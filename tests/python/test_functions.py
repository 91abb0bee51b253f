"""`pliant.functional` compared with NumPy, and properties of its functions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import pliant

sizes = st.tuples(st.integers(1, 6), st.integers(1, 16), st.integers(0, 2**32 - 1))


def jacobian(size, rank=None):
    rows, columns, seed = size
    generator = np.random.default_rng(seed)
    full = generator.normal(size=(rows, columns))
    if rank is not None:
        full = generator.normal(size=(rows, rank)) @ generator.normal(size=(rank, columns))
    return full


@given(sizes, st.sampled_from([None, 1, 2]))
def test_without_damping_it_is_numpys_pinv_at_every_rank(size, rank):
    j = jacobian(size, rank)
    expected = np.linalg.pinv(j, rcond=1e-12)
    result = pliant.functional.damped_pseudo_inverse(j, 0.0)
    np.testing.assert_allclose(result, expected, atol=1e-9 * max(1.0, np.abs(expected).max() ** 2))


@given(sizes, st.floats(1e-8, 10.0))
@example((3, 1, 1), 1e-4)  # a computation from J Jᵀ + λ²I would be wrong by 3 %
def test_damped_inverse_is_the_filtered_svd(size, damping):
    j = jacobian(size)
    u, sigma, vt = np.linalg.svd(j, full_matrices=False)
    expected = vt.T @ np.diag(sigma / (sigma**2 + damping**2)) @ u.T
    result = pliant.functional.damped_pseudo_inverse(j, damping)
    scale = max(1.0, np.abs(expected).max())
    np.testing.assert_allclose(result, expected, atol=1e-6 * scale)
    assert np.linalg.norm(result, 2) <= 0.5 / damping * (1.0 + 1e-6)


def test_a_matrix_of_zeros_has_an_inverse_of_zeros():
    for damping in (0.0, 1e-6, 0.1):
        assert not pliant.functional.damped_pseudo_inverse(np.zeros((6, 7)), damping).any()
    projector = pliant.functional.null_space_projector(np.zeros((6, 7)))
    np.testing.assert_allclose(projector, np.eye(7))


@given(sizes)
def test_projectors(size):
    j = jacobian(size)
    exact = pliant.functional.null_space_projector(j)
    condition = np.linalg.cond(j)
    if condition < 100.0:
        np.testing.assert_allclose(j @ exact, 0.0, atol=1e-9)
        np.testing.assert_allclose(exact @ exact, exact, atol=1e-9)
    np.testing.assert_allclose(exact, exact.T, atol=1e-9)
    printed = pliant.functional.null_space_projector(j, 0.1, kind="paper")
    expected = np.eye(j.shape[1]) - pliant.functional.damped_pseudo_inverse(j, 0.1) @ j
    np.testing.assert_allclose(printed, expected, atol=1e-12)


@given(sizes, st.booleans())
def test_columns_of_the_activation_are_shares(size, with_gradient):
    j = jacobian(size)
    inverse, projector = (
        pliant.functional.damped_pseudo_inverse(j, 0.05),
        pliant.functional.null_space_projector(j),
    )
    gradient = np.linspace(-1.0, 1.0, j.shape[1]) if with_gradient else None
    shares = pliant.functional.activation(inverse, projector, gradient)
    assert (shares >= 0.0).all()
    np.testing.assert_allclose(shares[:, :-1].sum(axis=0), 1.0)
    if j.shape[0] >= j.shape[1]:
        return
    np.testing.assert_allclose(shares[:, -1].sum(), 1.0)
    strength = np.arange(1.0, shares.shape[1] + 1.0)
    limits = pliant.functional.joint_torque_limits(shares, strength)
    np.testing.assert_allclose(limits, shares @ strength)
    np.testing.assert_allclose(limits.sum(), strength.sum())


def test_compliance_and_holding_torque():
    d = np.array([0.0, 0.01, 0.055, -0.055, 0.1, -3.0])
    c = pliant.functional.compliance(d, 0.01, 0.1)
    np.testing.assert_allclose(c, [1.0, 1.0, 0.5, 0.5, 0.0, 0.0], atol=1e-15)
    assert pliant.functional.compliance(0.055, 0.01, 0.1) == pytest.approx(0.5)
    assert isinstance(pliant.functional.compliance(0.055, 0.01, 0.1), float)
    mask = [True, True, True, False, True, True]
    torque = pliant.functional.holding_torque(c, 0.5, 10.0, 20.0, mask)
    np.testing.assert_allclose(torque, [0.5, 0.5, 5.25, 20.0, 10.0, 10.0])
    assert pliant.functional.holding_torque(0.5, 1.0, 3.0, 5.0, True) == pytest.approx(2.0)
    assert pliant.functional.holding_torque(0.5, 9.0, 3.0, 5.0, False) == 5.0
    with pytest.raises(
        pliant.OutOfRangeError, match=r"soft_until\[0\] = 0.2 is outside \[0, firm_from = 0.1\)"
    ):
        pliant.functional.compliance([0.0], 0.2, 0.1)
    with pytest.raises(pliant.OutOfRangeError, match=r"c\[0\] = 1.5"):
        pliant.functional.holding_torque(1.5, 1.0, 2.0, 3.0, True)
    with pytest.raises(pliant.ShapeError, match=r"compliant has shape \(2,\), expected \(6,\)"):
        pliant.functional.holding_torque(c, 0.5, 10.0, 20.0, [True, False])


def test_adapt_target_takes_a_key_or_flags():
    target = pliant.Pose.from_rotvec([1.0, 2.0, 3.0], [0.0, 0.0, 0.5])
    by_key = pliant.functional.adapt_target(np.eye(4), target, 0.75, "x yaw")
    by_flag = pliant.functional.adapt_target(
        np.eye(4), target, 0.75, [True, False, False, False, False, True]
    )
    np.testing.assert_array_equal(by_key, by_flag)
    np.testing.assert_allclose(
        pliant.functional.pose_error(np.eye(4), by_key),
        [0.25, 2.0, 3.0, 0.0, 0.0, 0.125],
        atol=1e-14,
    )
    everywhere = pliant.functional.adapt_target(np.eye(4), target, 1.0, True)
    np.testing.assert_allclose(everywhere, np.eye(4), atol=1e-15)
    with pytest.raises(pliant.ConfigError, match="compliant: 'q' is not an axis"):
        pliant.functional.adapt_target(np.eye(4), target, 0.5, "q")
    with pytest.raises(pliant.OutOfRangeError, match=r"eta = 1.5 is outside \[0, 1\]"):
        pliant.functional.adapt_target(np.eye(4), target, 1.5, "y")
    with pytest.raises(TypeError, match="compliant must be booleans"):
        pliant.functional.adapt_target(np.eye(4), target, 0.5, [1.0] * 6)


def test_too_large_matrices_are_refused():
    with pytest.raises(
        pliant.ShapeError, match=r"J has shape \(7, 7\), expected \(1 to 6 axes, 1 to 16"
    ):
        pliant.functional.damped_pseudo_inverse(np.eye(7), 0.1)
    with pytest.raises(pliant.ShapeError, match=r"J has shape \(6, 17\)"):
        pliant.functional.null_space_projector(np.zeros((6, 17)))
    with pytest.raises(pliant.OutOfRangeError, match="damping = -1"):
        pliant.functional.damped_pseudo_inverse(np.eye(6), -1.0)
    with pytest.raises(
        pliant.ConfigError, match=r"kind: must be one of 'exact', 'paper', got 'exakt'.*'exact'"
    ):
        pliant.functional.null_space_projector(np.eye(6), kind="exakt")

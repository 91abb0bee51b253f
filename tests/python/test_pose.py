"""`Pose`: conversions compared with closed-form solutions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import pliant
from pliant import Pose

angle = st.floats(-3.0, 3.0)
angles = st.tuples(angle, angle, angle)


def turn(axis, by):
    c, s = np.cos(by), np.sin(by)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    out = np.eye(3)
    out[i, i] = out[j, j] = c
    out[i, j], out[j, i] = -s, s
    return out


@given(angles, angles)
def test_rpy_turns_about_fixed_axes(position, rpy):
    pose = Pose.from_rpy(position, rpy)
    expected = turn(2, rpy[2]) @ turn(1, rpy[1]) @ turn(0, rpy[0])
    np.testing.assert_allclose(pose.rotation, expected, atol=1e-14)
    np.testing.assert_array_equal(pose.position, position)


@given(angles, angles)
def test_every_form_gives_the_pose_back(position, rpy):
    pose = Pose.from_rpy(position, rpy)
    for back in (
        Pose(pose.matrix),
        Pose.from_matrix(pose),
        Pose.from_wxyz(pose.position, pose.wxyz),
        Pose.from_xyzw(pose.position, pose.xyzw),
        Pose.from_rotvec(pose.position, pose.rotvec),
        pose.inverse().inverse(),
        pose @ Pose(),
        pliant.functional.as_pose(np.asarray(pose)),
    ):
        np.testing.assert_allclose(back.matrix, pose.matrix, atol=1e-13)
    assert pose.wxyz[0] >= 0.0
    assert np.linalg.norm(pose.rotvec) <= np.pi + 1e-12


@given(angles, angles)
def test_composition_is_that_of_matrices(a, b):
    first, second = Pose.from_rpy(a, b), Pose.from_rotvec(b, a)
    np.testing.assert_allclose((first @ second).matrix, first.matrix @ second.matrix, atol=1e-13)
    np.testing.assert_allclose(first.inverse().matrix, np.linalg.inv(first.matrix), atol=1e-13)


def test_as_pose():
    assert pliant.functional.as_pose([0.1, 0.2, 0.3]) == Pose.from_rpy(
        [0.1, 0.2, 0.3], [0.0, 0.0, 0.0]
    )
    assert pliant.functional.as_pose(np.eye(4)) == Pose()
    with pytest.raises(pliant.ShapeError, match="from_wxyz"):
        pliant.functional.as_pose(np.zeros(7))
    with pytest.raises(pliant.ShapeError, match=r"expected \(4, 4\) or \(3,\)"):
        pliant.functional.as_pose(np.eye(3))
    with pytest.raises(pliant.OutOfRangeError, match="quaternion: length = 2"):
        Pose.from_wxyz([0.0, 0.0, 0.0], [2.0, 0.0, 0.0, 0.0])


def test_pose_error_of_known_turns():
    actual, target = Pose.from_rotvec([1.0, 2.0, 3.0], [0.0, 0.0, 3.0]), Pose()
    np.testing.assert_allclose(
        pliant.functional.pose_error(actual, target), [-1, -2, -3, 0, 0, -3], atol=1e-14
    )
    opposite = Pose.from_rotvec([0.0, 0.0, 0.0], [0.0, 0.0, -3.0])
    shortest = pliant.functional.pose_error(actual, opposite)[5]
    assert shortest == pytest.approx(2.0 * np.pi - 6.0)


def test_arrays_of_a_pose_are_copies():
    pose = Pose()
    pose.matrix[0, 0] = 5.0
    assert pose == Pose()
    with pytest.raises(AttributeError):
        pose.matrix = np.eye(4)

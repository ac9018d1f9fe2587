"""Rotations and planar motions. Truth: the group axioms, MuJoCo's and SciPy's rotations, the matrix exponential."""

from __future__ import annotations

import casadi as ca
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation, Slerp

from wbmpc import lie

coordinates = st.floats(-3.0, 3.0, allow_nan=False)


@st.composite
def quaternions(draw: st.DrawFn) -> np.ndarray:
    q = np.array([draw(st.floats(-1, 1)) for _ in range(4)])
    norm = np.linalg.norm(q)
    return q / norm if norm > 1e-3 else np.array([1.0, 0, 0, 0])


@st.composite
def poses(draw: st.DrawFn) -> np.ndarray:
    return np.array([draw(coordinates) for _ in range(3)])


def scipy_rotation(q: np.ndarray) -> Rotation:
    return Rotation.from_quat(np.roll(q, -1))


@given(quaternions(), quaternions(), quaternions())
def test_quaternions_are_a_group(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> None:
    times, one = lie.quaternion_multiply, np.array([1.0, 0, 0, 0])
    np.testing.assert_allclose(times(times(a, b), c), times(a, times(b, c)), atol=1e-14)
    np.testing.assert_allclose(times(a, one), a, atol=0)
    np.testing.assert_allclose(times(one, a), a, atol=0)
    np.testing.assert_allclose(times(a, lie.quaternion_conjugate(a)), one, atol=1e-14)


@given(quaternions(), quaternions())
def test_product_and_matrix_equal_mujoco(a: np.ndarray, b: np.ndarray) -> None:
    product, matrix = np.zeros(4), np.zeros(9)
    mujoco.mju_mulQuat(product, a, b)
    mujoco.mju_quat2Mat(matrix, a)
    np.testing.assert_allclose(lie.quaternion_multiply(a, b), product, atol=1e-15)
    np.testing.assert_allclose(lie.quaternion_to_rotation(a), matrix.reshape(3, 3), atol=1e-14)


@given(quaternions())
def test_rotation_to_quaternion_and_back(q: np.ndarray) -> None:
    r = scipy_rotation(q).as_matrix()
    back = lie.rotation_to_quaternion(r)
    assert back[0] >= 0
    np.testing.assert_allclose(lie.quaternion_to_rotation(back), r, atol=1e-13)


@pytest.mark.parametrize("axis", np.vstack([np.eye(3), -np.eye(3)]))
def test_rotation_to_quaternion_at_half_turns(axis: np.ndarray) -> None:
    """The trace vanishes at 180 degrees, where a careless formula divides by zero."""
    r = 2 * np.outer(axis, axis) - np.eye(3)
    np.testing.assert_allclose(lie.quaternion_to_rotation(lie.rotation_to_quaternion(r)), r, atol=1e-14)


@given(quaternions())
def test_log_equals_scipy_in_numbers_and_in_symbols(q: np.ndarray) -> None:
    s = ca.SX.sym("q", 4)
    symbolic = np.array(ca.Function("log", [s], [lie.quaternion_log(s)])(q)).ravel()
    numeric, truth = lie.quaternion_log(q), scipy_rotation(q).as_rotvec()
    if abs(q[0]) > 1e-6:  # at 180 degrees both signs are right
        np.testing.assert_allclose(numeric, truth, atol=1e-9)
    np.testing.assert_allclose(symbolic, numeric, atol=1e-9)
    assert np.linalg.norm(numeric) <= np.pi + 1e-12


@pytest.mark.parametrize("w", [1.0, -1.0])
def test_log_has_its_derivative_at_the_identity(w: float) -> None:
    """Truth: log(q) = ±2 v to first order, whichever of the two signs of q stands for the identity."""
    s = ca.SX.sym("q", 4)
    jacobian = ca.Function("J", [s], [ca.densify(ca.jacobian(lie.quaternion_log(s), s))])
    np.testing.assert_allclose(np.array(jacobian([w, 0, 0, 0]))[:, 1:], 2 * w * np.eye(3), atol=1e-12)


@given(st.lists(st.floats(-1.7, 1.7), min_size=3, max_size=3))
def test_derivative_of_log_equals_differences(v: list[float]) -> None:
    q = np.roll(Rotation.from_rotvec(v).as_quat(), 1)
    s = ca.SX.sym("q", 4)
    jacobian = np.array(ca.Function("J", [s], [ca.densify(ca.jacobian(lie.quaternion_log(s), s))])(q))
    for axis in np.eye(3):  # along the group, where numbers stay unit quaternions
        turn = 0.5 * lie.quaternion_multiply(q, np.array([0.0, *axis]))
        h = 1e-6
        ahead, behind = (scipy_rotation(q) * Rotation.from_rotvec(e * h * axis) for e in (1, -1))
        np.testing.assert_allclose(jacobian @ turn, (ahead.as_rotvec() - behind.as_rotvec()) / (2 * h), atol=1e-6)


@given(quaternions())
def test_error_vector_ignores_the_sign_of_the_quaternion(q: np.ndarray) -> None:
    if abs(q[0]) > 1e-9:
        np.testing.assert_allclose(lie.quaternion_error_vector(q), lie.quaternion_error_vector(-q), atol=0)
        angle = np.linalg.norm(scipy_rotation(q).as_rotvec())
        np.testing.assert_allclose(np.linalg.norm(lie.quaternion_error_vector(q)), np.sin(angle / 2), atol=1e-7)


@given(quaternions(), quaternions(), st.floats(0, 1))
def test_slerp_equals_scipy(a: np.ndarray, b: np.ndarray, s: float) -> None:
    if abs(a @ b) < 0.05:
        return  # nearly 180 degrees apart: two shortest ways
    truth = Slerp([0, 1], Rotation.concatenate([scipy_rotation(a), scipy_rotation(b)]))(s)
    got = scipy_rotation(lie.slerp(a, b, s))
    assert (truth.inv() * got).magnitude() < 1e-6


@given(poses(), poses(), poses())
def test_se2_is_a_group(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> None:
    times = lie.se2_compose
    np.testing.assert_allclose(times(times(a, b), c), times(a, times(b, c)), atol=1e-12)
    np.testing.assert_allclose(times(a, np.zeros(3)), a, atol=1e-15)


@given(poses(), poses(), st.floats(-12, 0))
def test_se2_step_equals_the_matrix_exponential(pose: np.ndarray, twist: np.ndarray, exponent: float) -> None:
    """Small turns included, where sin(w) / w has to be expanded."""
    delta = twist * np.array([1, 1, 10**exponent])
    matrix = expm(np.array([[0, -delta[2], delta[0]], [delta[2], 0, delta[1]], [0, 0, 0]]))
    start = np.eye(3)
    start[:2, :2] = Rotation.from_euler("z", pose[2]).as_matrix()[:2, :2]
    start[:2, 2] = pose[:2]
    end = start @ matrix
    np.testing.assert_allclose(lie.se2_step(pose, delta), [*end[:2, 2], pose[2] + delta[2]], atol=1e-12)


@given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))
def test_euler_angles_equal_scipy_and_return(yaw: float, pitch: float, roll: float) -> None:
    r = lie.euler_zyx_to_rotation(yaw, pitch, roll)
    np.testing.assert_allclose(r, Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix(), atol=1e-14)
    np.testing.assert_allclose(lie.rotation_to_euler_zyx(r), [yaw, pitch, roll], atol=1e-7)


@given(quaternions(), quaternions())
def test_rotation_angle_equals_scipy(a: np.ndarray, b: np.ndarray) -> None:
    truth = (scipy_rotation(a).inv() * scipy_rotation(b)).magnitude()
    angle = lie.rotation_angle(lie.quaternion_to_rotation(a), lie.quaternion_to_rotation(b))
    np.testing.assert_allclose(angle, truth, atol=1e-6)


@settings(max_examples=100, deadline=None)
@given(*[st.floats(-3.0, 3.0) for _ in range(6)])
def test_se2_log_undoes_the_step(x: float, y: float, yaw: float, dx: float, dy: float, w: float) -> None:
    pose = np.array([x, y, yaw])
    for turns in (-1, 0, 1):
        after = lie.se2_step(pose, [dx, dy, w]) + [0.0, 0.0, 2.0 * np.pi * turns]
        np.testing.assert_allclose(lie.se2_log(pose, after), [dx, dy, w], atol=1e-9)


def test_angles_that_are_infinite_give_no_numbers() -> None:
    """As NumPy's functions, and without an exception: a simulation that diverges ends with a message of its own."""
    with np.errstate(invalid="ignore"):
        for found in (
            lie.euler_zyx_to_rotation(np.inf, 0.0, 0.0), lie.se2_step([0, 0, np.inf], [1, 0, 0]), lie.se2_exp([1, 0, np.inf]),
            lie.euler_zyx_rates(0.0, np.inf, [1, 1, 1]),
        ):  # fmt: skip
            assert np.isnan(found).any()

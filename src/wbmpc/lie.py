"""SO(3), SE(2) and quaternions (w, x, y, z): the only file that knows a quaternion's order (:data:`PARTS` for others).

Functions named ``quaternion_…`` take NumPy arrays or CasADi expressions; the others take NumPy arrays.
"""

from __future__ import annotations

import math
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from wbmpc.arrays import Array

#: Names of a quaternion's numbers, in order.
PARTS = ("w", "x", "y", "z")


def cos_sin(angle: float) -> tuple[float, float]:
    """Cosine and sine of one angle [rad]: several times as fast as NumPy's; not numbers where it is infinite."""
    try:
        return math.cos(angle), math.sin(angle)
    except ValueError:
        return math.nan, math.nan


def _stack(like: Any, *parts: Any) -> Any:
    return ca.vertcat(*parts) if isinstance(like, (ca.SX, ca.MX, ca.DM)) else np.array(parts, float)


def _symbolic(*values: Any) -> Any:
    return next((v for v in values if isinstance(v, (ca.SX, ca.MX, ca.DM))), values[0])


def quaternion_multiply(a: Any, b: Any) -> Any:
    """Hamilton product a ∘ b: the rotation b followed by a."""
    like = _symbolic(a, b)
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray) and a.ndim == b.ndim == 1:
        return np.array(_product(a.tolist(), b.tolist()))  # one by one, Python's own numbers are several times as fast
    return _stack(like, *_product(*([q[i] for i in range(4)] for q in (a, b))))


def quaternion_conjugate(q: Any) -> Any:
    """The inverse of a unit quaternion."""
    return _stack(q, q[0], -q[1], -q[2], -q[3])


def quaternion_about(axis: ArrayLike, angle: Any) -> Any:
    """The rotation by ``angle`` [rad] about a unit ``axis`` (3) of numbers."""
    given: Any = axis.tolist() if isinstance(axis, np.ndarray) else axis
    x, y, z = given
    if isinstance(angle, ca.SX):
        return ca.vertcat(ca.cos(angle / 2), *[ca.sin(angle / 2) * a if a else ca.SX(1, 1) for a in (x, y, z)])
    cosine, sine = cos_sin(angle / 2)
    return np.array([cosine, sine * x, sine * y, sine * z])


def quaternion_to_rotation(q: Any) -> Any:
    """Rotation matrix (3, 3) of a unit quaternion."""
    if isinstance(q, np.ndarray) and q.ndim == 1:
        q = q.tolist()  # one by one, Python's own numbers are several times as fast
    w, x, y, z = q[0], q[1], q[2], q[3]
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    if isinstance(q, (ca.SX, ca.MX, ca.DM)):
        return ca.vertcat(*[ca.horzcat(*r) for r in rows])
    return np.array(rows, float)


def quaternion_error_vector(q: Any) -> Any:
    """Vector part times the sign of the scalar part: ½ of the rotation vector for small rotations, flat at 180°."""
    if isinstance(q, (ca.SX, ca.MX)):
        sign: Any = ca.if_else(q[0] < 0, -1.0, 1.0)
        return sign * q[1:4]
    return (-1.0 if q[0] < 0 else 1.0) * np.asarray(q[1:4], float)


def quaternion_log(q: Any) -> Any:
    """Rotation vector [rad] of a unit quaternion, of length at most π; smooth at the identity."""
    if isinstance(q, (ca.SX, ca.MX)):
        v: Any = quaternion_error_vector(q)
        w, square = ca.fabs(q[0]), ca.dot(v, v)
        length = ca.sqrt(ca.fmax(square, 1e-12))
        # 2 asin(s) / s = 2 + s²/3 + … below 1e-6 rad, where the quotient loses its derivative
        factor = ca.if_else(square > 1e-12, 2.0 * ca.atan2(length, w) / length, 2.0 + square / 3.0)
        return factor * v
    v = quaternion_error_vector(q)
    length = math.sqrt(v.dot(v))
    return (2.0 if length < 1e-9 else 2.0 * math.atan2(length, abs(q[0])) / length) * v


def slerp(a: ArrayLike, b: ArrayLike, s: float) -> Array:
    """The rotation a share ``s`` of the shortest way from a to b (Shoemake 1985)."""
    a, b = np.asarray(a, float), np.asarray(b, float)
    v = s * quaternion_log(quaternion_multiply(quaternion_conjugate(a), b))
    angle = float(np.linalg.norm(v))
    if angle < 1e-12:
        return a.copy()
    return quaternion_multiply(a, quaternion_about(v / angle, angle))  # type: ignore[no-any-return]


def rotation_to_quaternion(r: ArrayLike) -> Array:
    """Unit quaternion of a rotation matrix, scalar part not negative (Shepperd's method)."""
    # one by one, Python's own numbers are several times as fast
    (a, b, c), (d, e, f), (g, h, i) = np.asarray(r, float).tolist()
    trace = a + e + i
    largest = max(trace, a, e, i)
    if trace == largest:
        q = [1 + trace, h - f, c - g, d - b]
    elif a == largest:
        q = [h - f, 1 + a - e - i, d + b, g + c]
    elif e == largest:
        q = [c - g, b + d, 1 + e - i - a, h + f]
    else:
        q = [d - b, c + g, f + h, 1 + i - a - e]
    length = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    unit = np.array(q) / (length if q[0] >= 0.0 else -length)
    return np.asarray(unit)


def euler_zyx_to_rotation(yaw: float, pitch: float, roll: float) -> Array:
    """R = R_z(yaw) R_y(pitch) R_x(roll)."""
    (cy, sy), (cp, sp), (cr, sr) = cos_sin(yaw), cos_sin(pitch), cos_sin(roll)
    return np.array([
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr], [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ])  # fmt: skip


def rotation_to_euler_zyx(r: ArrayLike) -> Array:
    """(yaw, pitch, roll) of a rotation matrix, |pitch| < 90°."""
    (a, _, _), (d, _, _), (g, h, i) = np.asarray(r, float).tolist()
    return np.array([math.atan2(d, a), math.asin(min(max(-g, -1.0), 1.0)), math.atan2(h, i)])


def euler_zyx_rates(pitch: float, roll: float, omega: ArrayLike) -> Array:
    """Rates of (yaw, pitch, roll) [rad/s] for an angular velocity (3) in body axes, |pitch| < 90°."""
    wx, wy, wz = np.asarray(omega, float).tolist()
    (c, s), (cp, sp) = cos_sin(roll), cos_sin(pitch)
    yaw_rate = (s * wy + c * wz) / cp
    return np.array([yaw_rate, c * wy - s * wz, wx + sp * yaw_rate])


def rotation_angle(a: ArrayLike, b: ArrayLike) -> float:
    """Angle [rad] between two rotation matrices."""
    v = quaternion_log(rotation_to_quaternion(np.asarray(a).T @ np.asarray(b)))
    return math.sqrt(v.dot(v))


def se2_exp(delta: ArrayLike) -> Array:
    """Pose (x, y, yaw) reached from the origin by a constant body twist with integral ``delta`` = (dx, dy, dyaw)."""
    dx, dy, w = np.asarray(delta, float).tolist()
    # sin(w) / w and (1 − cos(w)) / w, without cancellation at small w
    s, half = _sinc(w), _sinc(0.5 * w)
    c = 0.5 * w * half * half
    return np.array([s * dx - c * dy, c * dx + s * dy, w])


def _sinc(x: float) -> float:
    """sin(x) / x, 1 at 0."""
    return cos_sin(x)[1] / x if x else 1.0


def se2_compose(a: ArrayLike, b: ArrayLike) -> Array:
    """Pose a ∘ b of SE(2) as (x, y, yaw); the yaw is not wrapped."""
    (x, y, yaw), (dx, dy, turn) = np.asarray(a, float).tolist(), np.asarray(b, float).tolist()
    c, s = cos_sin(yaw)
    return np.array([x + c * dx - s * dy, y + s * dx + c * dy, yaw + turn])


def se2_step(pose: ArrayLike, delta: ArrayLike) -> Array:
    """``pose`` moved by a body twist whose integral is ``delta``, exactly."""
    return se2_compose(pose, se2_exp(delta))


def wrapped(angle: Any) -> Any:
    """The angle (any shape) [rad] in [-π, π)."""
    return np.remainder(angle + np.pi, 2.0 * np.pi) - np.pi


def se2_log(a: ArrayLike, b: ArrayLike) -> Array:
    """Integral (dx, dy, dyaw) of the constant body twist that moves the pose ``a`` to ``b``; |dyaw| at most π."""
    a, b = np.asarray(a, float), np.asarray(b, float)
    w = float(wrapped(b[2] - a[2]))
    c, s = np.cos(a[2]), np.sin(a[2])
    x, y = c * (b[0] - a[0]) + s * (b[1] - a[1]), -s * (b[0] - a[0]) + c * (b[1] - a[1])
    half = 0.5 * w
    f = half / np.tan(half) if abs(half) > 1e-6 else 1.0 - half * half / 3.0
    return np.array([f * x + half * y, -half * x + f * y, w])


def pose_compose(a: ArrayLike, b: ArrayLike) -> Array:
    """Pose a ∘ b; poses (7) are position and quaternion."""
    x, y, z, *q = np.asarray(a, float).tolist()
    u, v, w, *p = np.asarray(b, float).tolist()
    dx, dy, dz = _turned(q, u, v, w)
    return np.array([x + dx, y + dy, z + dz, *_product(q, p)])


def pose_inverse(a: ArrayLike) -> Array:
    """The pose (7) of the world in ``a``."""
    x, y, z, qw, qx, qy, qz = np.asarray(a, float).tolist()
    back = [qw, -qx, -qy, -qz]
    dx, dy, dz = _turned(back, x, y, z)
    return np.array([-dx, -dy, -dz, *back])


def _turned(q: list[float], x: float, y: float, z: float) -> tuple[float, float, float]:
    """A vector turned by a unit quaternion, by its rotation matrix."""
    a, b, c, d = q
    return (
        (1 - 2 * (c * c + d * d)) * x + 2 * (b * c - a * d) * y + 2 * (b * d + a * c) * z,
        2 * (b * c + a * d) * x + (1 - 2 * (b * b + d * d)) * y + 2 * (c * d - a * b) * z,
        2 * (b * d - a * c) * x + 2 * (c * d + a * b) * y + (1 - 2 * (b * b + c * c)) * z,
    )


def _product(a: list[Any], b: list[Any]) -> tuple[Any, Any, Any, Any]:
    """The Hamilton product of two quaternions, of numbers or expressions."""
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3], a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1], a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )  # fmt: skip


def pose_between(a: ArrayLike, b: ArrayLike) -> Array:
    """The pose (7) of ``b`` in ``a``, both given in one frame."""
    return pose_compose(pose_inverse(a), b)

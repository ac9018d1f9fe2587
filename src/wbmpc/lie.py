"""SO(3), SE(2) and quaternions (w, x, y, z): the only file that knows a quaternion's order (:data:`PARTS` for others).

Functions named ``quaternion_…`` take NumPy arrays or CasADi expressions; the others take NumPy arrays.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
#: Names of a quaternion's numbers, in order.
PARTS = ("w", "x", "y", "z")


def _stack(like: Any, *parts: Any) -> Any:
    return ca.vertcat(*parts) if isinstance(like, (ca.SX, ca.MX, ca.DM)) else np.array(parts, float)


def _symbolic(*values: Any) -> Any:
    return next((v for v in values if isinstance(v, (ca.SX, ca.MX, ca.DM))), values[0])


def quaternion_multiply(a: Any, b: Any) -> Any:
    """Hamilton product a ∘ b: the rotation b followed by a."""
    like = _symbolic(a, b)
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray) and a.ndim == b.ndim == 1:
        a, b = a.tolist(), b.tolist()  # one by one, Python's own numbers are several times as fast
    return _stack(
        like,
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


def quaternion_conjugate(q: Any) -> Any:
    """The inverse of a unit quaternion."""
    return _stack(q, q[0], -q[1], -q[2], -q[3])


def quaternion_about(axis: ArrayLike, angle: Any) -> Any:
    """The rotation by ``angle`` [rad] about a unit ``axis`` (3) of numbers."""
    axis = np.asarray(axis, float)
    sine = ca.sin(angle / 2) if isinstance(angle, ca.SX) else np.sin(angle / 2)
    cosine = ca.cos(angle / 2) if isinstance(angle, ca.SX) else np.cos(angle / 2)
    if isinstance(angle, ca.SX):
        return ca.vertcat(cosine, *[sine * a if a else ca.SX(1, 1) for a in axis])
    return np.array([cosine, *(sine * axis)])


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
    length = float(np.linalg.norm(v))
    return (2.0 if length < 1e-9 else 2.0 * np.arctan2(length, abs(q[0])) / length) * v


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
    r = np.asarray(r, float)
    choices = np.array([np.trace(r), r[0, 0], r[1, 1], r[2, 2]])
    i = int(np.argmax(choices))
    if i == 0:
        q = np.array([1 + choices[0], r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
    else:
        a, b, c = i - 1, i % 3, (i + 1) % 3
        q = np.zeros(4)
        q[0] = r[c, b] - r[b, c]
        q[1 + a] = 1 + r[a, a] - r[b, b] - r[c, c]
        q[1 + b] = r[b, a] + r[a, b]
        q[1 + c] = r[c, a] + r[a, c]
    q /= np.linalg.norm(q)
    return -q if q[0] < 0 else q


def euler_zyx_to_rotation(yaw: float, pitch: float, roll: float) -> Array:
    """R = R_z(yaw) R_y(pitch) R_x(roll)."""
    q = quaternion_about((0, 0, 1), yaw)
    q = quaternion_multiply(
        quaternion_multiply(q, quaternion_about((0, 1, 0), pitch)), quaternion_about((1, 0, 0), roll)
    )
    return quaternion_to_rotation(q)  # type: ignore[no-any-return]


def rotation_to_euler_zyx(r: ArrayLike) -> Array:
    """(yaw, pitch, roll) of a rotation matrix, |pitch| < 90°."""
    r = np.asarray(r, float)
    pitch = np.arcsin(np.clip(-r[2, 0], -1.0, 1.0))
    return np.array([np.arctan2(r[1, 0], r[0, 0]), pitch, np.arctan2(r[2, 1], r[2, 2])])


def euler_zyx_rates(pitch: float, roll: float, omega: ArrayLike) -> Array:
    """Rates of (yaw, pitch, roll) [rad/s] for an angular velocity (3) in body axes, |pitch| < 90°."""
    wx, wy, wz = np.asarray(omega, float)
    s, c = np.sin(roll), np.cos(roll)
    yaw_rate = (s * wy + c * wz) / np.cos(pitch)
    return np.array([yaw_rate, c * wy - s * wz, wx + np.sin(pitch) * yaw_rate])


def rotation_angle(a: ArrayLike, b: ArrayLike) -> float:
    """Angle [rad] between two rotation matrices."""
    return float(np.linalg.norm(quaternion_log(rotation_to_quaternion(np.asarray(a).T @ np.asarray(b)))))


def se2_exp(delta: ArrayLike) -> Array:
    """Pose (x, y, yaw) reached from the origin by a constant body twist with integral ``delta`` = (dx, dy, dyaw)."""
    dx, dy, w = np.asarray(delta, float)
    # sin(w) / w and (1 − cos(w)) / w, without cancellation at small w
    s, c = np.sinc(w / np.pi), 0.5 * w * np.sinc(w / (2 * np.pi)) ** 2
    return np.array([s * dx - c * dy, c * dx + s * dy, w])


def se2_compose(a: ArrayLike, b: ArrayLike) -> Array:
    """Pose a ∘ b of SE(2) as (x, y, yaw); the yaw is not wrapped."""
    a, b = np.asarray(a, float), np.asarray(b, float)
    c, s = np.cos(a[2]), np.sin(a[2])
    return np.array([a[0] + c * b[0] - s * b[1], a[1] + s * b[0] + c * b[1], a[2] + b[2]])


def se2_step(pose: ArrayLike, delta: ArrayLike) -> Array:
    """``pose`` moved by a body twist whose integral is ``delta``, exactly."""
    return se2_compose(pose, se2_exp(delta))


def se2_log(a: ArrayLike, b: ArrayLike) -> Array:
    """Integral (dx, dy, dyaw) of the constant body twist that moves the pose ``a`` to ``b``; |dyaw| at most π."""
    a, b = np.asarray(a, float), np.asarray(b, float)
    w = float(np.remainder(b[2] - a[2] + np.pi, 2.0 * np.pi) - np.pi)
    c, s = np.cos(a[2]), np.sin(a[2])
    x, y = c * (b[0] - a[0]) + s * (b[1] - a[1]), -s * (b[0] - a[0]) + c * (b[1] - a[1])
    half = 0.5 * w
    f = half / np.tan(half) if abs(half) > 1e-6 else 1.0 - half * half / 3.0
    return np.array([f * x + half * y, -half * x + f * y, w])


def pose_compose(a: ArrayLike, b: ArrayLike) -> Array:
    """Pose a ∘ b; poses (7) are position and quaternion."""
    a, b = np.asarray(a, float), np.asarray(b, float)
    return np.concatenate([a[:3] + quaternion_to_rotation(a[3:]) @ b[:3], quaternion_multiply(a[3:], b[3:])])


def pose_inverse(a: ArrayLike) -> Array:
    """The pose (7) of the world in ``a``."""
    a = np.asarray(a, float)
    back = quaternion_conjugate(a[3:])
    return np.concatenate([-(quaternion_to_rotation(back) @ a[:3]), back])


def pose_between(a: ArrayLike, b: ArrayLike) -> Array:
    """The pose (7) of ``b`` in ``a``, both given in one frame."""
    return pose_compose(pose_inverse(a), b)


def poses_between(a: ArrayLike, b: ArrayLike) -> Array:
    """:func:`pose_between` of many: poses (n, 7) of ``b`` in ``a``, row by row."""
    a, b = np.asarray(a, float).T, np.asarray(b, float).T
    place = np.einsum("ijn,in->jn", quaternion_to_rotation(a[3:]), b[:3] - a[:3])
    return np.concatenate([place, quaternion_multiply(quaternion_conjugate(a[3:]), b[3:])]).T

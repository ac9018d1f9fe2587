"""Convex solids of numbers: what robots and obstacles are made of."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from wbmpc.arrays import Array

#: Kinds of a :class:`Solid`, as MuJoCo calls and sizes them.
KINDS = ("sphere", "capsule", "ellipsoid", "cylinder", "box", "mesh")
_NONE = np.zeros((0, 3))


@dataclass(frozen=True, eq=False)
class Solid:
    """A convex body in the axes of what it is fixed to.

    ``kind``: one of :data:`KINDS`.

    ``size`` (3) [m]: radius; radius and half length along z (capsule, cylinder); semi-axes; half lengths of a box, and of the box
    around a mesh. ``position`` (3) [m] of its center, ``rotation`` (3, 3) of its axes. ``vertices`` (n, 3) [m] of a mesh in its axes,
    relative to the center of the box around them.
    """

    kind: str
    size: Array
    position: Array = field(default_factory=lambda: np.zeros(3))
    rotation: Array = field(default_factory=lambda: np.eye(3))
    vertices: Array = field(default_factory=lambda: _NONE)

    @property
    def radius(self) -> float:
        """Of the sphere around its center that encloses it [m]."""
        r, h = float(self.size[0]), float(self.size[1])
        if self.kind == "mesh":
            return float(np.linalg.norm(self.vertices, axis=1).max())
        if self.kind == "box":
            return float(np.linalg.norm(self.size))
        return {"sphere": r, "capsule": r + h, "cylinder": float(np.hypot(r, h))}.get(self.kind, float(self.size.max()))

    def support(self, direction: Array) -> Array:
        """Farthest points (n, 3) [m], in its own axes about its center, along unit directions (n, 3)."""
        d, s = direction, self.size
        if self.kind == "mesh":
            return np.asarray(self.vertices[np.argmax(d @ self.vertices.T, axis=1)])
        if self.kind == "box":
            return np.where(d < 0.0, -s, s)
        if self.kind == "ellipsoid":
            scaled = d * s
            return scaled * s / np.linalg.norm(scaled, axis=1)[:, None]
        if self.kind == "sphere":
            return d * s[0]
        end = np.zeros_like(d)
        end[:, 2] = np.where(d[:, 2] < 0.0, -s[1], s[1])
        if self.kind == "capsule":
            return end + d * s[0]
        flat = np.linalg.norm(d[:, :2], axis=1)[:, None]
        end[:, :2] = s[0] * d[:, :2] / np.maximum(flat, 1e-12)
        return end

    def distance(self, points: Array) -> Array:
        """At most the distance (n) [m] of points (n, 3), in its own axes about its center, to the solid; exact outside of spheres,
        capsules, cylinders and boxes."""
        s = self.size
        if self.kind == "sphere":
            return np.asarray(np.linalg.norm(points, axis=-1) - s[0])
        if self.kind in ("capsule", "cylinder"):
            flat, up = np.hypot(points[..., 0], points[..., 1]), np.abs(points[..., 2]) - s[1]
            if self.kind == "capsule":
                return np.asarray(np.hypot(flat, np.maximum(up, 0.0)) - s[0])
            return _of_box(np.stack([flat - s[0], up], axis=-1))
        return _of_box(np.abs(points) - s)

    def moved(self, position: Array, rotation: Array) -> Solid:
        """The same solid in other axes: those it is given in are at ``position`` (3) and ``rotation`` (3, 3) of them."""
        return Solid(self.kind, self.size, position + rotation @ self.position, rotation @ self.rotation, self.vertices)


def _of_box(beyond: Array) -> Array:
    """Signed distance by how far points are beyond each pair of faces (n, k)."""
    outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=-1)
    return np.asarray(outside + np.minimum(beyond.max(axis=-1), 0.0))


def sphere(radius: float, position: Array) -> Solid:
    """A ball about ``position`` (3) [m]."""
    return Solid("sphere", np.array([radius, radius, radius]), np.asarray(position, float))


def along(kind: str, a: Array, b: Array, radius: float) -> Solid:
    """A capsule or cylinder between ``a`` and ``b`` (3) [m]."""
    half = 0.5 * float(np.linalg.norm(b - a))
    return Solid(kind, np.array([radius, half, 0.0]), 0.5 * (a + b), axes_along(b - a))


def axes_along(direction: Array) -> Array:
    """A rotation (3, 3) whose z axis is along ``direction`` (3); the identity for none."""
    length = float(np.linalg.norm(direction))
    if length < 1e-12:
        return np.eye(3)
    z = direction / length
    x = np.cross(np.eye(3)[int(np.argmin(np.abs(z)))], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def mesh(vertices: Array) -> Solid:
    """The convex hull of points (n, 3) [m]. Raises ValueError where they lie in a plane."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = vertices[ConvexHull(vertices).vertices]
    except QhullError as error:
        raise ValueError("the points lie in a plane, or are fewer than 4") from error
    low, high = hull.min(axis=0), hull.max(axis=0)
    center = 0.5 * (low + high)
    return Solid("mesh", 0.5 * (high - low), center, np.eye(3), np.ascontiguousarray(hull - center))

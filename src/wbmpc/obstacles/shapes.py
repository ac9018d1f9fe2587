"""Shapes of obstacles in their own axes, which :meth:`wbmpc.obstacles.world.Obstacles.set` places in the world. Lengths in m."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from wbmpc import checks, lie
from wbmpc.arrays import Array
from wbmpc.errors import InputError
from wbmpc.obstacles import solids
from wbmpc.obstacles.solids import Solid

__all__ = ["Box", "Capsule", "ConvexMesh", "Cylinder", "DistanceGrid", "HalfSpace", "Shape", "Sphere"]

#: Corners of a convex mesh, and cells of a grid, at most.
MAX_VERTICES, MAX_CELLS = 10_000, 50_000_000
#: Lengths [m] and speeds [m/s] of what a robot may meet: squares of larger ones are no longer distances. Less is no solid.
LARGEST, SMALLEST = 1e6, 1e-6


def _size(who: str, **values: ArrayLike) -> None:
    """Raise :class:`InputError` of ``who`` for sizes beyond :data:`LARGEST` or below :data:`SMALLEST`, by their name."""
    checks.at_most(who, LARGEST, **values)
    for name, value in values.items():
        if (np.asarray(value, float) < SMALLEST).any():
            raise InputError(f"{who}: '{name}' must be at least {SMALLEST:g}, got {str(value)[:80]}")


def _set(shape: Any, **values: Any) -> None:
    for name, value in values.items():
        object.__setattr__(shape, name, value)


@dataclass(frozen=True, eq=False)
class Sphere:
    """A ball of ``radius`` [m] about ``center`` (3) [m]."""

    radius: float
    center: ArrayLike = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        checks.positive("sphere", radius=self.radius)
        _set(self, center=checks.numbers("sphere", "center", self.center, 3))
        _size("sphere", radius=self.radius)
        checks.at_most("sphere", LARGEST, center=self.center)

    @cached_property
    def solid(self) -> Solid:
        """The same as numbers, in its own axes."""
        return solids.sphere(float(self.radius), np.asarray(self.center, float))


@dataclass(frozen=True, eq=False)
class _Along:
    """What is round about a line."""

    a: ArrayLike
    b: ArrayLike
    radius: float

    def __post_init__(self) -> None:
        who = type(self).__name__.lower()
        checks.positive(who, radius=self.radius)
        _set(self, a=checks.numbers(who, "a", self.a, 3), b=checks.numbers(who, "b", self.b, 3))
        _size(who, radius=self.radius)
        checks.at_most(who, LARGEST, a=self.a, b=self.b)

    @cached_property
    def solid(self) -> Solid:
        """The same as numbers, in its own axes."""
        kind = type(self).__name__.lower()
        return solids.along(kind, np.asarray(self.a, float), np.asarray(self.b, float), float(self.radius))


class Capsule(_Along):
    """All points within ``radius`` [m] of the line from ``a`` (3) to ``b`` (3) [m]."""


class Cylinder(_Along):
    """A cylinder of ``radius`` [m] with flat ends about ``a`` (3) and ``b`` (3) [m]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if np.linalg.norm(np.subtract(self.b, self.a)) < 1e-6:
            raise InputError("cylinder: 'a' and 'b' are the same point; valid: the centers of its two ends")


@dataclass(frozen=True, eq=False)
class Box:
    """A box with the half lengths ``half`` (3) [m] about ``center`` (3) [m], turned by ``orientation`` (4, quaternion w, x, y, z)."""

    half: ArrayLike
    center: ArrayLike = (0.0, 0.0, 0.0)
    orientation: ArrayLike = (1.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        half = checks.numbers("box", "half", self.half, 3)
        if not (half > 0.0).all():
            raise InputError(f"box: 'half' needs three positive numbers, got {half.tolist()}")
        _set(self, half=half, center=checks.numbers("box", "center", self.center, 3))
        _size("box", half=half)
        checks.at_most("box", LARGEST, center=self.center)
        _set(self, orientation=checks.unit_quaternion("box", "orientation", self.orientation))

    @cached_property
    def solid(self) -> Solid:
        """The same as numbers, in its own axes."""
        turn = lie.quaternion_to_rotation(np.asarray(self.orientation, float))
        return Solid("box", np.asarray(self.half, float), np.asarray(self.center, float), turn)


@dataclass(frozen=True, eq=False)
class HalfSpace:
    """The solid side of a plane: points p with ``normal`` · p < ``offset`` [m]; the unit vector ``normal`` (3) points to the free side."""

    normal: ArrayLike
    offset: float = 0.0

    def __post_init__(self) -> None:
        checks.finite("half-space", offset=self.offset)
        normal = checks.numbers("half-space", "normal", self.normal, 3)
        checks.at_most("half-space", LARGEST, normal=normal)
        length = float(np.linalg.norm(normal))
        if length < 1e-9:
            raise InputError("half-space: 'normal' has no direction, got zeros")
        _set(self, normal=normal / length, offset=float(self.offset) / length)
        checks.at_most("half-space", LARGEST, offset=self.offset)


@dataclass(frozen=True, eq=False)
class ConvexMesh:
    """The convex hull of ``vertices`` (n, 3) [m], which do not lie in a plane; ``solid``: the same as numbers."""

    vertices: ArrayLike
    solid: Solid = field(init=False, repr=False)

    def __post_init__(self) -> None:
        points = checks.real_numbers("convex mesh: 'vertices'", self.vertices)
        if points.ndim != 2 or points.shape[1] != 3 or not 4 <= len(points) <= MAX_VERTICES:
            raise InputError(
                f"convex mesh: 'vertices' needs 4 to {MAX_VERTICES} rows of 3 numbers, got shape {points.shape}"
            )
        if not np.isfinite(points).all():
            raise InputError("convex mesh: 'vertices' must be finite")
        checks.at_most("convex mesh", LARGEST, vertices=points)
        try:
            _set(self, vertices=points, solid=solids.mesh(points))
        except ValueError as error:
            raise InputError(f"convex mesh: 'vertices': {error}") from error
        _size("convex mesh", size=self.solid.size)


@dataclass(frozen=True, eq=False)
class DistanceGrid:
    """Distances to everything that is solid: ``values`` (nx, ny, nz) [m] at ``origin`` (3) [m] + ``cell`` [m] · (i, j, k), negative inside;
    linear in between; outside of the grid nothing is known. ``error`` [m]: subtracted from the values; default: half a cell's diagonal, the
    largest error of a transform of occupied cells.
    ``layer`` [m]: distance of cells along z where it is another one, as of a floor plan that is the same at all heights.
    """

    origin: ArrayLike
    cell: float
    values: ArrayLike
    error: float | None = None
    layer: float | None = None

    def __post_init__(self) -> None:
        layer = self.cell if self.layer is None else self.layer
        checks.positive("distance grid", cell=self.cell, layer=layer)
        error = 0.5 * np.sqrt(3.0) * self.cell if self.error is None else self.error
        checks.not_negative("distance grid", error=error)
        values = np.ascontiguousarray(checks.real_numbers("distance grid: 'values'", self.values))
        if values.ndim != 3 or min(values.shape) < 2 or values.size > MAX_CELLS:
            raise InputError(
                f"distance grid: 'values' needs three dimensions of 2 or more and {MAX_CELLS} cells at most, got {values.shape}"
            )
        ends = np.array([values.min(), values.max()])  # of millions of values, at each scan
        if not np.isfinite(ends).all():
            raise InputError("distance grid: 'values' must be finite")
        _set(self, origin=checks.numbers("distance grid", "origin", self.origin, 3), values=values, error=float(error))
        _set(self, layer=float(layer))
        _size("distance grid", cell=self.cell, layer=layer)
        checks.at_most("distance grid", LARGEST, origin=self.origin, error=error, values=ends)

    def sample(self, points: Array) -> tuple[Array, Array]:
        """Distance (n), ``error`` taken off, and its gradient (n, 3) at points (n, 3); infinite and 0 outside of the grid."""
        values, shape = np.asarray(self.values), np.array(np.shape(self.values))
        spacing = np.array([self.cell, self.cell, self.layer], float)
        place = (points - np.asarray(self.origin, float)) / spacing
        inside = ((place >= 0.0) & (place <= shape - 1)).all(axis=1)
        low = np.clip(np.floor(place).astype(int), 0, shape - 2)
        f = place - low
        corners = np.empty((len(points), 2, 2, 2))
        for i, j, k in np.ndindex(2, 2, 2):
            corners[:, i, j, k] = values[low[:, 0] + i, low[:, 1] + j, low[:, 2] + k]
        wx, wy, wz = (np.stack([1.0 - f[:, a], f[:, a]], axis=1) for a in range(3))
        slope = np.array([-1.0, 1.0])
        found = np.einsum("nijk,ni,nj,nk->n", corners, wx, wy, wz) - float(self.error or 0.0)
        gradient = np.stack([
            np.einsum("nijk,i,nj,nk->n", corners, slope, wy, wz),
            np.einsum("nijk,ni,j,nk->n", corners, wx, slope, wz),
            np.einsum("nijk,ni,nj,k->n", corners, wx, wy, slope),
        ], axis=1) / spacing  # fmt: skip
        return np.where(inside, found, np.inf), np.where(inside[:, None], gradient, 0.0)


Shape = Sphere | Capsule | Cylinder | Box | HalfSpace | ConvexMesh | DistanceGrid

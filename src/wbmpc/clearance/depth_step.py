"""How deep two convex solids that touch are inside of each other, compiled: a polytope within the difference of their cores grows where
it is nearest to the origin, until that face is one of the difference (the expanding polytope algorithm: van den Bergen 2001).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wbmpc.clearance.compilation import compiled
from wbmpc.clearance.pairs_step import Body, Gaps
from wbmpc.clearance.simplex_step import Work, triangle
from wbmpc.clearance.support_step import Kind, Solids, core_radius, support
from wbmpc.kernel.ir import Floats, Integers

#: Corners of a polytope at most, and faces: a closed one of triangles has two for each corner, less four.
CORNERS = 80
FACES = 2 * CORNERS
#: A face that is so near [m] to the difference is one of it; corners so far [m] beyond a face see it.
ENOUGH, BEYOND = 1e-7, 1e-11
#: Steps after that, where it is round.
POLISHED = 60
#: Where the numbers of an axis of a point begin.
X, Y, Z = 0, 1, 2


class Hull(NamedTuple):
    """The polytope."""

    corner: Floats  # (CORNERS, 3) [m], of the difference
    corner_own: Floats  # (CORNERS, 3) [m], of the first solid, from its center
    face: Integers  # (FACES, 3), corners, counterclockwise from outside
    plane: Floats  # (FACES, 4), unit normal and distance of the origin [m]
    edge: Integers  # (3 FACES, 2)


@compiled
def put_corner(solids: Solids, a: Body, b: Body, hull: Hull, i: int, x: float, y: float, z: float) -> float:
    """The farthest point of the difference of two solids along a direction becomes corner ``i``; how far it is along that."""
    ax, ay, az = support(solids, a.solid, a.axes, a.turn, x, y, z)
    bx, by, bz = support(solids, b.solid, b.axes, b.turn, -x, -y, -z)
    corner, own, pa, pb = hull.corner, hull.corner_own, a.at, b.at
    own[3 * i], own[3 * i + 1], own[3 * i + 2] = ax, ay, az
    corner[3 * i] = ax - bx - (b.place[pb] - a.place[pa])
    corner[3 * i + 1] = ay - by - (b.place[pb + 1] - a.place[pa + 1])
    corner[3 * i + 2] = az - bz - (b.place[pb + 2] - a.place[pa + 2])
    return corner[3 * i] * x + corner[3 * i + 1] * y + corner[3 * i + 2] * z


@compiled
def normal_of(hull: Hull, i: int, j: int, k: int) -> tuple[float, float, float]:
    """Across the triangle of three corners, of unit length; zeros where they are in a line."""
    p = hull.corner
    bx, by, bz = p[3 * j] - p[3 * i], p[3 * j + 1] - p[3 * i + 1], p[3 * j + 2] - p[3 * i + 2]
    cx, cy, cz = p[3 * k] - p[3 * i], p[3 * k + 1] - p[3 * i + 1], p[3 * k + 2] - p[3 * i + 2]
    x, y, z = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    length = np.sqrt(x * x + y * y + z * z)
    share = 1.0 / length if length > 1e-14 else 0.0
    return share * x, share * y, share * z


@compiled
def put_face(hull: Hull, f: int, i: int, j: int, k: int) -> None:
    """Face ``f`` of three corners. One that they do not span is infinitely far: it is never the nearest, nor seen."""
    face, plane, p = hull.face, hull.plane, hull.corner
    x, y, z = normal_of(hull, i, j, k)
    face[3 * f], face[3 * f + 1], face[3 * f + 2] = i, j, k
    plane[4 * f], plane[4 * f + 1], plane[4 * f + 2] = x, y, z
    level = p[3 * i] * x + p[3 * i + 1] * y + p[3 * i + 2] * z
    plane[4 * f + 3] = level if x * x + y * y + z * z > 0.5 else np.inf


@compiled
def widen(solids: Solids, a: Body, b: Body, hull: Hull, i: int, x: float, y: float, z: float) -> None:
    """Corner ``i``: the one of the two farthest along a direction, and against it, that is farther from corner 0."""
    p, own = hull.corner, hull.corner_own
    level = p[X] * x + p[Y] * y + p[Z] * z
    one = put_corner(solids, a, b, hull, i, x, y, z) - level
    two = put_corner(solids, a, b, hull, i + 1, -x, -y, -z) + level
    if two > one:
        for c in range(3):
            p[3 * i + c], own[3 * i + c] = p[3 * i + 3 + c], own[3 * i + 3 + c]


@compiled
def start_hull(solids: Solids, a: Body, b: Body, hull: Hull) -> int:
    """A tetrahedron of four corners; how many faces."""
    p = hull.corner
    put_corner(solids, a, b, hull, 0, 1.0, 0.0, 0.0)
    put_corner(solids, a, b, hull, 1, -1.0, 0.0, 0.0)
    x, y, z = p[3] - p[X], p[4] - p[Y], p[5] - p[Z]
    # across the first two, which differ along x: (x, y, z) × (0, 1, 0)
    length = np.sqrt(x * x + z * z)
    widen(solids, a, b, hull, 2, -z / length, 0.0, x / length)
    x, y, z = normal_of(hull, 0, 1, 2)
    widen(solids, a, b, hull, 3, x, y, z)
    above = (p[9] - p[X]) * x + (p[10] - p[Y]) * y + (p[11] - p[Z]) * z > 0.0
    j, k = 2 if above else 1, 1 if above else 2
    put_face(hull, 0, 0, j, k)
    put_face(hull, 1, 0, 3, j)
    put_face(hull, 2, j, 3, k)
    put_face(hull, 3, k, 3, 0)
    return 4


@compiled
def nearest_face(hull: Hull, faces: int) -> int:
    """The face whose plane is nearest to the origin, or farthest beyond it."""
    found = 0
    for f in range(faces):
        if hull.plane[4 * f + 3] < hull.plane[4 * found + 3]:
            found = f
    return found


@compiled
def toggle_edge(edge: Integers, edges: int, i: int, j: int) -> int:
    """Put an edge into the list, or take out the same one of the face on its other side; how many edges there are then."""
    for e in range(edges):
        if edge[2 * e] == j and edge[2 * e + 1] == i:
            edge[2 * e], edge[2 * e + 1] = edge[2 * edges - 2], edge[2 * edges - 1]
            return edges - 1
    edge[2 * edges], edge[2 * edges + 1] = i, j
    return edges + 1


@compiled
def grow(hull: Hull, faces: int, new: int) -> int:
    """Faces that the corner ``new`` sees give way to faces up to it; how many there are then. As many as before: it sees none, or there is
    no room."""
    face, plane, p, edges, f, left = hull.face, hull.plane, hull.corner, 0, 0, faces
    x, y, z = p[3 * new], p[3 * new + 1], p[3 * new + 2]
    while f < left:
        if plane[4 * f] * x + plane[4 * f + 1] * y + plane[4 * f + 2] * z - plane[4 * f + 3] <= BEYOND:
            f += 1
            continue
        for c in range(3):
            edges = toggle_edge(hull.edge, edges, face[3 * f + c], face[3 * f + (c + 1) % 3])
        left -= 1
        for c in range(3):
            face[3 * f + c] = face[3 * left + c]
        for c in range(4):
            plane[4 * f + c] = plane[4 * left + c]
    for e in range(edges):
        if left < FACES:
            put_face(hull, left, hull.edge[2 * e], hull.edge[2 * e + 1], new)
            left += 1
    return left


@compiled
def across_lines(solids: Solids, a: Body, b: Body) -> tuple[float, float, float]:
    """A unit vector across two cores that are points or lines, from the second solid's center to the first one's side."""
    pa, pb, ra, rb = a.at, b.at, a.turn, b.turn
    one = 1.0 if solids.kind[a.solid] == Kind.CAPSULE else 0.0
    two = 1.0 if solids.kind[b.solid] == Kind.CAPSULE else 0.0
    ax, ay, az = one * a.axes[ra + 2], one * a.axes[ra + 5], one * a.axes[ra + 8]
    bx, by, bz = two * b.axes[rb + 2], two * b.axes[rb + 5], two * b.axes[rb + 8]
    x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    if x * x + y * y + z * z < 1e-12:  # lines along each other, or one: across it
        lx, ly, lz = ax if one > 0.0 else bx, ay if one > 0.0 else by, az if one > 0.0 else bz
        flat = lx * lx + ly * ly > 1e-3
        x, y, z = ly if flat else 0.0, -lx if flat else -lz, 0.0 if flat else ly
    if x * x + y * y + z * z < 1e-12:  # two points
        z = 1.0
    length = np.sqrt(x * x + y * y + z * z)
    away = (
        x * (a.place[pa] - b.place[pb])
        + y * (a.place[pa + 1] - b.place[pb + 1])
        + z * (a.place[pa + 2] - b.place[pb + 2])
    )
    length = -length if away < 0.0 else length
    return x / length, y / length, z / length


@compiled
def polish(solids: Solids, a: Body, b: Body, hull: Hull, work: Floats) -> float:
    """Of round solids, whose difference the polytope has not reached: turn ``Work.V`` by steps down the gradient, whose lengths follow from
    whether the depth falls."""
    p, last, trial, v = hull.corner, 3 * (CORNERS - 2), CORNERS - 1, int(Work.V)
    x, y, z = -work[v], -work[v + 1], -work[v + 2]
    deep = put_corner(solids, a, b, hull, CORNERS - 2, x, y, z)
    step = 1.0 / max(deep, ENOUGH)
    for _ in range(POLISHED):
        gx, gy, gz = p[last] - deep * x, p[last + 1] - deep * y, p[last + 2] - deep * z
        tx, ty, tz = x - step * gx, y - step * gy, z - step * gz
        length = np.sqrt(tx * tx + ty * ty + tz * tz)
        tx, ty, tz = tx / length, ty / length, tz / length
        found = put_corner(solids, a, b, hull, trial, tx, ty, tz)
        if found >= deep:
            step *= 0.25
            continue
        step, deep, x, y, z = 2.0 * step, found, tx, ty, tz
        for c in range(3):
            p[last + c], hull.corner_own[last + c] = p[3 * trial + c], hull.corner_own[3 * trial + c]
    work[v], work[v + 1], work[v + 2] = -x, -y, -z
    for c in range(3):
        work[Work.AT + c] = hull.corner_own[last + c]
    return deep


@compiled
def expand(solids: Solids, a: Body, b: Body, hull: Hull, work: Floats) -> float:
    """How deep two cores are inside of each other [m], of which one at least has a volume: ``Work.V`` becomes the direction in which the
    first one comes out soonest, ``Work.AT`` its deepest point, from its center."""
    faces, plane, v = start_hull(solids, a, b, hull), hull.plane, int(Work.V)
    found, deep, reached = nearest_face(hull, faces), 0.0, False
    for new in range(4, CORNERS):
        x, y, z = plane[4 * found], plane[4 * found + 1], plane[4 * found + 2]
        deep = put_corner(solids, a, b, hull, new, x, y, z)
        work[v], work[v + 1], work[v + 2] = -x, -y, -z
        for c in range(3):
            j = hull.face[3 * found + c]
            for i in range(3):
                work[3 * c + i], work[Work.OWN + 3 * c + i] = hull.corner[3 * j + i], hull.corner_own[3 * j + i]
        reached = deep - plane[4 * found + 3] <= ENOUGH
        if reached or faces + 3 > FACES:
            break
        faces = grow(hull, faces, new)
        found = nearest_face(hull, faces)
    if not reached:
        return polish(solids, a, b, hull, work)
    first, second, third = triangle(work, 0, 1, 2)
    for i in range(3):
        at = first * work[Work.OWN + i] + second * work[Work.OWN + 3 + i] + third * work[Work.OWN + 6 + i]
        work[Work.AT + i] = at
    return deep


@compiled
def depth(solids: Solids, a: Body, b: Body, hull: Hull, work: Floats) -> float:
    """Distance [m], negative, of two solids whose cores touch: see :func:`expand`."""
    radii, v = core_radius(solids, a.solid) + core_radius(solids, b.solid), int(Work.V)
    if solids.kind[a.solid] <= Kind.CAPSULE and solids.kind[b.solid] <= Kind.CAPSULE:
        work[v], work[v + 1], work[v + 2] = across_lines(solids, a, b)
        return -radii
    return -radii - expand(solids, a, b, hull, work)


@compiled
def write_depth(solids: Solids, gaps: Gaps, a: Body, d: float, i: int, work: Floats) -> None:
    """Write what :func:`depth` has found to entry ``i``, as :func:`wbmpc.clearance.pairs_step.write_gap` does a gap."""
    ra = core_radius(solids, a.solid)
    gaps.distance[i] = d
    for c in range(3):
        n = work[Work.V + c]
        gaps.normal[3 * i + c] = n
        own = a.place[a.at + c] + work[Work.AT + c] - ra * n
        gaps.own[3 * i + c], gaps.other[3 * i + c] = own, own - d * n


def hull_arrays() -> dict[str, np.ndarray]:
    """Memory of a polytope, by the names of :class:`Hull`."""
    return {
        "corner": np.zeros(3 * CORNERS), "corner_own": np.zeros(3 * CORNERS), "face": np.zeros(3 * FACES, np.int64),
        "plane": np.zeros(4 * FACES), "edge": np.zeros(6 * FACES, np.int64),
    }  # fmt: skip

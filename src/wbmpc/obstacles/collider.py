"""Nearest points of pairs of solids, by MuJoCo's collision functions on a model of shapes alone."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.obstacles.solids import Solid

_GEOMS = {
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE, "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "ellipsoid": mujoco.mjtGeom.mjGEOM_ELLIPSOID, "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "box": mujoco.mjtGeom.mjGEOM_BOX, "mesh": mujoco.mjtGeom.mjGEOM_MESH,
}  # fmt: skip
#: Solids beside the robot's for which there is room from the start.
_ROOM = 32


class Collider:
    """Solids ``own``, which stay, and others that :meth:`load` replaces. Solids are numbered in this order.

    Primitives are put into place-holders of the model, so that nothing is compiled when obstacles come and go; a mesh, and more
    obstacles than ever before, recompile it (some milliseconds).
    """

    def __init__(self, own: Sequence[Solid]) -> None:
        self._own, self._room, self._meshes = tuple(own), _ROOM, tuple[Solid, ...]()
        #: nearest points (3 and 3) [m] of the last pair, in the order in which it was asked for
        self.points = np.zeros(6)
        self._index: list[int] = list(range(len(self._own)))
        self._compile()

    def _compile(self) -> None:
        spec = mujoco.MjSpec()
        spec.compiler.balanceinertia = True
        blank = Solid("sphere", np.full(3, 0.1))
        for k, solid in enumerate([*self._own, *self._meshes, *[blank] * self._room]):
            geom = spec.worldbody.add_geom(type=_GEOMS[solid.kind], size=solid.size, contype=0, conaffinity=0)
            if solid.kind == "mesh":
                part = spec.add_mesh(name=f"mesh{k}", uservert=solid.vertices.ravel())
                part.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
                geom.meshname = part.name
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        #: where the compiler puts a mesh's axes
        self._offset = self.model.geom_pos.copy()
        self._turn = np.array([lie.quaternion_to_rotation(q.copy()) for q in self.model.geom_quat])
        self._has_offset = any(s.kind == "mesh" for s in (*self._own, *self._meshes))

    def load(self, others: Sequence[Solid]) -> None:
        """Take these solids, numbered after the robot's, in place of the last ones."""
        meshes = tuple(s for s in others if s.kind == "mesh")
        if len(meshes) != len(self._meshes) or any(a is not b for a, b in zip(meshes, self._meshes)):
            self._meshes = meshes
            self._room = max(self._room, 2 * len(others))
            self._compile()
        elif len(others) - len(meshes) > self._room:
            self._room = 2 * len(others)
            self._compile()
        own, mesh = len(self._own), len(self._own)
        free = own + len(meshes)
        self._index = list(range(own))
        for solid in others:
            if solid.kind == "mesh":
                self._index.append(mesh)
                mesh += 1
                continue
            self.model.geom_type[free], self.model.geom_size[free] = int(_GEOMS[solid.kind]), solid.size
            self._index.append(free)
            free += 1

    def place(self, centers: Array, axes: Array) -> None:
        """Put all solids to their centers (s, 3) [m] and axes (s, 3, 3)."""
        which = self._index[: len(centers)]
        if self._has_offset:
            centers = centers + np.einsum("sij,sj->si", axes, self._offset[which])
            axes = axes @ self._turn[which]
        self.data.geom_xpos[which] = centers
        self.data.geom_xmat[which] = axes.reshape(-1, 9)

    def distance(self, first: int, second: int, reach: float) -> float:
        """Distance [m] of two solids, negative inside of each other, or ``reach`` where it is more; :attr:`points` are then not set."""
        found: float = mujoco.mj_geomDistance(
            self.model, self.data, self._index[first], self._index[second], reach, self.points
        )
        return found

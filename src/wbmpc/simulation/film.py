"""Pictures of recorded scenes by MuJoCo's renderer: bodies that are put where they were."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from wbmpc.arrays import Array
from wbmpc.errors import InputError
from wbmpc.simulation.scene import Scene, Shape
from wbmpc.simulation.world import add_floor, add_light

_KINDS = {
    "box": mujoco.mjtGeom.mjGEOM_BOX, "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER, "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "ellipsoid": mujoco.mjtGeom.mjGEOM_ELLIPSOID, "mesh": mujoco.mjtGeom.mjGEOM_MESH,
}  # fmt: skip


class SceneModel:
    """A scene as a model whose bodies are free: :class:`~wbmpc.simulation.render.Drawable`, without physics."""

    def __init__(self, scene: Scene) -> None:
        spec = mujoco.MjSpec()
        # the robot comes first: a camera that follows looks at the first free joint
        self._order = [scene.index, *(i for i in range(len(scene.bodies)) if i != scene.index)]
        bodies = {"world": spec.worldbody}
        for i in self._order:
            name = scene.bodies[i].name
            body = bodies[name] = spec.worldbody.add_body(name=name)
            body.add_freejoint()
            body.explicitinertial, body.mass, body.inertia = True, 1.0, [1.0, 1.0, 1.0]
        add_floor(spec, 3, [1.0, 0.005, 1e-4], [0.02, 1.0])
        add_light(bodies[scene.robot])
        for k, shape in enumerate(scene.shapes):
            if shape.kind in _KINDS:
                _add(spec, bodies[shape.body], k, shape)
        # what shadows are computed for: the bodies all lie at the origin when the model is made
        spec.stat.extent, spec.stat.center = 4.0, [0.0, 0.0, 0.5]
        for part, value in (("ambient", 0.35), ("diffuse", 0.35), ("specular", 0.1)):
            setattr(spec.visual.headlight, part, [value] * 3)
        try:
            self.model: mujoco.MjModel = spec.compile()
        except ValueError as error:  # of shapes from a file
            raise InputError(f"a recorded scene cannot be drawn: {' '.join(str(error).split())}") from error
        self.data = mujoco.MjData(self.model)

    def place(self, poses: Array) -> None:
        """Put the bodies at poses (n, 7) in the order of the scene."""
        self.data.qpos[:] = np.asarray(poses)[self._order].ravel()
        mujoco.mj_kinematics(self.model, self.data)


def _add(spec: mujoco.MjSpec, body: Any, k: int, shape: Shape) -> None:
    more: dict[str, Any] = {}
    if shape.kind == "mesh":
        spec.add_mesh(name=f"mesh_{k}", uservert=list(shape.vertices), userface=list(shape.faces))
        more["meshname"] = f"mesh_{k}"
    else:
        more["size"] = list(shape.size)
    body.add_geom(
        type=_KINDS[shape.kind], pos=list(shape.pose[:3]), quat=list(shape.pose[3:]), rgba=list(shape.color),
        contype=0, conaffinity=0, mass=0, **more,
    )  # fmt: skip

"""A robot's bodies where a state of its model has them."""

from __future__ import annotations

from functools import cached_property

import casadi as ca
import mujoco
import numpy as np

from wbmpc.model.numeric import Numeric
from wbmpc.model.robot import RobotModel
from wbmpc.robots import load_spec
from wbmpc.robots.checks import named
from wbmpc.robots.couplings import put_followers
from wbmpc.simulation.world import Array, World, add_floor, add_light, free_body
from wbmpc.types import Edit


class ModelPicture:
    """A world of MuJoCo in which nothing moves by itself. ``edit`` adds to that scene."""

    def __init__(self, robot: RobotModel, edit: Edit | None = None) -> None:
        self.robot, self._edit = robot, edit
        s = ca.SX.sym("x", robot.state.size)
        root = robot.base.root_pose(s)
        self._root = Numeric(ca.Function("root", [s], [root.position, root.quaternion]))
        self._shown: list[tuple[int, int]] = []

    def base(self, x: Array) -> Array:
        """Pose (7) of the base at a state (nx), in the model's world."""
        position, quaternion = self._root(x)
        return np.concatenate([position.ravel(), quaternion.ravel()])

    @cached_property
    def world(self) -> World:
        description = self.robot.description
        base = description.base
        spec = load_spec(description, meshes=True)
        with named(description.model):
            add_floor(spec, 3, [0.8, 0.005, 1e-4], [0.02, 1.0])
            add_light(spec.body(base.body) if base.moves else spec.worldbody)
            if base.moves:
                free_body(spec, base.body, description.source).add_freejoint(name="root")
            if self._edit is not None:
                self._edit(spec)
        joints = {j.name for j in spec.joints}
        names = list(dict.fromkeys(n for group in self.robot.state.groups.values() for n in group if n in joints))
        world = World(spec, description, names, {})
        flat = [n for group in self.robot.state.groups.values() for n in group]
        self._shown = [(flat.index(n), int(world.model.joint(n).qposadr[0])) for n in names]
        return world

    def arrange(self, x: Array) -> None:
        """Put the bodies where a state (nx) has them."""
        world = self.world
        if self.robot.description.base.moves:
            pose = self.base(x)
            pose[2] -= self.robot.base.ground
            world.place(pose)
        for place, at in self._shown:
            world.data.qpos[at] = x[place]
        put_followers(world.model, world.data)
        mujoco.mj_forward(world.model, world.data)

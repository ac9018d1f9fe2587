"""The base type ``ball``: a robot that balances on a ball, driven by omni wheels.

What the file of a ball robot must be so that planner and simulator mean the same machine by it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import mujoco
import numpy as np

from wbmpc.bases.ball.description import BallBaseDescription
from wbmpc.bases.ball.model import BallBase, ball_base
from wbmpc.bases.base import Calibration
from wbmpc.bases.common.plugin import CommonBaseType
from wbmpc.errors import InputError
from wbmpc.model.robot import RobotModel
from wbmpc.model.tree import read_tree
from wbmpc.robots import RobotDescription

if TYPE_CHECKING:
    from wbmpc.bases.ball.controller import BallController
    from wbmpc.bases.ball.plant import BallPlant
    from wbmpc.mpc.mpc import MPC
    from wbmpc.obstacles.world import Obstacles
    from wbmpc.simulation.perturbation import Perturbation
    from wbmpc.types import Edit

#: How far [of its radius] a ball's center of mass, joint and frame may be from the origin of the base's frame.
OFF_CENTER = 1e-3
#: How much the moments of inertia of a ball may differ [of the largest], and its axes from the base's [rad].
UNEVEN, TURNED = 0.01, 1e-3


def check_ball(description: RobotDescription, model: mujoco.MjModel) -> None:
    """A ball that rolls about the origin of the base's frame, with the same inertia about every axis.

    That is what the equations of :mod:`wbmpc.bases.ball.model` and the drives of the simulator are about; a ball elsewhere would
    be lost at once. The frame is not moved to the ball: poses are published of it, and a URDF says where it is.
    Raises :class:`InputError`.
    """
    base = description.base
    assert isinstance(base, BallBaseDescription)
    name, near = base.ball, OFF_CENTER * base.ball_radius
    ball = model.body(name).id
    where = f"{description.model}: body '{name}' (key 'base.ball')"
    if int(model.body_parentid[ball]) != model.body(base.body).id:
        raise InputError(f"{where}: a ball needs to hang on the base's body '{base.body}' directly")
    kinds = [mujoco.mjtJoint(int(k)) for k in model.jnt_type[model.body_jntadr[ball] :][: model.body_jntnum[ball]]]
    if kinds != [mujoco.mjtJoint.mjJNT_BALL]:
        has = ", ".join(k.name.removeprefix("mjJNT_").lower() for k in kinds) or "none"
        raise InputError(f"{where}: one joint of type ball (spherical in a URDF) is needed, it has {has}")
    if model.jnt_limited[model.body_jntadr[ball]]:
        raise InputError(f"{where}: its joint has a range, at whose end the ball would stop: take it out of the file")
    offset = model.body_pos[ball] + model.jnt_pos[model.body_jntadr[ball]]
    if np.linalg.norm(offset) > near:
        raise InputError(
            f"{where}: the frame of '{base.body}' needs its origin at the ball's center, which is at {_meters(offset)} in it: "
            "move the frame in the file"
        )
    if 2.0 * np.arccos(min(abs(float(model.body_quat[ball][0])), 1.0)) > TURNED:
        raise InputError(f"{where}: the ball's frame needs the same axes as '{base.body}' (its shapes may be turned)")
    _check_mass(model, ball, where, near)


def _check_mass(model: mujoco.MjModel, ball: int, where: str, near: float) -> None:
    """The ball is one body, and like a ball however it is turned."""
    if model.body_subtreemass[ball] > model.body_mass[ball] * (1.0 + 1e-9):
        raise InputError(f"{where}: bodies with mass hang on it; its mass and inertia need to be in the ball itself")
    if np.linalg.norm(model.body_ipos[ball]) > near:
        raise InputError(
            f"{where}: its center of mass is at {_meters(model.body_ipos[ball])}, beside its center: such a ball rolls by itself"
        )
    inertia = model.body_inertia[ball]
    if np.ptp(inertia) > UNEVEN * inertia.max():
        numbers = ", ".join(f"{v:.4g}" for v in inertia)
        raise InputError(
            f"{where}: its moments of inertia {numbers} kg m² differ by more than {100 * UNEVEN:g} %; a ball has one"
        )


def _meters(vector: np.ndarray) -> str:
    return f"({', '.join(f'{v:g}' for v in np.round(vector, 6))}) m"


class BallBaseType(CommonBaseType):
    """What generic code may ask of bases that balance on a ball."""

    Description = BallBaseDescription
    parts: ClassVar[Mapping[str, str]] = {
        "perturbation": "bases.ball.perturbation:BallPerturbation", "plant": "bases.ball.plant:BallPlant",
        "ros_settings": "bases.ball.ros_settings:BallRosSettings", "ros": "bases.ball.ros:BallRosAdapter",
        "ros_plant": "bases.ball.ros_plant:BallRosPlant",
    }  # fmt: skip

    def check(self, description: RobotDescription, model: mujoco.MjModel) -> None:
        """The ball is one body like a ball, that turns about the origin of the base's frame."""
        check_ball(description, model)

    def model(self, description: RobotDescription, spec: mujoco.MjSpec) -> BallBase:
        base = description.base
        assert isinstance(base, BallBaseDescription)
        tree = read_tree(spec, base.body, without=(base.ball,))
        return BallBase(description, tree, read_tree(spec, base.ball).links[0])

    def plant(
        self, robot: RobotModel, perturbation: Perturbation | None, seed: int, edit: Edit | None = None
    ) -> BallPlant:
        """The simulated robot at rest in its equilibrium at home."""
        from wbmpc.bases.ball.plant import BallPlant

        state, torque = ball_base(robot).numeric.equilibrium(robot.home[robot.state["arm"]])
        return BallPlant(robot.description, state, torque, perturbation, seed, edit=edit)

    def mpc(
        self, robot: RobotModel, obstacles: Obstacles | None = None, *, progress: str | None = None, **changes: Any
    ) -> MPC:
        """Weights for steps of the end effector and for pushes. Raises :class:`InputError` for ``progress``: its controller knows plans by
        a clock alone."""
        from wbmpc.bases.ball.system import make_mpc

        if progress:
            raise InputError("ball: a path is followed by a clock; valid: reference=clock, progress=None")
        return make_mpc(robot, obstacles, **changes)

    def controller(
        self, robot: RobotModel, mpc: MPC, plant: BallPlant, period: float, calibration: Calibration | None
    ) -> BallController:
        from wbmpc.bases.ball.system import make_controller

        return make_controller(robot, mpc, period)

"""The base type ``ball``: a robot that balances on a ball, driven by omni wheels."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import mujoco

from wbmpc.bases.ball.description import BallBaseDescription
from wbmpc.bases.ball.mechanics import check_ball
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

"""The base type ``ball``: a robot that balances on a ball, driven by omni wheels."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import mujoco

from wbmpc.bases.ball.description import BallBaseDescription
from wbmpc.bases.ball.mechanics import check_ball
from wbmpc.bases.ball.model import BallBase, ball_base
from wbmpc.bases.base import BaseType, Calibration, System
from wbmpc.errors import InputError
from wbmpc.model.robot import RobotModel
from wbmpc.model.tree import read_tree
from wbmpc.robots import RobotDescription

if TYPE_CHECKING:
    from wbmpc.bases.ball.perturbation import BallPerturbation
    from wbmpc.bases.ball.plant import BallPlant
    from wbmpc.bases.ball.ros_plant import BallRosPlant
    from wbmpc.bases.ball.ros_settings import BallRosSettings
    from wbmpc.mpc.mpc import MPC
    from wbmpc.obstacles.world import Obstacles
    from wbmpc.simulation.perturbation import Perturbation
    from wbmpc.types import Edit


class BallBaseType(BaseType):
    """What generic code may ask of bases that balance on a ball."""

    Description = BallBaseDescription

    def check(self, description: RobotDescription, model: mujoco.MjModel) -> None:
        """The ball is one body like a ball, that turns about the origin of the base's frame."""
        check_ball(description, model)

    def model(self, description: RobotDescription, spec: mujoco.MjSpec) -> BallBase:
        """The full dynamics on minimal coordinates."""
        base = description.base
        assert isinstance(base, BallBaseDescription)
        tree = read_tree(spec, base.body, without=(base.ball,))
        return BallBase(description, tree, read_tree(spec, base.ball).links[0])

    def perturbation(self) -> type[BallPerturbation]:
        """Torque drives, a state sensor, cables on the floor."""
        from wbmpc.bases.ball.perturbation import BallPerturbation

        return BallPerturbation

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

    def system(
        self,
        robot: RobotModel,
        seed: int,
        perturbation: Perturbation | None = None,
        mpc: MPC | None = None,
        edit: Edit | None = None,
        calibration: Calibration | None = None,
    ) -> System:
        """A perturbed plant in its equilibrium, whose controller brings the end effector to goals that are set while it runs."""
        from wbmpc.bases.ball.system import make_system

        return make_system(robot, self.plant(robot, perturbation, seed, edit), mpc or self.mpc(robot))

    def ros_settings(self, description: RobotDescription) -> type[BallRosSettings]:
        """Weights of the ball robot's problem, and what is learned of forces."""
        from wbmpc.bases.ball.ros_settings import BallRosSettings

        return BallRosSettings

    def ros(self, robot: RobotModel, settings: Any, period: float) -> Any:
        """The adapter that reads encoders and the inertial unit and publishes torques."""
        from wbmpc.bases.ball.ros import BallRosAdapter

        return BallRosAdapter(robot, settings, period)

    def ros_plant(self, robot: RobotModel, perturbation: Perturbation | None, seed: int) -> BallRosPlant:
        """Follows torques."""
        from wbmpc.bases.ball.ros_plant import BallRosPlant

        return BallRosPlant(robot, self.plant(robot, perturbation, seed))

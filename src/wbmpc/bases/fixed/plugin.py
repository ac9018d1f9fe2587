"""The base type ``fixed``: a table, a wall or a ceiling that carries an arm."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import mujoco

from wbmpc.bases.base import BaseType, Calibration, Proposal, System
from wbmpc.bases.fixed.description import FixedBaseDescription
from wbmpc.bases.fixed.model import FixedBase
from wbmpc.model.robot import RobotModel
from wbmpc.model.tree import read_tree
from wbmpc.robots import RobotDescription

if TYPE_CHECKING:
    from wbmpc.bases.fixed.plant import FixedPlant
    from wbmpc.bases.fixed.ros import FixedRosAdapter
    from wbmpc.mpc.mpc import MPC
    from wbmpc.obstacles.world import Obstacles
    from wbmpc.robots.mechanism import Mechanism
    from wbmpc.robots.wheel_search import Wheel
    from wbmpc.ros2.plants import RosPlant
    from wbmpc.ros2.settings import RosSettings
    from wbmpc.simulation.perturbation import ArmPerturbation, Perturbation
    from wbmpc.types import Edit


class FixedBaseType(BaseType):
    """What generic code may ask of robots whose base does not move."""

    Description = FixedBaseDescription

    def check(self, description: RobotDescription, model: mujoco.MjModel) -> None:
        """Any body can stand still."""

    def propose(self, mechanism: Mechanism, wheels: Sequence[Wheel]) -> Proposal:
        """Everything can stand still; a robot on wheels should not."""
        reason = "its wheels stand still" if wheels else "no wheels"
        return Proposal({}, 0.1 if wheels else 0.9, reason)

    def model(self, description: RobotDescription, spec: mujoco.MjSpec) -> FixedBase:
        """The arm's tree on the body's pose in the file."""
        model = spec.compile()
        data, body = mujoco.MjData(model), model.body(description.base.body).id
        mujoco.mj_kinematics(model, data)
        tree = read_tree(spec, description.base.body)
        return FixedBase(description, tree, data.xpos[body].copy(), data.xquat[body].copy())

    def perturbation(self) -> type[ArmPerturbation]:
        """Of an arm."""
        from wbmpc.simulation.perturbation import ArmPerturbation

        return ArmPerturbation

    def plant(
        self, robot: RobotModel, perturbation: Perturbation | None, seed: int, edit: Edit | None = None
    ) -> FixedPlant:
        """The simulated robot at home."""
        from wbmpc.bases.fixed.plant import FixedPlant

        return FixedPlant(robot, perturbation, seed, edit=edit)

    def mpc(
        self, robot: RobotModel, obstacles: Obstacles | None = None, *, progress: str | None = None, **changes: Any
    ) -> MPC:
        """Weights that follow from the robot's size and limits."""
        from wbmpc.default_problem import default_mpc, default_settings

        return default_mpc(robot, default_settings(**changes), obstacles=obstacles, progress=progress)

    def system(
        self,
        robot: RobotModel,
        seed: int,
        perturbation: Perturbation | None = None,
        mpc: MPC | None = None,
        edit: Edit | None = None,
        calibration: Calibration | None = None,
    ) -> System:
        """A perturbed plant at home with its controller and MPC, whose goal is home."""
        from wbmpc.control.direct import DirectController
        from wbmpc.settings import ACTUATOR_TIME_CONSTANT, COMPUTATION_DELAY, CONTROL_RATE
        from wbmpc.types import Timing

        plant, mpc = self.plant(robot, perturbation, seed, edit), mpc or self.mpc(robot)
        timing = Timing.of(plant.timestep, CONTROL_RATE, mpc.rate, COMPUTATION_DELAY)
        rate = robot.limits.input_rate
        return System(
            plant, DirectController(robot, mpc, timing.period, ACTUATOR_TIME_CONSTANT, rate=rate), mpc, timing
        )

    def ros_settings(self, description: RobotDescription) -> type[RosSettings]:
        """Weights that scale with the robot."""
        from wbmpc.bases.fixed.ros_settings import FixedRosSettings

        return FixedRosSettings

    def ros(self, robot: RobotModel, settings: Any, period: float) -> FixedRosAdapter:
        """The adapter that reads joint states and publishes speeds."""
        from wbmpc.bases.fixed.ros import FixedRosAdapter

        return FixedRosAdapter(robot, settings, period)

    def ros_plant(self, robot: RobotModel, perturbation: Perturbation | None, seed: int) -> RosPlant:
        """Follows speeds."""
        from wbmpc.bases.fixed.ros_plant import FixedRosPlant

        return FixedRosPlant(robot, self.plant(robot, perturbation, seed))

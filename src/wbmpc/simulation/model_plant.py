"""The planner's own model as a plant: a closed loop without physics, many times faster than the simulator."""

from __future__ import annotations

from typing import Any

import numpy as np

from wbmpc import lie
from wbmpc.checks import numbers
from wbmpc.control.direct import InputCommand, StateMeasurement
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.simulation.model_picture import ModelPicture
from wbmpc.simulation.world import Array, World
from wbmpc.types import Edit, Truth

#: Length [s] of a step: nothing moves in between.
TIMESTEP = 0.005


class ModelPlant:
    """Integrates the dynamics of an MPC's problem by the solver's integrator; measurements are exact.

    The bodies of ``model`` and ``data`` (MuJoCo) are pictures: they are where the state has them. A stop is a standstill. It starts at
    ``start`` (nx of the problem). ``edit`` adds to that scene.
    """

    #: Whether bodies touch each other: contacts and clearances are none of this plant's.
    has_physics = False
    fall_reason = ""

    def __init__(
        self, robot: RobotModel, mpc: MPC, start: Array, timestep: float = TIMESTEP, edit: Edit | None = None
    ) -> None:
        self.robot, self.description, self.mpc, self.timestep = robot, robot.description, mpc, timestep
        layout = mpc.dynamics.state
        self.x = numbers("start", "state", start, layout.size).copy()
        self._own = np.concatenate([np.arange(layout.size)[layout[group]] for group in robot.state.groups])
        self._steps, self._drawn, self._picture = 0, False, ModelPicture(robot, edit)

    # ------------------------------------------------------------------ time
    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self._steps * self.timestep

    @property
    def diverged(self) -> bool:
        """Whether the state is not finite."""
        return not np.isfinite(self.x).all()

    @property
    def fell(self) -> bool:
        """Only by numbers that are not finite: nothing tips over here."""
        return self.diverged

    def measure(self) -> StateMeasurement:
        return StateMeasurement(self.time, self.x.copy())

    def step(self, command: InputCommand, steps: int = 1) -> None:
        """Hold an input for ``steps`` steps."""
        self._steps += steps
        self._drawn = False
        if not command.rest[0]:
            self.x = self.mpc.simulate(self.x, command.input, steps * self.timestep)

    def push(self, force: Array) -> None:
        """Nothing: a model of speeds has no forces."""

    def end_pushes(self) -> None:
        """Nothing: there are none."""

    @property
    def rests(self) -> bool:
        """A stop is a standstill."""
        return True

    # ------------------------------------------------------------------ truth
    def truth(self) -> Truth:
        """Poses by the model's kinematics."""
        x = self.x[self._own]
        base, (tool, turn) = self._picture.base(x), self.robot.pose(x)
        inside = lie.pose_compose(lie.pose_inverse(base), np.concatenate([tool, turn]))
        rotation = lie.quaternion_to_rotation(base[3:])
        yaw = x[self.robot.state["base"]][2] if "base" in self.robot.state else lie.rotation_to_euler_zyx(rotation)[0]
        joints = {
            n: float(v)
            for g, names in self.robot.state.groups.items()
            for n, v in zip(names, x[self.robot.state[g]], strict=True)
        }
        return Truth(
            time=self.time, pose=np.array([*base[:2], yaw]), tool=tool, tool_rotation=lie.quaternion_to_rotation(turn),
            tool_in_base=inside[:3], tool_rotation_in_base=lie.quaternion_to_rotation(inside[3:]),
            tilt=float(np.arccos(np.clip(rotation[2, 2], -1.0, 1.0))), state=x.copy(), joints=joints,
        )  # fmt: skip

    # ------------------------------------------------------------------ pictures
    @property
    def world(self) -> World:
        """The bodies as the state has them."""
        if not self._drawn:
            self.arrange(self.x[self._own])
        return self._picture.world

    @property
    def model(self) -> Any:
        """Of MuJoCo."""
        return self.world.model

    @property
    def data(self) -> Any:
        """Of MuJoCo."""
        return self.world.data

    def arrange(self, state: Array) -> None:
        """Show another state (nx of the robot) until the next step."""
        self._picture.arrange(state)
        self._drawn = True

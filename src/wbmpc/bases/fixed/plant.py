"""An arm on a base that does not move, in MuJoCo."""

from __future__ import annotations

import mujoco
import numpy as np

from wbmpc.checks import numbers
from wbmpc.control.direct import InputCommand, StateMeasurement
from wbmpc.model.robot import RobotModel
from wbmpc.robots.couplings import put_followers
from wbmpc.simulation.arm import ArmPlant
from wbmpc.simulation.perturbation import ArmPerturbation, Perturbation
from wbmpc.simulation.world import TIMESTEP, Array, add_floor, add_light, set_options
from wbmpc.types import Edit, Truth


class FixedPlant(ArmPlant):
    """Physics, drives and encoders; commands and measurements are the planner's inputs and states.

    ``perturbation`` and ``seed``: how it differs from the model; ``edit`` changes the specification before it is compiled. It starts at
    the model's home, as its encoders see it.
    """

    def __init__(
        self, robot: RobotModel, perturbation: Perturbation | None = None, seed: int = 0, timestep: float = TIMESTEP, *,
        edit: Edit | None = None,
    ) -> None:  # fmt: skip
        description = self.description = robot.description
        self.timestep, self.perturbation = timestep, ArmPerturbation.of(perturbation, description)
        names = list(description.arm.joints)
        self._names = {"arm": names}
        self.make_world(seed, 0, edit, description.limits.velocity)
        self._control = np.array([self.model.actuator(n).id for n in names], dtype=int)
        self._speed = np.array([description.limits.velocity.get(n, np.inf) for n in names])
        self.start_sensors({"arm": self.draw.arm_offset})
        self.arrange(robot.home)
        self.data.qpos[self._q["arm"]] -= self.offsets["arm"]
        self.settle(0.0)

    def build(self, spec: mujoco.MjSpec, edit: Edit | None) -> None:
        self.draw.apply_to_bodies(spec)
        set_options(spec, self.timestep, mujoco.mjtIntegrator.mjINT_DISCRETE)
        add_floor(spec, 3, [self.draw.friction, 0.005, 1e-4], [0.02, 1.0])
        add_light(spec.worldbody)
        self.finish(spec, edit)

    def arrange(self, state: Array) -> None:
        """Put the joints where a planner's state (nx) has them: no physics, no offsets."""
        self.data.qpos[self._q["arm"]] = state
        put_followers(self.model, self.data)
        mujoco.mj_kinematics(self.model, self.data)

    def step(self, command: InputCommand, steps: int = 1) -> None:
        """Hold a command for ``steps`` physics steps. Drives clip at their speed limits, one by one."""
        speed = numbers("command", "arm", command.input, len(self._control))
        self.data.ctrl[self._control] = np.clip(speed, -self._speed, self._speed)
        self.world.advance(self._carry, steps, self._keep)
        self.world.check()

    def measure(self) -> StateMeasurement:
        """Encoder positions: quantized, with their zero errors, up to the jitter old. The same at the same time."""
        if self._last is None or self._last.time != self.time:
            self._last = StateMeasurement(self.time, self.quantized(self.encoders()))
        return self._last  # type: ignore[no-any-return]

    def truth(self) -> Truth:
        """Poses and joints."""
        frames = self.world.frames(height=0.0)
        return Truth(
            time=self.time, **frames, tilt=0.0, state=self.data.qpos[self._q["arm"]].copy(), joints=self.world.joints(),
            joint_speeds=self.world.joint_speeds(),
        )  # fmt: skip

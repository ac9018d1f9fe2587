"""A robot on fixed wheels in MuJoCo. What its wheels are a base type adds."""

from __future__ import annotations

import mujoco
import numpy as np

from wbmpc import lie
from wbmpc.bases.planar_motion.description import PlanarBaseDescription
from wbmpc.bases.planar_motion.messages import PlanarCommand, PlanarMeasurement
from wbmpc.bases.planar_motion.model import PlanarBase
from wbmpc.checks import numbers
from wbmpc.constants import GRAVITY
from wbmpc.model.robot import RobotModel
from wbmpc.robots.couplings import put_followers
from wbmpc.simulation.contacts import ROLLING
from wbmpc.simulation.perturbation import Perturbation, WheeledPerturbation
from wbmpc.simulation.wheeled import TIRE, WheeledPlant
from wbmpc.simulation.world import TIMESTEP, Array
from wbmpc.types import Edit, Truth


class PlanarPlant(WheeledPlant):
    """Physics, drives and sensors. Subclasses add what touches the ground: :meth:`add_wheel` and :meth:`add_supports`.

    ``state`` (nx) of the planner's layout: where the robot starts, as its encoders see it; left out: the model's home.
    ``perturbation`` and ``seed``: how it differs from the model. ``edit`` changes the specification before it is compiled;
    ``settle`` [s]: time to sink into the tires before time 0.
    """

    Measurement = PlanarMeasurement

    def __init__(
        self, robot: RobotModel, state: Array | None = None, perturbation: Perturbation | None = None, seed: int = 0,
        timestep: float = TIMESTEP, *, edit: Edit | None = None, settle: float = 0.5,
    ) -> None:  # fmt: skip
        self.robot, description = robot, robot.description
        self.description = description
        assert isinstance(description.base, PlanarBaseDescription) and isinstance(robot.base, PlanarBase)
        self.base, self.model_base, self.timestep = description.base, robot.base, timestep
        self.perturbation = WheeledPerturbation.of(perturbation, description)
        self._names = {
            "wheel": self.base.wheel_joints(),
            **{g: robot.base.state[g] for g in robot.base.state if g != "base"},
        }
        self.make_world(seed, self._drives(), edit, description.limits.velocity)
        self.start_sensors({**{g: np.zeros(len(n)) for g, n in self._names.items()}, "arm": self.draw.arm_offset})
        start = robot.home if state is None else numbers("start", "state", state, robot.state.size)
        self.arrange(start)
        self.data.qpos[self._q["arm"]] -= self.offsets["arm"]
        self.settle(settle)

    # ------------------------------------------------------------------ what base types add
    def _drives(self) -> int:
        return len(self._names["wheel"]) or len(self.model_base.rates)

    def add_wheel(self, spec: mujoco.MjSpec, index: int, radius: float, friction: list[float]) -> None:
        """Give wheel ``index`` of ``radius`` [m] what touches the floor with ``friction`` (slide, spin, roll)."""
        raise NotImplementedError

    def add_supports(self, spec: mujoco.MjSpec, weight: float) -> None:
        """What else carries the robot, of ``weight`` [N]: casters."""

    # ------------------------------------------------------------------ building
    def build(self, spec: mujoco.MjSpec, edit: Edit | None) -> None:
        friction = self.stand_on_floor(spec)
        weight = float(spec.compile().body_mass.sum()) * GRAVITY
        for i in range(len(self._names["wheel"])):
            name = self._names["wheel"][i]
            self.drive_joint(spec, name, np.inf, self.draw.wheel_lag[i])
            self.add_load_sensor(spec, name, mujoco.mjtObj.mjOBJ_XBODY, spec.joint(name).parent.name)
            self.add_wheel(spec, i, self.model_base.geometry.radius * float(self.draw.radius[i]), friction)
        self.add_supports(spec, weight)
        self.finish(spec, edit)

    def index(self) -> None:
        """Also the wheels' bodies, and every group's drives with their limits of speed."""
        super().index()
        m, names, speed = self.model, self._names, self.description.limits.velocity
        self._control = {g: np.array([m.actuator(n).id for n in part], dtype=int) for g, part in names.items()}
        self._speed = {g: np.array([speed.get(n, np.inf) for n in part]) for g, part in names.items()}
        self._hubs = [int(m.jnt_bodyid[m.joint(n).id]) for n in names["wheel"]]

    def arrange(self, state: Array) -> None:
        """Put the bodies where a planner's state (nx) has them, for pictures: no physics, no offsets."""
        d, radius = self.data, self.model_base.geometry.radius
        pose = np.array([*state[:2], 0.0, *lie.quaternion_about([0.0, 0.0, 1.0], state[2])])
        self.world.place(pose)
        for group in self._names:
            if group in self.robot.state:
                d.qpos[self._q[group]] = state[self.robot.state[group]]
        put_followers(self.model, d)
        mujoco.mj_kinematics(self.model, d)
        pose[2] = radius - float(np.mean(d.xpos[self._hubs, 2]))
        self.world.place(pose)
        mujoco.mj_kinematics(self.model, d)

    # ------------------------------------------------------------------ running
    def step(self, command: PlanarCommand, steps: int = 1) -> None:
        """Hold a command for ``steps`` physics steps. Drives clip at their speed limits, one by one."""
        for group, names in self._names.items():
            speed = numbers("command", group, getattr(command, group), len(names))
            self.data.ctrl[self._control[group]] = np.clip(speed, -self._speed[group], self._speed[group])
        self.world.refresh()
        self.world.advance(self.carry_arm, steps, self._keep)
        self.world.check()

    # ------------------------------------------------------------------ truth
    def truth(self) -> Truth:
        frames = self.world.frames(height=0.0)
        return Truth(
            time=self.time,
            **frames,
            tilt=self.world.tilt,
            state=np.concatenate([frames["pose"], *(self.data.qpos[q] for g, q in self._q.items() if g != "wheel")]),
            joints=self.world.joints(),
            joint_speeds=self.world.joint_speeds(),
            wheel_force=np.abs(self.data.sensordata[self._forces]),
        )


def contact_settings(friction: list[float]) -> dict[str, object]:
    """Settings of a geom that rolls on the floor: massless, invisible in pictures."""
    return {"condim": 3, "friction": friction, "solref": TIRE, "rgba": [0, 0, 0, 0], "group": 3, **ROLLING}

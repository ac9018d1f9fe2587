"""A base that takes speeds in MuJoCo: its wheels are not described, so a force between floor and body drives it, within friction.

The body stands on feet without friction. Its driver is a servo of the body's speeds with a lag; what it reports of its own motion has
its scale errors, and does not see how far skidding wheels or tracks turn less than they roll.
"""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from wbmpc import lie
from wbmpc.bases.planar_motion.messages import PlanarCommand, PlanarMeasurement
from wbmpc.bases.planar_motion.plant import PlanarPlant, contact_settings
from wbmpc.checks import numbers
from wbmpc.robots import load_spec
from wbmpc.robots.couplings import put_followers
from wbmpc.simulation.world import Array

#: Half a side [m] of the square of feet about the center of mass, where a file has none; radius [m] of a foot.
STANCE, FOOT = 0.3, 0.04
#: Contact softness of a foot (time constant [s], damping ratio).
STIFF = [0.004, 1.0]
#: Time constant [s] of the body's motion under the servo's force.
RESPONSE = 0.01
#: Share of a turn that is lost where wheels or tracks are dragged sideways.
LOST = 0.05


class MobilePlant(PlanarPlant):
    """``rolled`` (m): the way [m, rad] along each of the base's speeds, as its driver counts it."""

    def add_supports(self, spec: mujoco.MjSpec, weight: float) -> None:
        settings = {**contact_settings([0.0, 0.0, 0.0]), "condim": 1, "priority": 1, "solref": STIFF}
        for x, y in self._feet():
            spec.body(self.base.body).add_geom(
                type=mujoco.mjtGeom.mjGEOM_SPHERE, pos=[x, y, FOOT - self.base.height], size=[FOOT, 0, 0], mass=0, **settings
            )  # fmt: skip

    def _feet(self) -> Array:
        """(n, 2) [m] in the axes of the body."""
        if self.base.casters:
            return np.array(self.base.casters)
        model = load_spec(self.description).compile()
        data, body = mujoco.MjData(model), model.body(self.base.body).id
        for name, angle in self.description.home.items():
            data.qpos[model.jnt_qposadr[model.joint(name).id]] = angle
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        center = data.xmat[body].reshape(3, 3).T @ (data.subtree_com[body] - data.xpos[body])
        return center[:2] + STANCE * np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])

    def index(self) -> None:
        """Also the servo: masses that it moves, and its limits by friction."""
        super().index()
        m = self.model
        self._body = m.body(self.base.body).id
        self._inverse = np.linalg.pinv(self.model_base.twist)
        self._order = self._speeds = np.zeros(self._inverse.shape[0])
        self.rolled: Array = np.zeros_like(self._order)
        mass = float(m.body_subtreemass[self._body])
        turning = mass * STANCE**2
        self._inertia = np.array([mass, mass, turning])
        grip = self.draw.friction * self.weight
        self._grip = np.array([grip, grip, grip * STANCE])
        self._lost = np.ones(len(self._order))
        self._lost[-1] -= LOST if self.base.slips else 0.0

    def arrange(self, state: Array) -> None:
        """Put the bodies where a planner's state (nx) has them, for pictures: no physics, no offsets."""
        pose = [*state[:2], self.base.height, *lie.quaternion_about([0.0, 0.0, 1.0], state[2])]
        self.world.place(np.array(pose))
        self.data.qpos[self._q["arm"]] = state[self.robot.state["arm"]]
        put_followers(self.model, self.data)
        mujoco.mj_kinematics(self.model, self.data)

    def carry_arm(self) -> None:
        """Apply the arm's drives, and the force that drives the body."""
        super().carry_arm()
        m, d, velocity = self.model, self.data, np.zeros(6)
        self._speeds = self._speeds + (1.0 - np.exp(-self.timestep / self.draw.wheel_lag)) * (
            self._order - self._speeds
        )
        mujoco.mj_objectVelocity(m, d, mujoco.mjtObj.mjOBJ_XBODY, self._body, velocity, 1)
        moving = np.array([velocity[3], velocity[4], velocity[2]])
        target = self.model_base.twist @ (self._speeds * self.draw.radius * self._lost)
        push = np.clip(self._inertia / RESPONSE * (target - moving), -self._grip, self._grip)
        turn = d.xmat[self._body].reshape(3, 3)
        force, applied = np.zeros(m.nv), slice(0, 6)
        mujoco.mj_applyFT(
            m, d, turn @ [push[0], push[1], 0.0], turn @ [0.0, 0.0, push[2]], d.xpos[self._body], self._body, force
        )
        d.qfrc_applied[applied] = force[applied]
        self.rolled = self.rolled + self.timestep * (self._inverse @ moving) / (self.draw.radius * self._lost)

    def step(self, command: PlanarCommand, steps: int = 1) -> None:
        """Hold speeds of base and arm for ``steps`` physics steps. The arm's drives clip at their limits, one by one."""
        self._order = numbers("command", "wheel", command.wheel, len(self._order))
        super().step(replace(command, wheel=np.zeros(0)), steps)

    def measure(self) -> PlanarMeasurement:
        """Also the base's own count of its way."""
        if self._last is None or self._last.time != self.time:
            self._last = replace(super().measure(), wheel=self.rolled.copy())
        return self._last

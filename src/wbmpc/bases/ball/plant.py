"""The ball robot in MuJoCo: free base, ball on a ball joint, drives between them, floor contact with spin friction.

The drives act in the base's frame at the ball joint with constant gear −(r / r_w) a_i; that equals the minimal model
with rolling. Until its estimator exists the measurement is the simulator's state, late and with noise.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.bases.ball.description import BallBaseDescription
from wbmpc.bases.ball.elastic_drives import ElasticDrives
from wbmpc.bases.ball.messages import BallCommand, BallMeasurement
from wbmpc.bases.ball.perturbation import BallPerturbation, RigidDrives, SeriesElasticDrives
from wbmpc.bases.ball.sensor_step import minimal_state
from wbmpc.bases.ball.sensors import BallSensors, WheelGeometry
from wbmpc.checks import numbers, whole
from wbmpc.errors import InputError
from wbmpc.kernel.step import bind
from wbmpc.robots import RobotDescription, load_spec
from wbmpc.robots.checks import named
from wbmpc.simulation.contacts import GROUND, ROLLING
from wbmpc.simulation.payloads import add_payload, lay_cables
from wbmpc.simulation.perturbation import Perturbation
from wbmpc.simulation.world import (
    TIMESTEP,
    World,
    WorldAccess,
    add_drive,
    add_floor,
    add_light,
    set_options,
    unwrap,
)
from wbmpc.types import Edit, Truth

#: Contact softness of the ball (time constant [s], damping ratio).
CONTACT = [0.005, 1.0]


def body_rates(yaw_pitch_roll: ArrayLike, rates: ArrayLike) -> Array:
    """Angular velocity (3) [rad/s] in body axes for ZYX Euler angles and their rates (yaw, pitch, roll)."""
    _, pitch, roll = np.asarray(yaw_pitch_roll, float)
    yaw_rate, pitch_rate, roll_rate = np.asarray(rates, float)
    s, c = np.sin(roll), np.cos(roll)
    return np.array(
        [
            roll_rate - np.sin(pitch) * yaw_rate,
            c * pitch_rate + s * np.cos(pitch) * yaw_rate,
            -s * pitch_rate + c * np.cos(pitch) * yaw_rate,
        ]
    )


class BallPlant(WorldAccess):
    """Physics and drives of a ball robot.

    ``state`` (16): where it starts in the planner's minimal coordinates, as its sensors see it (left out: upright, arm
    at the description's home); ``torque`` (6): what the drives give at the start (left out: none on the ball, the arm's
    weight on the arm). ``payload`` [kg]: a mass at the tool. ``edit`` changes the specification before it is compiled;
    ``external`` is called before every physics step with (model, data). ``sensors``: the encoders and the inertial unit,
    whose faults can be set.
    """

    def __init__(
        self, description: RobotDescription, state: ArrayLike | None = None, torque: ArrayLike | None = None,
        perturbation: Perturbation | None = None, seed: int = 0, timestep: float = TIMESTEP, *, payload: float = 0.0,
        edit: Edit | None = None,
    ) -> None:  # fmt: skip
        if not isinstance(description.base, BallBaseDescription):
            raise InputError(f"{description.name}: this plant needs a ball base")
        self.description, self.base, self.timestep = description, description.base, timestep
        p = self.perturbation = BallPerturbation.of(perturbation, description)
        draw_rng, self._noise, sensor_rng = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(3))
        arm, spec = list(description.arm.joints), load_spec(description)
        bodies = [b.name for b in spec.bodies if b.name != "world"]
        self.draw = p.draw(draw_rng, bodies, len(self.base.wheels.azimuths), len(arm))
        with named(description.model):
            self._build(spec, payload, edit)
        self.world = World(spec, description, arm, self._rated())
        self.model, self.data = self.world.model, self.world.data
        self._arm_q = np.array([self.model.joint(n).qposadr[0] for n in arm])
        self._arm_v = np.array([self.model.joint(n).dofadr[0] for n in arm])
        self._ball = self.model.joint(self._ball_joint)
        n = len(arm)
        spread = [p.position_noise] * 2 + [p.angle_noise] * (3 + n) + [p.speed_noise] * 2 + [p.rate_noise] * (3 + n)
        self._spread = np.array(spread)
        # a constant error of the arm's encoders; they are not in the state's speeds
        self.offset = np.zeros(10 + 2 * n)
        self.offset[5 : 5 + n] = self.draw.arm_offset
        arrays = {"q": np.zeros(self.model.nq), "v": np.zeros(self.model.nv), "state": np.zeros(10 + 2 * n)}
        places = {"arm_q": self._arm_q.astype(np.int64), "arm_v": self._arm_v.astype(np.int64)}
        self._minimal = arrays | places
        #: by the names of compiled steps: the simulator's positions and velocities, frames, and where the arm's joints are in them
        self.memory = {"q": self.data.qpos, "v": self.data.qvel, **self.world.frame_memory, **places}
        self._to_minimal: Callable[[], None] = bind(minimal_state, self._minimal, m=n).call
        self._late, jitter = round(p.state_age / timestep), round(p.encoder_jitter / timestep)
        wheels = WheelGeometry.of(self.base, self.draw.radius)
        sizes, ball = (self.model.nq, self.model.nv), (int(self._ball.qposadr[0]), int(self._ball.dofadr[0]))
        self.sensors = BallSensors(p, self.draw, wheels, self._mount(), timestep, jitter, sensor_rng, sizes, ball)
        # (views of the simulator's memory: to ask for them again costs as much as to write into them)
        self._qpos, self._qvel, self._ctrl = self.data.qpos, self.data.qvel, self.data.ctrl
        self.sensors.attach(self._qpos, self._qvel)
        self._history: deque[Array] = deque(maxlen=1 + self._late + jitter)
        self._last: BallMeasurement | None = None
        #: what elastic drives do; none where they are rigid
        self.drives = None if isinstance(p.drives, RigidDrives) else self._drives(p.drives)
        dead = whole("plant.actuator_dead_time", p.actuator_dead_time, timestep, "physics steps", minimum=0)
        self._commands: deque[Array] = deque(maxlen=1 + dead)
        self.weight = float(self.model.body_mass.sum() * np.linalg.norm(self.model.opt.gravity))
        home = [0.0] * 5 + [description.home.get(name, 0.0) for name in arm] + [0.0] * (5 + n)
        self._place(numbers("start", "state", home if state is None else state, 10 + 2 * n), torque)

    # ------------------------------------------------------------------ building
    def _build(self, spec: mujoco.MjSpec, payload: float, edit: Edit | None) -> None:
        base, draw, limits = self.base, self.draw, self.description.limits
        draw.apply_to_bodies(spec, balanced=(base.ball,))
        set_options(spec, self.timestep, mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
        friction = [draw.friction, self.perturbation.torsional_friction, 1e-4]
        add_floor(spec, 4, friction, CONTACT)
        if self.perturbation.floor_cables > 0.0:
            lay_cables(spec, self.perturbation.floor_cables, friction, CONTACT, **GROUND)
        spec.body(base.body).add_freejoint(name="root")
        add_light(spec.body(base.body))
        ball = spec.body(base.ball)
        ball.add_geom(
            name="contact_ball", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[base.ball_radius, 0, 0], mass=0, condim=4,
            friction=friction, solref=CONTACT, rgba=[0, 0, 0, 0], group=3, **ROLLING,
        )  # fmt: skip
        self._ball_joint = next(j.name for j in spec.joints if j.parent.name == base.ball)
        for i, b in enumerate(base.wheels.azimuths):
            z, ratio = base.wheels.zenith, base.ball_radius / (base.wheels.radius * float(draw.radius[i]))
            axis = np.array([np.cos(z) * np.cos(b), np.cos(z) * np.sin(b), -np.sin(z)])
            kind, gear = mujoco.mjtTrn.mjTRN_JOINTINPARENT, [*(-ratio * axis), 0, 0, 0]
            self._motor(spec, f"wheel_{i}", self._ball_joint, kind, gear, limits.wheel_effort, draw.wheel_lag[i])
        for k, name in enumerate(self.description.arm.joints):
            kind, gear = mujoco.mjtTrn.mjTRN_JOINT, [1.0, 0, 0, 0, 0, 0]
            self._motor(spec, name, name, kind, gear, limits.effort.get(name, np.inf), draw.arm_lag[k])
        if payload > 0.0:
            add_payload(spec, self.description.arm.tool, payload)
        if edit is not None:
            edit(spec)

    def _motor(
        self, spec: mujoco.MjSpec, name: str, joint: str, kind: mujoco.mjtTrn, gear: list[float], limit: float,
        lag: float,
    ) -> None:  # fmt: skip
        """Limit and lag of a rigid drive are MuJoCo's; the control of an elastic one is the torque of its spring."""
        if not isinstance(self.perturbation.drives, RigidDrives):
            add_drive(spec, name, joint, kind, np.inf, 0.0).gear = gear
            return
        actuator = add_drive(spec, name, joint, kind, limit, lag)
        actuator.gear = gear
        if np.isfinite(limit):
            actuator.ctrlrange, actuator.ctrllimited = [-limit, limit], mujoco.mjtLimited.mjLIMITED_TRUE

    def _rated(self) -> dict[str, float]:
        """Speeds [rad/s] up to which the drives give their whole torque."""
        limits, wheels = self.description.limits, range(len(self.base.wheels.azimuths))
        arm = {name: limits.velocity.get(name, np.inf) for name in self.description.arm.joints}
        return {**{f"wheel_{i}": limits.wheel_velocity for i in wheels}, **arm}

    def _drives(self, s: SeriesElasticDrives) -> ElasticDrives:
        limits, wheels = self.description.limits, len(self.base.wheels.azimuths)
        arm = self.description.arm.joints
        effort = np.array([limits.wheel_effort] * wheels + [limits.effort.get(name, np.inf) for name in arm])
        lag = np.concatenate([self.draw.wheel_lag, self.draw.arm_lag])
        each = lambda wheel, joint: np.array([wheel] * wheels + [joint] * len(arm))
        return ElasticDrives(
            each(s.wheel_spring, s.arm_spring), each(s.wheel_rotor, s.arm_rotor), s.spring_damping, s.torque_gain,
            s.torque_damping, effort, lag, self.timestep,
            each(limits.wheel_effort, np.inf),  # the wheels' limit is their traction on the ball, the arm's its motors'
        )  # fmt: skip

    def _mount(self) -> Array:
        """Position (3) [m] of the inertial unit in the base's frame: of the site, or of the link, ``imu``."""
        m, d = self.model, self.data
        mujoco.mj_kinematics(m, d)
        base = d.body(self.base.body)
        for kind, count, get in (
            (mujoco.mjtObj.mjOBJ_SITE, m.nsite, d.site),
            (mujoco.mjtObj.mjOBJ_BODY, m.nbody, d.body),
        ):
            if count and mujoco.mj_name2id(m, kind, "imu") >= 0:
                frame = get("imu")
                return base.xmat.reshape(3, 3).T @ (frame.xpos - base.xpos)
        return np.zeros(3)

    def _place(self, state: Array, torque: ArrayLike | None) -> None:
        d, n, r = self.data, self._arm_q.size, self.base.ball_radius
        state = state - self.offset
        rotation = lie.euler_zyx_to_rotation(*state[2:5])
        omega = body_rates(state[2:5], state[7 + n : 10 + n])
        vx, vy = state[5 + n : 7 + n]
        d.qpos[0:3], d.qpos[3:7] = [state[0], state[1], r], lie.rotation_to_quaternion(rotation)
        d.qpos[self._arm_q] = state[5 : 5 + n]
        d.qvel[0:6] = [vx, vy, 0.0, *omega]
        # rolling without spin: the ball's angular velocity is (−ẏ / r, ẋ / r, 0) in the world
        ball = int(self._ball.dofadr[0])
        d.qvel[ball : ball + 3] = rotation.T @ np.array([-vy / r, vx / r, 0.0]) - omega
        d.qvel[self._arm_v] = state[10 + n :]
        mujoco.mj_forward(self.model, d)
        rest = np.concatenate([np.zeros(self.model.nu - n), d.qfrc_bias[self._arm_v]])
        d.ctrl[:] = rest if torque is None else numbers("start", "torque", torque, self.model.nu)
        d.act[:] = d.ctrl[self.model.actuator_actadr >= 0]
        mujoco.mj_fwdActuation(self.model, d)
        self._commands.extend([d.ctrl.copy()] * (self._commands.maxlen or 1))
        if self.drives is not None:
            mujoco.mj_fwdVelocity(self.model, d)
            self.drives.reset(d.ctrl, d.actuator_velocity)
        self.world.restart()
        self.sensors.restart()
        self._history.clear()
        self._record()

    def arrange(self, state: Array) -> None:
        """Put the bodies where a planner's state (16) has them, for pictures: no physics; the ball does not roll."""
        d, n = self.data, self._arm_q.size
        d.qpos[0:2], d.qpos[3:7] = state[:2], lie.rotation_to_quaternion(lie.euler_zyx_to_rotation(*state[2:5]))
        d.qpos[self._arm_q] = state[5 : 5 + n]
        mujoco.mj_kinematics(self.model, d)

    def _record(self) -> None:
        self._history.append(self.sensors.measure())

    # ------------------------------------------------------------------ running
    def _state_of(self, q: Array, v: Array) -> Array:
        """Minimal coordinates (16) of positions and velocities in MuJoCo's conventions."""
        a = self._minimal
        a["q"][:], a["v"][:] = q, v
        self._to_minimal()
        return a["state"].copy()

    def state(self) -> Array:
        """The true state (16) in the planner's minimal coordinates, yaw not wrapped."""
        state = self._state_of(self.data.qpos, self.data.qvel)
        state[2] = self.world.yaw
        return state

    def measure(self) -> BallMeasurement:
        """Sensors and state of ``state_age`` ago with noise. Asking twice at the same time gives the same message."""
        if self._last is not None and self._last.time == self.time:
            return self._last
        now = max(len(self._history) - 1 - self._late, 0)
        seen = self.sensors.seen(self._history[now])
        state = self._state_of(seen.q, seen.v)
        state[2] = unwrap(state[2], self.world.yaw)
        state = state + self.offset + self._spread * self._noise.normal(size=state.size)
        gyro, accel = self.sensors.inertial(seen)
        then = self.sensors.seen(self._history[max(now - self.sensors.jitter(), 0)])
        wheel, arm = self.sensors.encoders(then.wheel, then.q[self._arm_q])
        age = (len(self._history) - 1 - now) * self.timestep
        self._last = BallMeasurement(self.time, state, age, wheel, arm, gyro, accel)
        return self._last

    def step(self, command: BallCommand, steps: int = 1) -> None:
        """Hold torques for ``steps`` physics steps; drives clip at their limits."""
        self._given = numbers("command", "torque", command.torque, self._ctrl.size)
        self.world.advance(self._drive, steps, self._record)
        self.world.check()

    def _drive(self) -> None:
        """Controls of one physics step: what was given a dead time ago, or what elastic drives make of it."""
        self._commands.append(self._given)
        command, d = self._commands[0], self.data
        self._ctrl[:] = command if self.drives is None else self.drives.step(command, d.actuator_velocity)

    @property
    def torque(self) -> Array:
        """What acts on ball (wheels) and arm joints [N m] in the last physics step."""
        return self.data.actuator_force.copy()

    def truth(self) -> Truth:
        """Poses of base and tool, joints."""
        return Truth(
            time=self.time, **self.world.frames(height=self.base.ball_radius), tilt=self.world.tilt, state=self.state(),
            joints=self.world.joints(), joint_speeds=self.world.joint_speeds(),
        )  # fmt: skip

"""A robot on fixed wheels in MuJoCo: body, arm, drives and sensors. What its wheels are a base type adds.

Wheels are driven by velocity servos under the `discrete` integrator, and touch the floor in three-dimensional contacts whose
softness is that of tyres. The arm's weight is fed forward to its servos (as a joint torque: MuJoCo's own gravity compensation would
take the weight off the wheels).
"""

from __future__ import annotations

from collections import deque

import mujoco
import numpy as np

from wbmpc import lie
from wbmpc.bases.planar.description import PlanarBaseDescription
from wbmpc.bases.planar.messages import PlanarCommand, PlanarMeasurement
from wbmpc.bases.planar.model import PlanarBase
from wbmpc.bases.planar.perturbation import check_perturbation
from wbmpc.checks import numbers
from wbmpc.model.robot import RobotModel
from wbmpc.robots import load_spec
from wbmpc.robots.checks import named
from wbmpc.simulation.payloads import PAYLOAD, add_body_payload, add_payload, incline
from wbmpc.simulation.perturbation import Perturbation, quantise
from wbmpc.simulation.world import (
    ROBOT,
    TIMESTEP,
    Array,
    Edit,
    InWorld,
    World,
    add_drive,
    add_floor,
    add_light,
    set_options,
)
from wbmpc.types import Truth

#: Contact softness of what rolls on the floor (time constant [s], damping ratio).
TYRE = [0.01, 1.0]
#: Gain [N m s/rad] of the wheels' servos; of the arm's per N m of effort limit, but not below its floor.
_WHEEL_GAIN, _ARM_GAIN, _ARM_GAIN_LEAST = 100.0, 12.0, 800.0
#: Interval [s] that sets the noise of the inertial unit's first sample.
_IMU_INTERVAL = 0.0025


class PlanarPlant(InWorld):
    """Physics, drives and sensors. Subclasses add what touches the ground: :meth:`add_wheel` and :meth:`add_supports`.

    ``state`` (nx) of the planner's layout: where the robot starts, as its encoders see it; left out: the model's home.
    ``perturbation`` and ``seed``: how it differs from the model. ``edit`` changes the specification before it is compiled;
    ``settle`` [s]: time to sink into the tyres before time 0.
    """

    def __init__(
        self,
        robot: RobotModel,
        state: Array | None = None,
        perturbation: Perturbation | None = None,
        seed: int = 0,
        timestep: float = TIMESTEP,
        *,
        edit: Edit | None = None,
        settle: float = 0.5,
    ) -> None:
        description = self.description = robot.description
        assert isinstance(description.base, PlanarBaseDescription) and isinstance(robot.base, PlanarBase)
        self.base, self.model_base, self.timestep = description.base, robot.base, timestep
        self.perturbation = perturbation or Perturbation()
        check_perturbation(self.perturbation)
        draw_rng, self._noise = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2))
        self._names = {"wheel": list(self.base.wheels), "arm": list(description.arm.joints)}
        spec = load_spec(description)
        bodies = [b.name for b in spec.bodies if b.name != "world"]
        self.draw = self.perturbation.draw(draw_rng, bodies, len(self._names["wheel"]), len(self._names["arm"]))
        with named(description.model):
            self._build(spec, edit)
        names = [n for group in self._names.values() for n in group]
        self.world = World(spec, description.model, self.base.body, description.arm.tool, names)
        self.model, self.data = self.world.model, self.world.data
        self._index()
        self._set_sensors()
        start = robot.home if state is None else numbers("start", "state", state, robot.state.size)
        self._place(start, settle)

    # ------------------------------------------------------------------ what base types add
    def add_wheel(self, spec: mujoco.MjSpec, index: int, radius: float, friction: list[float]) -> None:
        """Give wheel ``index`` of ``radius`` [m] what touches the floor with ``friction`` (slide, spin, roll)."""
        raise NotImplementedError

    def add_supports(self, spec: mujoco.MjSpec, weight: float) -> None:
        """What else carries the robot, of ``weight`` [N]: casters."""

    # ------------------------------------------------------------------ building
    def _build(self, spec: mujoco.MjSpec, edit: Edit | None) -> None:
        p, draw = self.perturbation, self.draw
        wheels = {spec.joint(n).parent.name for n in self._names["wheel"]}
        draw.apply_to_bodies(spec, balanced=wheels)
        set_options(spec, self.timestep, mujoco.mjtIntegrator.mjINT_DISCRETE)
        friction = [draw.friction, 0.005, 1e-4]
        add_floor(spec, 3, friction, TYRE)
        spec.body(self.base.body).add_freejoint(name="root")
        add_light(spec.body(self.base.body))
        weight = float(spec.compile().body_mass.sum()) * 9.81
        for i in range(len(self._names["wheel"])):
            self._drive_wheel(spec, i)
            self.add_wheel(spec, i, self.model_base.geometry.radius * float(draw.radius[i]), friction)
        self.add_supports(spec, weight)
        for k in range(len(self._names["arm"])):
            self._drive_arm(spec, k)
        self._add_imu(spec)
        if p.payload > 0.0:
            add_payload(spec, self.description.arm.tool, p.payload)
        if p.body_payload > 0.0:
            add_body_payload(spec, self.base.body, p.body_payload)
        if p.slope > 0.0:
            incline(spec, p.slope, draw.downhill)
        if edit is not None:
            edit(spec)

    def _drive_wheel(self, spec: mujoco.MjSpec, i: int) -> None:
        name, body = self._names["wheel"][i], spec.joint(self._names["wheel"][i]).parent
        spec.joint(name).armature, spec.joint(name).frictionloss = 0.03, self.perturbation.dry_friction
        effort = self.description.limits.effort.get(name, np.inf)
        add_drive(spec, name, name, mujoco.mjtTrn.mjTRN_JOINT, effort, self.draw.wheel_lag[i], _WHEEL_GAIN)
        # net force of all that touches below this body (data: force; reduction 3: net force)
        spec.add_sensor(
            name=f"contact_{name}", type=mujoco.mjtSensor.mjSENS_CONTACT, objtype=mujoco.mjtObj.mjOBJ_XBODY, objname=body.name,
            intprm=[1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE), 3, 1],
        )  # fmt: skip

    def _drive_arm(self, spec: mujoco.MjSpec, k: int) -> None:
        name = self._names["arm"][k]
        spec.joint(name).armature, spec.joint(name).damping = 0.1, [1.0, 0, 0]
        effort = self.description.limits.effort.get(name, np.inf)
        gain = max(_ARM_GAIN_LEAST, _ARM_GAIN * effort) if np.isfinite(effort) else _ARM_GAIN_LEAST
        add_drive(spec, name, name, mujoco.mjtTrn.mjTRN_JOINT, effort, self.draw.arm_lag[k], gain)

    def _add_imu(self, spec: mujoco.MjSpec) -> None:
        spec.body(self.base.body).add_site(name="wbmpc_imu")
        for name, kind in (("gyro", mujoco.mjtSensor.mjSENS_GYRO), ("accel", mujoco.mjtSensor.mjSENS_ACCELEROMETER)):
            spec.add_sensor(name=name, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname="wbmpc_imu")

    def _index(self) -> None:
        m, names = self.model, self._names
        self._q = {g: np.array([m.joint(n).qposadr[0] for n in part], dtype=int) for g, part in names.items()}
        self._all = np.concatenate(list(self._q.values()))
        self._arm_dofs = np.array([m.joint(n).dofadr[0] for n in names["arm"]], dtype=int)
        self._control = {g: np.array([m.actuator(n).id for n in part], dtype=int) for g, part in names.items()}
        speed = self.description.limits.velocity
        self._speed = {g: np.array([speed.get(n, np.inf) for n in part]) for g, part in names.items()}
        self._hubs = [int(m.jnt_bodyid[m.joint(n).id]) for n in names["wheel"]]
        self._forces = np.array([m.sensor(f"contact_{n}").adr[0] + 2 for n in names["wheel"]], dtype=int)
        self._imu = {n: slice(int(m.sensor(n).adr[0]), int(m.sensor(n).adr[0]) + 3) for n in ("gyro", "accel")}
        self.weight = float(m.body_mass.sum() * np.linalg.norm(m.opt.gravity))
        self._payload = m.body(PAYLOAD).id if self.perturbation.payload > 0.0 else None

    def _set_sensors(self) -> None:
        p, draw = self.perturbation, self.draw
        self.offsets = {"wheel": np.zeros(len(self._names["wheel"])), "arm": draw.arm_offset}
        self._counts, self._offsets = (
            {"wheel": p.encoder_counts, "arm": p.arm_counts},
            np.concatenate(list(self.offsets.values())),
        )
        self._bias = {"gyro": draw.gyro_bias.copy(), "accel": draw.accel_bias.copy()}
        self._density = {"gyro": (p.gyro_noise, p.gyro_walk), "accel": (p.accel_noise, p.accel_walk)}
        self._ages = round(p.encoder_jitter / self.timestep)
        self._history: deque[Array] = deque(maxlen=1 + self._ages)
        self._last: PlanarMeasurement | None = None

    def _place(self, state: Array, settle: float) -> None:
        d = self.data
        self.arrange(state)
        d.qpos[self._q["arm"]] -= self.offsets["arm"]
        for _ in range(round(settle / self.timestep)):
            self.world.advance(self._arm_weight)
        self.world.restart()
        self._history.append(d.qpos[self._all])

    def arrange(self, state: Array) -> None:
        """Put the bodies where a planner's state (nx) has them, for pictures: no physics, no offsets."""
        d, radius = self.data, self.model_base.geometry.radius
        d.qpos[0:3], d.qpos[3:7] = [*state[:2], 0.0], lie.quaternion_about([0.0, 0.0, 1.0], state[2])
        d.qpos[self._q["arm"]] = state[3:]
        mujoco.mj_kinematics(self.model, d)
        d.qpos[2] = radius - float(np.mean(d.xpos[self._hubs, 2]))
        mujoco.mj_kinematics(self.model, d)

    # ------------------------------------------------------------------ running
    def _arm_weight(self) -> None:
        """Feed the arm's weight forward to its joints; that of a payload, which nobody knows of, is not."""
        d, m, dofs = self.data, self.model, self._arm_dofs
        weight = d.qfrc_bias[dofs]
        if self._payload is not None:
            jacobian = np.zeros((3, m.nv))
            mujoco.mj_jacBody(m, d, jacobian, None, self._payload)
            weight = weight + m.body_mass[self._payload] * m.opt.gravity @ jacobian[:, dofs]
        d.qfrc_applied[dofs] = weight

    def step(self, command: PlanarCommand, steps: int = 1) -> None:
        """Hold a command for ``steps`` physics steps. Drives clip at their speed limits, one by one."""
        for group, names in self._names.items():
            speed = numbers("command", group, getattr(command, group), len(names))
            self.data.ctrl[self._control[group]] = np.clip(speed, -self._speed[group], self._speed[group])
        self.world.refresh()
        for _ in range(steps):
            self.world.advance(self._arm_weight)
            self._history.append(self.data.qpos[self._all])
        self.world.check()

    def measure(self) -> PlanarMeasurement:
        """Encoder positions (quantised, with their zero errors, up to the jitter old) and the inertial unit. Asking twice at the same
        time gives the same message."""
        if self._last is not None and self._last.time == self.time:
            return self._last
        self.world.refresh()
        age = int(self._noise.integers(0, self._ages + 1))
        raw = self._history[max(len(self._history) - 1 - age, 0)] + self._offsets
        wheel, arm = np.split(raw, [len(self._names["wheel"])])
        interval = _IMU_INTERVAL if self._last is None else self.time - self._last.time
        imu = {name: self._inertial(name, interval) for name in ("gyro", "accel")}
        positions = {"wheel": quantise(wheel, self._counts["wheel"]), "arm": quantise(arm, self._counts["arm"])}
        self._last = PlanarMeasurement(self.time, **positions, **imu)
        return self._last

    def _inertial(self, name: str, interval: float) -> Array:
        """A reading with its walking bias and the noise of a sample that stands for ``interval`` [s]."""
        noise, walk = self._density[name]
        draws = self._noise.normal(size=(2, 3))
        self._bias[name] = self._bias[name] + walk * np.sqrt(interval) * draws[0]
        true: Array = self.data.sensordata[self._imu[name]]
        reading: Array = true + self._bias[name] + noise / np.sqrt(interval) * draws[1]
        return reading

    # ------------------------------------------------------------------ truth
    def truth(self) -> Truth:
        """Poses, joints and the wheels' load."""
        frames = self.world.frames(height=0.0)
        return Truth(
            time=self.time,
            **frames,
            tilt=self.world.tilt,
            state=np.concatenate([frames["pose"], self.data.qpos[self._q["arm"]]]),
            joints=self.world.joints(),
            joint_speeds=self.world.joint_speeds(),
            wheel_force=np.abs(self.data.sensordata[self._forces]),
        )


def contact_settings(friction: list[float]) -> dict[str, object]:
    """Settings of a geom that rolls on the floor: massless, invisible in pictures."""
    return {"condim": 3, "friction": friction, "solref": TYRE, "rgba": [0, 0, 0, 0], "group": 3, **ROBOT}

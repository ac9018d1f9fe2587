"""What simulated robots on wheels share: body, arm, drives and sensors in MuJoCo. Wheels and what carries them are a base type's own.

Wheels are driven by velocity servos under the `discrete` integrator, and touch the floor in three-dimensional contacts whose
softness is that of tyres. The arm's weight is fed forward to its servos (as a joint torque: MuJoCo's own gravity compensation would
take the weight off the wheels).
"""

from __future__ import annotations

from collections import deque
from typing import Any

import mujoco
import numpy as np

from wbmpc.robots import RobotDescription
from wbmpc.simulation.payloads import PAYLOAD, add_body_payload, add_payload, incline
from wbmpc.simulation.perturbation import Perturbation, PlantSample
from wbmpc.simulation.world import Array, Edit, WorldAccess, add_drive, add_floor, add_light, set_options

#: Contact softness of the tyres (time constant [s], damping ratio): the odometry's scale, radius less half the sink.
TYRE = [0.01, 1.0]
#: Gain [N m s/rad] of the wheels' servos; of the arm's per N m of effort limit, but not below its floor.
WHEEL_GAIN, _ARM_GAIN, _ARM_GAIN_LEAST = 100.0, 12.0, 800.0
#: Interval [s] that sets the noise of the inertial unit's first sample.
_IMU_INTERVAL = 0.0025


def span(index: Array) -> slice | Array:
    """The same places as a slice, where they follow each other: several times as fast."""
    if index.size and (np.diff(index) == 1).all():
        return slice(int(index[0]), int(index[-1]) + 1)
    return index


class WheeledPlant(WorldAccess):
    """Subclasses set ``description``, ``base`` (its ``body``), ``timestep``, ``perturbation``, ``draw`` and ``_names``, the joints by
    group ("wheel" and "arm" among them), before they build; ``model`` and ``data`` before :meth:`index`."""

    description: RobotDescription
    base: Any
    timestep: float
    perturbation: Perturbation
    draw: PlantSample
    model: mujoco.MjModel
    data: mujoco.MjData
    _names: dict[str, list[str]]
    _noise: np.random.Generator
    _last: Any

    # ------------------------------------------------------------------ building
    def stand_on_floor(self, spec: mujoco.MjSpec) -> list[float]:
        """Perturbed masses, a floor, a free body; gives the friction (slide, spin, roll) of what rolls."""
        self.draw.apply_to_bodies(spec, balanced={spec.joint(n).parent.name for n in self._names["wheel"]})
        set_options(spec, self.timestep, mujoco.mjtIntegrator.mjINT_DISCRETE)
        friction = [self.draw.friction, 0.005, 1e-4]
        add_floor(spec, 3, friction, TYRE)
        spec.body(self.base.body).add_freejoint(name="root")
        add_light(spec.body(self.base.body))
        return friction

    def finish(self, spec: mujoco.MjSpec, edit: Edit | None) -> None:
        """The arm's servos, the inertial unit, and what the perturbation adds."""
        for name, lag in zip(self._names["arm"], self.draw.arm_lag, strict=True):
            spec.joint(name).armature, spec.joint(name).damping = 0.1, [1.0, 0, 0]
            effort = self.description.limits.effort.get(name, np.inf)
            gain = max(_ARM_GAIN_LEAST, _ARM_GAIN * effort) if np.isfinite(effort) else _ARM_GAIN_LEAST
            add_drive(spec, name, name, mujoco.mjtTrn.mjTRN_JOINT, effort, lag, gain)
        self._add_imu(spec)
        p = self.perturbation
        if p.payload > 0.0:
            add_payload(spec, self.description.arm.tool, p.payload)
        if p.body_payload > 0.0:
            add_body_payload(spec, self.base.body, p.body_payload)
        if p.slope > 0.0:
            incline(spec, p.slope, self.draw.downhill)
        if edit is not None:
            edit(spec)

    def _add_imu(self, spec: mujoco.MjSpec) -> None:
        site = "imu" if any(s.name == "imu" for s in spec.sites) else "wbmpc_imu"
        if site == "wbmpc_imu":
            spec.body(self.base.body).add_site(name=site)
        for name, kind in (("gyro", mujoco.mjtSensor.mjSENS_GYRO), ("accel", mujoco.mjtSensor.mjSENS_ACCELEROMETER)):
            spec.add_sensor(name=name, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=site)

    def index(self) -> None:
        """Where joints, drives and sensors are in MuJoCo's arrays."""
        m, names = self.model, self._names
        self._q = {g: np.array([m.joint(n).qposadr[0] for n in part], dtype=int) for g, part in names.items()}
        self._all = np.concatenate(list(self._q.values()))
        self._arm_dofs = span(np.array([m.joint(n).dofadr[0] for n in names["arm"]], dtype=int))
        self._imu = {n: slice(int(m.sensor(n).adr[0]), int(m.sensor(n).adr[0]) + 3) for n in ("gyro", "accel")}
        self._forces = np.array([m.sensor(f"contact_{n}").adr[0] + 2 for n in names["wheel"]], dtype=int)
        self.weight = float(m.body_mass.sum() * np.linalg.norm(m.opt.gravity))
        self._payload = m.body(PAYLOAD).id if self.perturbation.payload > 0.0 else None

    def start_sensors(self, offsets: dict[str, Array]) -> None:
        """Encoders with zero errors by group [rad], and the inertial unit."""
        p, draw = self.perturbation, self.draw
        self.offsets = offsets
        self._counts = {g: p.arm_counts if g == "arm" else p.encoder_counts for g in self._names}
        self._offsets = np.concatenate([offsets[g] for g in self._names])
        ends = np.cumsum([len(part) for part in self._names.values()]).tolist()
        #: where each group is among all joints
        self._parts = {g: slice(end - len(p), end) for (g, p), end in zip(self._names.items(), ends, strict=True)}
        counts = np.concatenate([np.full(len(p), self._counts[g]) for g, p in self._names.items()])
        self._exact = counts == 0
        self._count = 2.0 * np.pi / np.where(self._exact, 1, counts)
        self._bias = {"gyro": draw.gyro_bias.copy(), "accel": draw.accel_bias.copy()}
        self._density = {"gyro": (p.gyro_noise, p.gyro_walk), "accel": (p.accel_noise, p.accel_walk)}
        self._ages = round(p.encoder_jitter / self.timestep)
        self._history: deque[Array] = deque(maxlen=1 + self._ages)
        self._last = None

    def settle(self, seconds: float) -> None:
        """Sink into the tyres before time 0."""
        for _ in range(round(seconds / self.timestep)):
            self.world.advance(self.carry_arm)
        self.world.restart()
        self._history.append(self.data.qpos[self._all])

    # ------------------------------------------------------------------ running
    def carry_arm(self) -> None:
        """Feed the arm's weight forward to its joints; that of a payload, which nobody knows of, is not."""
        d, m, dofs = self.data, self.model, self._arm_dofs
        weight: Array = d.qfrc_bias[dofs]
        if self._payload is not None:
            jacobian = np.zeros((3, m.nv))
            mujoco.mj_jacBody(m, d, jacobian, None, self._payload)
            weight = weight + m.body_mass[self._payload] * m.opt.gravity @ jacobian[:, dofs]
        d.qfrc_applied[dofs] = weight

    def encoders(self) -> Array:
        """Positions of all joints by group, with their zero errors, all of one age up to the jitter, before they are quantised."""
        age = int(self._noise.integers(0, self._ages + 1))
        return np.asarray(self._history[max(len(self._history) - 1 - age, 0)] + self._offsets)

    def quantised(self, angles: Array) -> Array:
        """Angles of all joints [rad] as their encoders report them."""
        read: Array = np.rint(angles / self._count) * self._count
        return np.where(self._exact, angles, read) if self._exact.any() else read

    def inertial(self) -> dict[str, Array]:
        """ "gyro" [rad/s] and "accel" [m/s²] (3 each) with walking biases and the noise of a sample that stands for the time since the
        last message."""
        interval = _IMU_INTERVAL if self._last is None else self.time - self._last.time
        return {name: self._reading(name, interval) for name in ("gyro", "accel")}

    def _reading(self, name: str, interval: float) -> Array:
        noise, walk = self._density[name]
        draws = self._noise.normal(size=(2, 3))
        self._bias[name] = self._bias[name] + walk * np.sqrt(interval) * draws[0]
        true: Array = self.data.sensordata[self._imu[name]]
        reading: Array = true + self._bias[name] + noise / np.sqrt(interval) * draws[1]
        return reading

"""What simulated robots with an arm share: its drives and encoders in MuJoCo.

The arm's joints are velocity servos. Its weight is fed forward to them (as a joint torque: MuJoCo's own gravity compensation would take
the weight off what carries the robot).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import mujoco
import numpy as np

from wbmpc.kernel.ir import Floats, Integers
from wbmpc.kernel.step import bind
from wbmpc.robots import RobotDescription, load_spec
from wbmpc.robots.checks import named
from wbmpc.robots.couplings import followers, put_followers
from wbmpc.simulation.compilation import step
from wbmpc.simulation.payloads import PAYLOAD, add_payload
from wbmpc.simulation.perturbation import ArmPerturbation, PlantSample
from wbmpc.simulation.world import Array, World, WorldAccess, add_drive
from wbmpc.types import Edit


@step
def carry(m: int, dofs: Integers, qfrc_bias: Floats, qfrc_applied: Floats) -> None:
    """Feed the weight of the m joints whose velocities are at ``dofs`` forward to them [N m]."""
    for i in range(m):
        qfrc_applied[dofs[i]] = qfrc_bias[dofs[i]]


@step
def keep(
    n: int, rows: int, felt: int, places: Integers, qpos: Floats, history: Floats, newest: Integers, sensors: Integers,
    sensordata: Floats, sums: Floats,
) -> None:  # fmt: skip
    """The positions of n joints at ``places`` become the newest of the last ``rows`` ones, a ring: ``newest`` (2) is the number of its row,
    and how many are kept. What the ``sensors`` (felt) show goes to ``sums`` (felt + 1), whose last entry counts."""
    newest[0] = (newest[0] + 1) % rows
    newest[1] = min(newest[1] + 1, rows)
    for i in range(n):
        history[newest[0] * n + i] = qpos[places[i]]
    for i in range(felt):
        sums[i] += sensordata[sensors[i]]
    sums[felt] += 1.0


#: Gain [N m s/rad] of the servos per N m of effort limit, but not below its floor; floor of those that slide [N s/m].
_ARM_GAIN, _MIN_ARM_GAIN, _SLIDE_GAIN = 12.0, 800.0, 2e4


def span(index: Array) -> slice | Array:
    """The same places as a slice, where they follow each other: several times as fast."""
    if index.size and (np.diff(index) == 1).all():
        return slice(int(index[0]), int(index[-1]) + 1)
    return index


class ArmPlant(WorldAccess):
    """Subclasses set ``description``, ``timestep``, ``perturbation`` and ``_names``, the joints by group ("arm" among them), before
    :meth:`make_world`."""

    description: RobotDescription
    timestep: float
    perturbation: ArmPerturbation
    draw: PlantSample
    model: mujoco.MjModel
    data: mujoco.MjData
    _names: dict[str, list[str]]
    _noise: np.random.Generator
    _last: Any

    # ------------------------------------------------------------------ building
    def make_world(self, seed: int, wheels: int, edit: Edit | None, speeds: Mapping[str, float]) -> None:
        """The perturbed world with all ``_names``: :meth:`build` says what is in it. ``wheels``: how many have errors of their own;
        ``speeds`` [rad/s] of drives by joint, where they are limited."""
        draw_rng, self._noise = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2))
        spec = load_spec(self.description, meshes=True)
        bodies = [b.name for b in spec.bodies if b.name != "world"]
        self.draw = self.perturbation.draw(draw_rng, bodies, wheels, len(self._names["arm"]))
        with named(self.description.model):
            self.build(spec, edit)
        names = [n for group in self._names.values() for n in group]
        self.world = World(spec, self.description, names, {n: speeds.get(n, np.inf) for n in names})
        self.model, self.data = self.world.model, self.world.data
        self.index()

    def build(self, spec: mujoco.MjSpec, edit: Edit | None) -> None:
        """Put floor, drives and sensors into a specification, then :meth:`finish` it."""
        raise NotImplementedError

    def finish(self, spec: mujoco.MjSpec, edit: Edit | None) -> None:
        """The arm's servos, and what the perturbation adds."""
        for name, lag in zip(self._names["arm"], self.draw.arm_lag, strict=True):
            spec.joint(name).armature, spec.joint(name).damping = 0.1, [1.0, 0, 0]
            effort = self.description.limits.effort.get(name, np.inf)
            slides = spec.joint(name).type == mujoco.mjtJoint.mjJNT_SLIDE
            minimum = _SLIDE_GAIN if slides else _MIN_ARM_GAIN
            gain = max(minimum, _ARM_GAIN * effort) if np.isfinite(effort) else minimum
            add_drive(spec, name, name, mujoco.mjtTrn.mjTRN_JOINT, effort, lag, gain)
        p = self.perturbation
        if p.payload > 0.0:
            add_payload(spec, self.description.arm.tool, p.payload)
        if edit is not None:
            edit(spec)

    def index(self) -> None:
        """Where joints are in MuJoCo's arrays."""
        m, names = self.model, self._names
        self._q = {g: np.array([m.joint(n).qposadr[0] for n in part], dtype=int) for g, part in names.items()}
        self._all = np.concatenate(list(self._q.values()))
        self._arm_dofs = span(np.array([m.joint(n).dofadr[0] for n in self._carried()], dtype=int))
        self._arm_drives = span(np.array([m.actuator(n).id for n in names["arm"]], dtype=int))
        self.weight = float(m.body_mass.sum() * np.linalg.norm(m.opt.gravity))
        leaders = {m.joint(n).id: i for i, n in enumerate(names["arm"])}
        places = {m.joint(n).id: k for k, n in enumerate(self.description.couple)}
        self._shares = np.zeros((len(leaders), len(places)))
        for follower, leader, ratio, _ in followers(m):
            self._shares[leaders[leader], places[follower]] = ratio
        self._payload = m.body(PAYLOAD).id if self.perturbation.payload > 0.0 else None

    def _carried(self) -> list[str]:
        """Joints whose weight is fed forward: the arm's, and those that follow them."""
        return [*self._names["arm"], *self.description.couple]

    def start_sensors(self, offsets: dict[str, Array]) -> None:
        """Encoders with zero errors by group [rad]."""
        p = self.perturbation
        self.offsets = offsets
        self._counts = {g: self.counts(g) for g in self._names}
        self._offsets = np.concatenate([offsets[g] for g in self._names])
        ends = np.cumsum([len(part) for part in self._names.values()]).tolist()
        #: where each group is among all joints
        self._parts = {g: slice(end - len(p), end) for (g, p), end in zip(self._names.items(), ends, strict=True)}
        counts = np.concatenate([np.full(len(p), self._counts[g]) for g, p in self._names.items()])
        self._exact = counts == 0
        self._some_exact = bool(self._exact.any())
        self._count = 2.0 * np.pi / np.where(self._exact, 1, counts)
        self._ages = round(p.encoder_jitter / self.timestep)
        self._last = None
        self._bind_steps()

    def counts(self, group: str) -> int:
        """Counts per turn of the encoders of a group of joints, 0: exact. Those of the base are a subclass's."""
        return self.perturbation.arm_counts

    def set_zeros(self, found: Array) -> None:
        """Take what a calibration found (m) [rad or m] of the arm's zeros out of what its encoders read from now on."""
        self.offsets = {**self.offsets, "arm": self.offsets["arm"] - found}
        self._offsets[self._parts["arm"]] -= found
        self._last = None

    def _bind_steps(self) -> None:
        """What every physics step calls: ``_control`` before it, ``_keep`` after it."""
        m, d = self.model, self.data
        dofs = np.array([m.joint(n).dofadr[0] for n in self._carried()], dtype=np.int64)
        arrays = {"dofs": dofs, "qfrc_bias": d.qfrc_bias, "qfrc_applied": d.qfrc_applied}
        plain: Callable[[], None] = bind(carry, arrays, m=len(dofs)).call
        self._carry = plain if self._payload is None else self._carry_unloaded
        n, rows = len(self._all), 1 + self._ages
        self._history, self._newest = np.zeros((rows, n)), np.zeros(2, dtype=np.int64)
        ring = {"places": self._all.astype(np.int64), "qpos": d.qpos, "history": self._history, "newest": self._newest}
        sensors = np.array(self._averaged(), dtype=np.int64)
        self._sums = np.zeros(len(sensors) + 1)
        ring |= {"sensors": sensors, "sensordata": d.sensordata, "sums": self._sums}
        self._keep: Callable[[], None] = bind(keep, ring, n=n, rows=rows, felt=len(sensors)).call

    def _averaged(self) -> list[int]:
        """Places of MuJoCo's sensors of which a message has the mean since the one before."""
        return []

    def settle(self, seconds: float) -> None:
        """Come to rest before time 0, coupled joints where their leaders are."""
        put_followers(self.model, self.data)
        self.world.advance(self.carry_arm, round(seconds / self.timestep))
        self.world.restart()
        self._keep()

    # ------------------------------------------------------------------ running
    def carry_arm(self) -> None:
        """Feed the arm's weight forward to its joints; what else acts in every physics step is a subclass's."""
        self._carry()

    def _carry_unloaded(self) -> None:
        """Feed the arm's weight forward to its joints without that of an unknown payload."""
        d, m, dofs = self.data, self.model, self._arm_dofs
        jacobian = np.zeros((3, m.nv))
        mujoco.mj_jacBody(m, d, jacobian, None, self._payload)
        weight: Array = d.qfrc_bias[dofs] + m.body_mass[self._payload] * m.opt.gravity @ jacobian[:, dofs]
        d.qfrc_applied[dofs] = weight

    def encoders(self) -> Array:
        """Positions of all joints by group, with their zero errors, all of one age up to the jitter, before they are quantized."""
        age, (newest, kept) = int(self._noise.integers(0, self._ages + 1)), self._newest.tolist()
        read: Array = self._history[(newest - min(age, kept - 1)) % len(self._history)] + self._offsets
        return read

    def quantized(self, angles: Array) -> Array:
        """Angles of all joints [rad] as their encoders report them."""
        read: Array = np.rint(angles / self._count) * self._count
        return np.where(self._exact, angles, read) if self._some_exact else read

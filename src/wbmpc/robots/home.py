"""A posture to start from, found by trying many."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from wbmpc.arrays import Array
from wbmpc.robots.mechanism import Mechanism

#: Postures that are tried, of which so many of the best are checked for collisions.
TRIED, LOOKED_AT = 2000, 40
#: Share of each range, at both ends, that a home keeps away from; half range [rad] of a continuous joint.
MARGIN, TURNS = 0.15, np.pi
#: Of an arm that may work at any height: share of its reach above the floor at which its lowest joint is high enough, and what lower
#: postures count at least. Plans keep arms off the floor, and who starts near it can hardly go down.
HIGH, LOW = 0.25, 0.05
#: Joints that move by less [m] are not lifted.
STILL = 1e-6
#: Rotation counts as so much [m] per radian in manipulability; spread [m] about the working height; fastest joint [rad/s or m/s] that counts.
LEVER, SPREAD, FAST = 0.4, 0.3, 2.0
#: Singular values are none below this share of the largest.
_RANK = 1e-6


@dataclass(frozen=True)
class Home:
    """``angles`` by joint [rad or m]; ``tool`` (3) [m] above the file's world; ``free``: whether the shapes of the file show no collision;
    None where it has none."""

    angles: dict[str, float]
    tool: Array
    free: bool | None


def find_home(
    mechanism: Mechanism, joints: tuple[str, ...], tool: str, held: dict[str, float], height: float | None,
    forward: Array, seed: int = 0, floor: float = 0.0,
) -> Home:  # fmt: skip
    """The best of random postures of ``joints`` with the others ``held``: manipulability, the tool ahead (along ``forward`` (2)) and at
    ``height`` [m] (None: wherever, well above the ``floor`` [m]), away from the ends of ranges and without collision of the file's
    shapes."""
    search = _Search(mechanism, joints, tool, held)
    rng = np.random.default_rng(seed)
    share = rng.uniform(MARGIN, 1.0 - MARGIN, (TRIED, len(joints)))
    postures = search.low + share * (search.high - search.low)
    at, quality, lowest = search.evaluate(postures)
    middle = np.median(at, axis=0)
    reach = max(float(np.quantile(np.linalg.norm(at - middle, axis=1), 0.98)), 1e-6)
    ahead = np.clip((at - middle)[:, :2] @ forward / reach + 0.2, 0.05, 1.0)
    if height is None:
        level = np.clip((lowest - floor) / (HIGH * reach), LOW, 1.0)
    else:
        level = np.exp(-(((at[:, 2] - height) / SPREAD) ** 2))
    score = quality * ahead * level * np.prod(1.0 - (2.0 * share - 1.0) ** 4, axis=1)
    best = np.argsort(-score)[:LOOKED_AT]
    free = search.free(postures[best])
    chosen = int(best[0] if free is None or not free.any() else best[int(np.argmax(free))])
    angles = {name: round(float(q), 3) for name, q in zip(joints, postures[chosen], strict=True)}
    return Home(angles, at[chosen], None if free is None else bool(free.any()))


class _Search:
    """Kinematics and collisions of one arm in MuJoCo's numbers."""

    def __init__(self, mechanism: Mechanism, joints: tuple[str, ...], tool: str, held: dict[str, float]) -> None:
        m = self.model = mechanism.model
        self.data = mujoco.MjData(m)
        self._joint = [m.joint(n).id for n in joints]
        self._q = m.jnt_qposadr[self._joint]
        self._v = m.jnt_dofadr[self._joint]
        #: of coupled joints: number, that of the leader in ``joints``, ratio, offset
        self._followers = [
            (m.joint(j.name).id, joints.index(j.drive.mimics), j.drive.ratio, j.drive.offset)
            for j in mechanism.joints.values()
            if j.drive.mimics in joints and j.name not in joints
        ]
        for name, value in held.items():
            self.data.qpos[m.jnt_qposadr[m.joint(name).id]] = value
        self._site = mujoco.mj_name2id(m, mujoco.mjtObj.mjOBJ_SITE, tool)
        self._body = m.body(tool).id if self._site < 0 else int(m.site_bodyid[self._site])
        ranges = [mechanism.joints[n].range or (-TURNS, TURNS) for n in joints]
        self.low = np.array([max(low, -TURNS) for low, _ in ranges])
        self.high = np.array([min(high, TURNS) for _, high in ranges])
        for follower, leader, ratio, offset in self._followers:
            if m.jnt_limited[follower] and ratio:
                ends = np.sort((m.jnt_range[follower] - offset) / ratio)
                self.low[leader] = max(self.low[leader], ends[0])
                self.high[leader] = min(self.high[leader], ends[1])
        speeds = [mechanism.joints[n].drive.velocity or FAST for n in joints]
        self._speed = np.minimum(speeds, FAST)

    def evaluate(self, postures: Array) -> tuple[Array, Array, Array]:
        """Positions (n, 3) [m] of the tool, manipulability (n), heights (n) [m] of the lowest of the tool and the joints that others lift."""
        at, values = np.zeros((len(postures), 3)), np.zeros((len(postures), min(6, len(self._joint))))
        m, d = self.model, self.data
        heights = np.zeros((len(postures), len(self._joint) + 1))
        jacobian = np.zeros((6, m.nv))
        for k, posture in enumerate(postures):
            self._pose(d.qpos, posture)
            mujoco.mj_kinematics(m, d)
            mujoco.mj_comPos(m, d)
            at[k] = d.xpos[self._body] if self._site < 0 else d.site_xpos[self._site]
            heights[k] = *d.xpos[m.jnt_bodyid[self._joint], 2], at[k, 2]
            mujoco.mj_jac(m, d, jacobian[:3], jacobian[3:], at[k], self._body)
            columns = jacobian[:, self._v]
            for follower, leader, ratio, _ in self._followers:
                columns[:, leader] += ratio * jacobian[:, m.jnt_dofadr[follower]]
            speeds = columns * self._speed
            speeds[3:] *= LEVER
            values[k] = np.linalg.svd(speeds, compute_uv=False)
        independent = int(np.max(np.sum(values > _RANK * values.max(), axis=1)))  # joints of a telescope move one way
        lifted = np.ptp(heights, axis=0) > STILL
        lifted[-1] = True
        return at, values[:, max(independent, 1) - 1], heights[:, lifted].min(axis=1)

    def _pose(self, q: Array, posture: Array) -> None:
        """Write a posture, and what follows it, to all positions."""
        q[self._q] = posture
        for follower, leader, ratio, offset in self._followers:
            q[self.model.jnt_qposadr[follower]] = ratio * posture[leader] + offset

    def free(self, postures: Array) -> NDArray[np.bool_] | None:
        """Which postures have no shapes in each other, but for those that are so where the file draws them; None where no shapes could
        meet."""
        if np.count_nonzero(self.model.geom_contype & self.model.geom_conaffinity) < 2:
            return None
        drawn, found = self._touching(np.array(self.model.qpos0)), []
        posed = self.data.qpos.copy()
        for posture in postures:
            self._pose(posed, posture)
            found.append(not (self._touching(posed) - drawn))
        return np.array(found)

    def _touching(self, q: Array) -> set[tuple[int, int]]:
        """Pairs of rigid parts whose shapes are in each other."""
        self.data.qpos[:] = q
        return touching_parts(self.model, self.data)


def touching_parts(model: mujoco.MjModel, data: mujoco.MjData) -> set[tuple[int, int]]:
    """Pairs of rigid parts whose shapes are in each other at ``data.qpos``, and forward kinematics of these positions."""
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_collision(model, data)
    pairs = data.contact.geom[data.contact.dist < 0.0]
    parts = np.unique(np.sort(model.body_weldid[model.geom_bodyid[pairs]], axis=1), axis=0)
    return {(a, b) for a, b in parts.tolist() if a != b}

"""A simulated tracker that sees end effectors in axes of the base, at postures of the arm at rest: what its zeros are calibrated by."""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco
import numpy as np

from wbmpc.arrays import Array
from wbmpc.errors import InputError
from wbmpc.robots.couplings import put_followers
from wbmpc.robots.home import touching_parts
from wbmpc.simulation.arm import ArmPlant
from wbmpc.simulation.perturbation import quantize

if TYPE_CHECKING:
    from wbmpc.model.robot import RobotModel

#: Noise [m] of the tracker; how far [rad or m] joints go from home, within their ranges.
TRACKER, SPREAD = 1e-4, 0.7
#: Random postures for one in which no parts are in each other, at most.
TRIED = 200


def track_arm(robot: RobotModel, plant: ArmPlant, poses: int, seed: int) -> tuple[Array, dict[str, Array]]:
    """What the arm's encoders read (poses, m) [rad or m], and by frame where a tracker sees each end effector (poses, 3) [m], in axes of the
    base's body, with a standard deviation of :data:`TRACKER`. The simulated robot itself stays as it is. Raises :class:`InputError`
    where hardly any posture about home is free."""
    model, data, rng = plant.model, mujoco.MjData(plant.model), np.random.default_rng([seed, 3])
    data.qpos[:] = plant.data.qpos
    joints = [model.joint(name) for name in robot.description.arm.joints]
    places, body = [int(j.qposadr[0]) for j in joints], model.body(robot.description.base.body).id
    part = robot.state["arm"]
    low = np.maximum(robot.home[part] - SPREAD, robot.limits.state_lower[part])
    high = np.minimum(robot.home[part] + SPREAD, robot.limits.state_upper[part])
    data.qpos[places] = robot.home[part]
    at_home = _touching(model, data)
    read, seen = list[Array](), {frame: list[Array]() for frame in robot.tools.values()}
    for _ in range(TRIED * poses):
        if len(read) == poses:
            break
        data.qpos[places] = rng.uniform(low, high)
        if _touching(model, data) - at_home:
            continue
        read.append(quantize(data.qpos[places] + plant.offsets["arm"], plant.perturbation.arm_counts))
        axes, origin = data.xmat[body].reshape(3, 3), data.xpos[body]
        for frame, rows in seen.items():
            rows.append((_place(model, data, frame) - origin) @ axes + TRACKER * rng.normal(size=3))
    if len(read) < poses:
        raise InputError(
            f"{robot.description.name}: of {TRIED * poses} postures within {SPREAD:g} of home (key 'home') {len(read)} are without parts in "
            f"each other; {poses} are needed to track the arm"
        )
    return np.array(read), {frame: np.array(rows) for frame, rows in seen.items()}


def _touching(model: mujoco.MjModel, data: mujoco.MjData) -> set[tuple[int, int]]:
    """Pairs of rigid parts whose shapes are in each other at the arm's positions, and forward kinematics of these."""
    put_followers(model, data)
    return touching_parts(model, data)


def _place(model: mujoco.MjModel, data: mujoco.MjData, frame: str) -> Array:
    """Position (3) [m] in the world of a site or body."""
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, frame)
    return np.array(data.site_xpos[site] if site >= 0 else data.xpos[model.body(frame).id])

"""Calibrations of reference drives, kept on disk: many experiments begin with the same drive of the same simulated robot."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
from pydantic import BaseModel

import wbmpc
from wbmpc.estimation.wheel_calibration import WheelCalibration
from wbmpc.kernel import cache
from wbmpc.kernel.codegen_target import target_text
from wbmpc.model.robot import RobotModel
from wbmpc.robots import load_spec


def kept(robot: RobotModel, settings: BaseModel, seed: int, make: Callable[[], WheelCalibration]) -> WheelCalibration:
    """What ``make`` gives, which depends on nothing but the robot, the settings, the seed and the programs: from the cache of compiled code
    where it has been made before."""
    key, n = _key(robot, settings, seed), robot.base.geometry.modules
    found = cache.load(key)
    if found is not None:
        values = np.frombuffer(found[0])
        steer, leg, radius = (part.copy() for part in np.split(values[: 3 * n], 3))
        return WheelCalibration(steer, leg, radius, values[3 * n :].reshape(2 * n, 2 * n).copy())
    made = make()
    parts = (made.steer_offset, made.leg_offset, made.wheel_radius, made.covariance.ravel())
    cache.save(key, np.concatenate(parts).tobytes(), {"calibration": robot.description.name, "seed": seed})
    return made


def _key(robot: RobotModel, settings: BaseModel, seed: int) -> str:
    """Hash of all that a drive depends on: the robot with its meshes, the settings, the seed, sources and versions of the programs."""
    model = load_spec(robot.description, meshes=True).compile()
    bodies = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, bodies)
    package = Path(wbmpc.__file__).parent
    rooms = tuple(sorted({str(path.parent.relative_to(package)) for path in package.rglob("*.py")}))
    digest = hashlib.sha256(bodies.tobytes())
    for text in (
        robot.description.model_dump_json(), settings.model_dump_json(), str(seed), cache.source_fingerprint(rooms),
        mujoco.__version__, np.__version__, target_text(),
    ):  # fmt: skip
        digest.update(f"{len(text)} {text}".encode())
    return digest.hexdigest()

"""Calibrations of reference drives, kept on disk: many experiments begin with the same drive of the same simulated robot."""

from __future__ import annotations

import hashlib
import inspect
import zlib
from collections.abc import Callable, Mapping
from io import BytesIO
from pathlib import Path
from zipfile import BadZipFile

import mujoco
import numpy as np
from pydantic import BaseModel

import wbmpc
from wbmpc.arrays import Array
from wbmpc.bases import base_type
from wbmpc.kernel import cache
from wbmpc.kernel.codegen_target import target_text
from wbmpc.model.robot import RobotModel
from wbmpc.robots import load_spec


def kept(
    robot: RobotModel, settings: BaseModel, seed: int, make: Callable[[], Mapping[str, Array]]
) -> dict[str, Array]:
    """What ``make`` gives, which depends on nothing but the robot, the settings, the seed and the programs: from the cache of compiled code
    where it has been made before."""
    key = _key(robot, settings, seed)
    found = cache.load(key)
    if found is not None:
        try:
            with np.load(BytesIO(found[0]), allow_pickle=False) as arrays:
                return dict(arrays)
        except (ValueError, TypeError, AttributeError, OSError, EOFError, BadZipFile, zlib.error):
            cache.report_damaged(key)
    made, file = dict(make()), BytesIO()
    np.savez(file, allow_pickle=False, **made)
    cache.save(key, file.getvalue(), {"calibration": robot.description.name, "seed": seed})
    return made


def plugin_folders(robot: RobotModel) -> set[str]:
    """Folders with the source of the robot's base type, which may belong to another package."""
    plugin = type(base_type(robot.description.base.type))
    folder = Path(inspect.getfile(plugin)).resolve().parent
    inner = folder.rglob("*.py") if "." in plugin.__module__ else ()
    return {str(folder), *(str(path.parent) for path in inner)}


def _key(robot: RobotModel, settings: BaseModel, seed: int) -> str:
    """Hash of all that a drive depends on: the robot with its meshes, the settings, the seed, sources and versions of the programs."""
    model = load_spec(robot.description, meshes=True).compile()
    bodies = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, bodies)
    package = Path(wbmpc.__file__).parent
    packages = {str(path.parent.relative_to(package)) for path in package.rglob("*.py")} | plugin_folders(robot)
    digest = hashlib.sha256(bodies.tobytes())
    for text in (
        robot.description.model_dump_json(), settings.model_dump_json(), str(seed), cache.source_fingerprint(tuple(sorted(packages))),
        mujoco.__version__, np.__version__, target_text(),
    ):  # fmt: skip
        digest.update(f"{len(text)} {text}".encode())
    return digest.hexdigest()

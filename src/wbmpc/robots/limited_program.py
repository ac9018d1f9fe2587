"""A program of its own for what a file from outside makes slow or large: see :mod:`wbmpc.robots.limited_process`.

Reads an order as JSON from its input and writes an answer: ``{path, packages, arguments}`` expands the macros of a file, ``{path}`` or
``{text}`` with ``files`` compiles a model as a trial. Imports of the package would cost more than the work.
"""

from __future__ import annotations

import ctypes
import io
import json
import math
import os
import resource
import signal
import sys
from contextlib import redirect_stderr, redirect_stdout
from os.path import isfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import mujoco

#: Of the program's memory [bytes].
MEMORY = 2 * 1024**3
_PR_SET_PDEATHSIG = 1
_OF_MEMORY = ("memory", "nconmax", "njmax", "nstack")


def limit(seconds: float) -> None:
    """From now on: so much time of the processor [s], :data:`MEMORY`, and no file of a crash."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    end = math.ceil(used.ru_utime + used.ru_stime + seconds)
    resource.setrlimit(resource.RLIMIT_CPU, (end, end + 1))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def end_with(parent: int) -> None:
    """End when the process ``parent`` does."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # it has ended before
        sys.exit(1)


# ---------------------------------------------------------------------- macros
def expand(order: dict[str, Any]) -> dict[str, str]:
    """``{text}`` without macros, or ``{error}``."""
    limit(order["processor"])
    import xacrodoc  # it also replaces the search for ROS packages of the module below
    import xacro  # isort: skip

    xacrodoc.packages.reset()
    xacrodoc.packages.walk_up_from(Path(order["path"]))
    xacrodoc.packages.update_package_cache({name: Path(folder) for name, folder in order["packages"].items()})
    said = io.StringIO()
    try:
        with redirect_stdout(said), redirect_stderr(said):
            return {"text": str(xacro.process_file(order["path"], mappings=order["arguments"]).toxml())}
    except (Exception, SystemExit) as error:  # whatever its expressions raise
        return {"error": f"{type(error).__name__}: {error} {said.getvalue()}"}


# ---------------------------------------------------------------------- a trial
def compile_model(order: dict[str, Any]) -> dict[str, str]:
    """Compile a model, or what the parent will compile if it is wrong: without shapes and inertias. Errors the parent finds as well."""
    import mujoco

    limit(order["processor"])
    mujoco.set_mju_user_warning(lambda text: None)  # else it writes a file; the parent warns
    for whole in (True, False):
        try:
            if "text" in order:
                spec = mujoco.MjSpec.from_string(order["text"])
            else:
                spec = mujoco.MjSpec.from_file(order["path"])
                drop_missing_files(spec)
            strip_actuators_and_options(spec)
            for element in [*spec.sensors, *spec.keys, *(() if whole else spec.geoms)]:
                spec.delete(element)
            for body in [] if whole else spec.bodies[1:]:
                body.explicitinertial, body.mass, body.inertia = True, 1.0, [1.0, 1.0, 1.0]
            spec.compile()
        except ValueError:
            continue
        break
    return {}


def drop_missing_files(spec: mujoco.MjSpec) -> list[str]:
    """Take meshes, pictures and fields out of an MJCF whose files are missing, with the shapes that need them; returns their names."""
    home, gone = Path(spec.modelfiledir or "."), []
    for kind, folder in (("meshes", spec.meshdir), ("hfields", spec.meshdir), ("textures", spec.texturedir)):
        for asset in list(getattr(spec, kind)):
            files = [asset.file, *getattr(asset, "cubefiles", ())]
            missing = [f for f in files if f and not isfile(home / folder / f)]
            if missing:
                gone += missing
                _drop(spec, kind, asset)
    return gone


def _drop(spec: mujoco.MjSpec, kind: str, asset: object) -> None:
    name = getattr(asset, "name", "") or Path(getattr(asset, "file", "")).stem
    if kind == "textures":
        for material in spec.materials:
            material.textures = ["" if t == name else t for t in material.textures]
    key = {"meshes": "meshname", "hfields": "hfieldname"}.get(kind)
    for geom in list(spec.geoms) if key else []:
        if getattr(geom, key or "") == name:
            spec.delete(geom)
    spec.delete(asset)


def strip_actuators_and_options(spec: mujoco.MjSpec) -> None:
    """Remove, in place, the memory sizes and options that a file requests, and its actuators. Call it before anything is compiled."""
    import mujoco

    fresh = mujoco.MjSpec()
    copy_values(fresh.option, spec.option)
    spec.stat.meaninertia = fresh.stat.meaninertia  # the constraint solver's scale
    for name in _OF_MEMORY:  # a file may ask for more than there is
        setattr(spec, name, getattr(fresh, name))
    for actuator in list(spec.actuators):  # whose ranges the compiler may look for in long simulations
        spec.delete(actuator)


#: Of MuJoCo's wrappers: what is no value of the element.
_NO_VALUE = {"alt", "classname", "compiler", "frame", "id", "info", "name", "parent", "plugin", "signature", "userdata"}


def copy_values(source: Any, target: Any) -> None:
    """The values of one element of a specification into another one."""
    for name in set(dir(source)) - _NO_VALUE:
        if not name.startswith("_") and not callable(getattr(source, name)):
            setattr(target, name, getattr(source, name))


def main() -> None:
    """Do what the order says."""
    order = json.load(sys.stdin)
    end_with(order["parent"])
    json.dump(expand(order) if "packages" in order else compile_model(order), sys.stdout)


if __name__ == "__main__":
    main()

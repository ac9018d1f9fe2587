"""Obstacles from a YAML file: a mapping ``obstacles`` of names to shapes and poses."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from wbmpc import checks
from wbmpc.configuration import has_truths
from wbmpc.errors import InputError, unknown_name
from wbmpc.obstacles.shapes import Box, Capsule, ConvexMesh, Cylinder, HalfSpace, Shape, Sphere
from wbmpc.yaml_file import load_yaml

#: Shapes by what a file calls them, and the keys that each needs; the others are optional.
_SHAPES: dict[str, tuple[type[Any], tuple[str, ...], tuple[str, ...]]] = {
    "sphere": (Sphere, ("radius",), ("center",)), "capsule": (Capsule, ("a", "b", "radius"), ()),
    "cylinder": (Cylinder, ("a", "b", "radius"), ()), "box": (Box, ("half",), ("center", "orientation")),
    "half_space": (HalfSpace, ("normal",), ("offset",)), "convex_mesh": (ConvexMesh, ("vertices",), ()),
}  # fmt: skip
_PLACES = ("position", "orientation", "velocity", "std", "velocity_std", "ignore")
#: What only a simulated scene has.
_SIMULATED = ("appears",)


@dataclass(frozen=True)
class SceneObstacle:
    """An obstacle of a scene: its ``name``, ``shape`` and ``place``, further arguments of :meth:`wbmpc.obstacles.world.Obstacles.set`. It
    ``appears`` at a time [s] of the simulation, and moves from then on. ``where``: for errors, where it stands in a file."""

    name: str
    shape: Shape
    place: Mapping[str, Any]
    appears: float = 0.0
    where: str = ""


def read_scene(path: str | Path, simulated: bool = False) -> Iterator[SceneObstacle]:
    """The obstacles of a YAML file.

    ``obstacles: {pillar: {cylinder: {a: [2, 0, 0], b: [2, 0, 1.5], radius: 0.1}, velocity: [0, 0.2, 0]}}``: one shape each (sphere,
    capsule, cylinder, box, half_space, convex_mesh), and position, orientation, velocity, std, velocity_std, ignore; of a ``simulated`` scene
    also ``appears`` [s]. Raises :class:`InputError` naming file, obstacle and key.
    """
    if not isinstance(path, str | Path):
        raise InputError(f"obstacles: the path of a file is needed, got {path!r}")
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: there is no such file")
    data = load_yaml(path)
    section = data.get("obstacles") if isinstance(data, Mapping) and set(data) == {"obstacles"} else None
    if not isinstance(section, Mapping):
        raise InputError(f"{path}: one key is needed, 'obstacles', with a mapping of names")
    names = [str(name) for name in section]
    for name, entry in section.items():
        if isinstance(name, bool) or not isinstance(name, str | int) or not str(name).isprintable():
            raise InputError(f"{path}: key 'obstacles': a name that can be printed is needed, got {name!r:.80}")
        where = f"{path}: key 'obstacles.{name}'"
        if names.count(str(name)) > 1:  # 1 and "1" are two keys
            raise InputError(f"{where}: appears twice")
        if not isinstance(entry, Mapping):
            raise InputError(f"{where}: a mapping with a shape is needed, got {entry!r:.80}")
        if has_truths(entry):  # NumPy takes them for 1 and 0
            raise InputError(f"{where}: numbers are needed, not true or false")
        keys = (*_PLACES, *_SIMULATED) if simulated else _PLACES
        shape, appears = _shape(where, entry, keys), entry.get("appears", 0.0)
        if checks.absolute_time(f"{where}: 'appears'", appears) < 0.0:
            raise InputError(f"{where}: 'appears' must not be negative, got {appears}")
        yield SceneObstacle(str(name), shape, {k: v for k, v in entry.items() if k in _PLACES}, float(appears), where)


def _shape(where: str, entry: Mapping[Any, Any], keys: tuple[str, ...]) -> Shape:
    kinds = [k for k in entry if k in _SHAPES]
    for key in entry:
        if key not in _SHAPES and key not in keys:
            raise unknown_name("key", str(key), [*_SHAPES, *keys], where=where)
    if len(kinds) != 1:
        raise InputError(f"{where}: one shape is needed, got {len(kinds)}; valid: {', '.join(_SHAPES)}")
    where = f"{where[:-1]}.{kinds[0]}'"
    shape, needed, optional = _SHAPES[kinds[0]]
    values = entry[kinds[0]]
    if not isinstance(values, Mapping):
        raise InputError(f"{where}: a mapping of {', '.join((*needed, *optional))} is needed")
    for key in values:
        if key not in (*needed, *optional):
            raise unknown_name("key", str(key), (*needed, *optional), where=f"{where}")
    missing = [k for k in needed if k not in values]
    if missing:
        raise InputError(f"{where}: '{missing[0]}' is missing")
    try:
        found: Shape = shape(**values)
    except (InputError, TypeError, ValueError) as error:
        raise InputError(f"{where}: {error}") from error
    return found

"""A robot's URDF, xacro or MJCF, read into an editable MuJoCo specification without what planning does not need.

A trial of models that may take long to compile, before this process compiles them.

MuJoCo's parser and compiler cannot be interrupted. Models of plain elements take some milliseconds, whatever is in them (what repeats
or attaches parts, meshes, pictures, fields and what is soft is not plain), and those of the package are known. Any other is compiled
in a process of its own with limits of time and memory. One that has passed is not tried again: by the hash of all its files.
"""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Iterable, Mapping
from copy import copy, deepcopy
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import count, islice
from os.path import isfile
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import mujoco
import numpy as np

from wbmpc.checks import parse_number
from wbmpc.errors import InputError
from wbmpc.input_file import read_file
from wbmpc.robots.file_limits import LARGEST, LARGEST_MESH, check_size
from wbmpc.robots.limited_process import OutOfTime, run_limited
from wbmpc.robots.limited_program import drop_missing_files
from wbmpc.robots.read_once import once, remembers
from wbmpc.robots.urdf_tree import check_tree
from wbmpc.robots.xacro_file import expand, find_package, has_macros, locate, package_of
from wbmpc.robots.xml_text import MAX_TAGS, tokens

if TYPE_CHECKING:
    from wbmpc.robots.description import RobotDescription

_OWN = Path(__file__).with_name("data").resolve()
_TAG = re.compile(rb"<\s*/?\s*([^\s/>]*)")
#: Bytes of one file that a model names, at most.
LARGEST_NAMED = 256 * 1024 * 1024
#: Elements that are compiled in no time, of MJCF and URDF.
_PLAIN = frozenset(
    b"""?xml mujoco mujocoinclude include compiler option flag size statistic default worldbody body frame inertial joint freejoint geom
    site camera light actuator motor position velocity general damper sensor jointpos jointvel framepos framequat accelerometer gyro
    force torque touch contact exclude pair equality connect weld keyframe key visual global quality headlight map scale rgba
    robot link origin mass inertia collision geometry box cylinder sphere capsule material color parent child axis limit dynamics
    mimic calibration safety_controller""".split()
)


def try_model(path: Path, files: Iterable[Path], text: str | None = None) -> None:
    """Raise :class:`InputError` for a model that takes too long to compile, or too much memory. ``files``: the model, and all that it
    names; ``text``: of the model, where it is not in the file itself."""
    if _OWN in path.resolve().parents:
        return
    key = tuple((str(f), f.stat().st_mtime_ns, f.stat().st_size) for f in files)
    _try(str(path), key, text)


@lru_cache(maxsize=32)
def _try(path: str, files: tuple[tuple[str, int, int], ...], text: str | None) -> None:
    if all(
        map(
            _is_plain,
            [text.encode()] if text is not None else (read_file(Path(name), LARGEST_NAMED) for name, _, _ in files),
        )
    ):
        return
    order = {"path": path} if text is None else {"text": text}
    try:
        answer = run_limited(order)
    except OutOfTime as limit:
        raise InputError(
            f"{path}: MuJoCo does not compile it within {limit}; smaller or fewer meshes, fields, pictures and flexible bodies are needed"
        ) from None
    if "error" in answer:
        raise InputError(f"{path}: MuJoCo cannot compile it: {' '.join(str(answer['error']).split())[:300]}")


def _is_plain(content: bytes) -> bool:
    """By its bytes, however a parser understands them: every < begins a plain element, an end or a comment."""
    names = (tag[1] for tag in islice(_TAG.finditer(content), MAX_TAGS))
    return all(n in _PLAIN or n.startswith(b"!--") for n in names)


_LOG = logging.getLogger(__name__)


def log_warnings() -> None:
    mujoco.set_mju_user_warning(lambda text: _LOG.warning("MuJoCo: %s", text))


#: Meshes that MuJoCo reads.
MESHES = (".stl", ".obj", ".msh")
#: Group of shapes that are not drawn.
HIDDEN = 3
#: Ends of a joint's range [rad, degrees or m] that are none.
_WIDEST_RANGE = 1e6
#: Elements of a URDF that MuJoCo reads.
_READ = ("link", "joint", "material", "mujoco")


@dataclass(frozen=True)
class ModelFile:
    """``path`` of the file; ``root``: a URDF, its macros expanded, or None of an MJCF; ``packages``: folders of ROS packages by name;
    ``macros``: whether there were any; ``files``: an MJCF's own and those that it names."""

    path: Path
    root: ElementTree.Element | None
    packages: Mapping[str, Path] = field(default_factory=dict)
    macros: bool = False
    files: tuple[Path, ...] = ()
    _homes: dict[str, Path | None] = field(default_factory=dict, compare=False, repr=False)

    def meshes(self) -> list[str]:
        """Names of the mesh files of a URDF, each once."""
        found = [] if self.root is None else [m.get("filename", "") for m in self.root.iter("mesh")]
        return list(dict.fromkeys(found))

    def locate(self, name: str) -> Path | None:
        """The file of that name; None where it is missing."""
        package = package_of(name)
        home = None if package is None else self.home(package)
        return locate(name, self.path.parent, {} if package is None or home is None else {package: home})

    def home(self, package: str) -> Path | None:
        """The folder of a ROS package; None where it is not found."""
        if package not in self._homes:
            self._homes[package] = find_package(package, self.path.parent, self.packages)
        return self._homes[package]


def read_model(
    path: Path, packages: Mapping[str, Path] | None = None, arguments: Mapping[str, str] | None = None
) -> ModelFile:
    """Read a robot's model. ``packages``: folders of ROS packages by name; ``arguments``: of its macros.

    Raises :class:`InputError` naming the file.
    """
    of = tuple(tuple(sorted((name, str(value)) for name, value in (m or {}).items())) for m in (packages, arguments))
    return once(("model", path, of), lambda: _read(path, packages, arguments))


def _read(path: Path, packages: Mapping[str, Path] | None, arguments: Mapping[str, str] | None) -> ModelFile:
    files = check_size(path)
    data, given = read_file(path, LARGEST), dict(packages or {})
    if not _is_urdf(path, data):
        return ModelFile(path, None, given, files=files)
    try:
        root = ElementTree.fromstring(data)
        macros = path.suffix.lower() == ".xacro" or has_macros(root)
        if macros:
            text = expand(path, given, arguments or {}).encode()
            check_size(path, text)
            root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError(f"{path}: cannot be read: {error}") from error
    check_tree(path, root)
    return ModelFile(path, root, given, macros)


def file_of(description: RobotDescription) -> ModelFile:
    """The model of a described robot. Raises :class:`InputError` naming the file."""
    path = description.model
    if not isfile(path):  # pathlib raises for names that are too long
        raise InputError(f"{description.source}: key 'model': there is no file {path}")
    return read_model(path, description.packages, description.xacro_arguments)


def _is_urdf(path: Path, data: bytes) -> bool:
    if path.suffix.lower() in (".urdf", ".xacro"):
        return True
    roots = (
        data[start:end] for start, end, comment in tokens(data) if not comment and data[start + 1 : start + 2] != b"?"
    )
    return next(roots, b"").lstrip(b"< \t\r\n").startswith(b"robot")


def parse(
    file: ModelFile, *, meshes: bool = False, collision: bool = False, missing: list[str] | None = None
) -> mujoco.MjSpec:
    """The file as a specification that is not compiled, with all links kept. Files that are missing are left out, and named in
    ``missing``; so are the meshes of a URDF unless ``meshes``. ``collision``: of each link of a URDF only what collides, meshes too, or
    what is seen where nothing of it collides or a mesh of that cannot be read. Raises :class:`InputError` naming the file."""
    missing = [] if missing is None else missing
    log_warnings()
    if file.root is None:
        try_model(file.path, file.files)
    try:
        if file.root is None:
            spec = mujoco.MjSpec.from_file(str(file.path))
        else:
            key = ("URDF", file.path, id(file), meshes, collision)
            _, spec = once(key, lambda: (file, _urdf(file, meshes, collision)))  # what is kept keeps its id()
            spec = spec.copy() if remembers() else spec
    except InputError:
        raise
    except (ValueError, ElementTree.ParseError) as error:
        raise InputError(f"{file.path}: cannot be read: {' '.join(str(error).split())}") from error
    if file.root is None:
        missing += drop_missing_files(spec)
    else:
        missing += [name for name in file.meshes() if file.locate(name) is None]
    _name_bodies(spec)
    _open_ranges(spec)
    return spec


def _name_bodies(spec: mujoco.MjSpec) -> None:
    """Bodies of an MJCF need no names; here they are found by them."""
    names = {body.name for body in spec.bodies}
    for body in spec.bodies[1:]:
        if not body.name:
            possible = (f"{body.parent.name}_body{k}" for k in count(1))
            body.name = next(name for name in possible if name not in names)
            names.add(body.name)


def _open_ranges(spec: mujoco.MjSpec) -> None:
    """A range that no joint can leave is none; one end of it that is none stays where it is reached by nothing."""
    for joint in spec.joints:
        low, high = np.clip(joint.range, -_WIDEST_RANGE, _WIDEST_RANGE)
        if max(-low, high) == _WIDEST_RANGE:
            joint.range = [low, high]
            if -low == high:
                joint.limited = mujoco.mjtLimited.mjLIMITED_FALSE


def _urdf(file: ModelFile, meshes: bool, collision: bool) -> mujoco.MjSpec:
    """Shapes have no mass: a link weighs what its ``inertial`` says."""
    assert file.root is not None
    whole = meshes or collision
    root = deepcopy(file.root) if whole else ElementTree.Element("robot", file.root.attrib)
    if not whole:  # what is changed is copied, and no more
        root.extend(copy(e) for e in file.root if e.tag in _READ)
    for link in root.findall("link"):
        _choose_shapes(link, file, whole, collision)
    for joint in root.findall("joint"):
        limit = joint.find("limit")
        if limit is not None and _number(limit, "lower") >= _number(limit, "upper"):
            joint.remove(limit)  # MuJoCo ignores it too, and writes a file of its log
    compiler = {"strippath": "false", "balanceinertia": "true", "fusestatic": "false", "discardvisual": "false"}
    extension = root.find("mujoco")
    if extension is None:
        extension = ElementTree.SubElement(root, "mujoco")
    ElementTree.SubElement(extension, "compiler", compiler)
    text = ElementTree.tostring(root, encoding="unicode")
    try_model(file.path, (Path(m.get("filename", "")) for m in root.iter("mesh")), text)
    spec = mujoco.MjSpec.from_string(text)
    _ = spec.worldbody.joints  # MuJoCo looks for equal names of a URDF when elements of a body are read
    for body in spec.bodies:
        looks = any(geom.contype == 0 for geom in body.geoms)
        for geom in body.geoms:
            geom.mass = 0.0
            if looks and geom.contype:  # it collides, and is not drawn over what the body looks like
                geom.group = HIDDEN
    return spec


def _choose_shapes(link: ElementTree.Element, file: ModelFile, meshes: bool, collision: bool) -> None:
    """Leave of a link's shapes those that can be read; ``collision``: what is seen only where nothing stands for it in collisions. Where
    a collision mesh cannot be read, all that is seen stands for the link: with a part of it plans and plants would miss the rest."""
    solid, seen = link.findall("collision"), link.findall("visual")
    kept, shown = ([e for e in part if _kept(e, file, meshes)] for part in (solid, seen))
    if meshes and shown and len(kept) < len(solid) and len(shown) == len(seen):
        kept = []
    if collision and kept:
        shown = []
    for element in (*solid, *seen):
        if element not in kept and element not in shown:
            link.remove(element)


def _number(element: ElementTree.Element, name: str) -> float:
    try:
        return parse_number(element.get(name, "0"))
    except ValueError:
        return math.nan


def _kept(element: ElementTree.Element, file: ModelFile, meshes: bool) -> bool:
    """Whether a ``visual`` or ``collision`` stays; a mesh that does gets the path of its file."""
    mesh = element.find("geometry/mesh")
    if mesh is None:
        return True
    found = file.locate(mesh.get("filename", "")) if meshes else None
    if found is None or found.suffix.lower() not in MESHES or found.stat().st_size > LARGEST_MESH:
        return False
    mesh.set("filename", str(found.resolve()))
    return True

"""Macros of URDF (xacro), expanded with the optional package ``xacrodoc``.

Where files are that a robot's model names: relative paths, ``file://`` and ``package://`` addresses.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from functools import lru_cache
from importlib.util import find_spec
from os.path import isdir, isfile
from pathlib import Path
from typing import Any
from urllib.parse import unquote
from xml.etree import ElementTree
from xml.parsers import expat

from wbmpc.errors import InputError
from wbmpc.input_file import read_file
from wbmpc.robots.file_limits import LARGEST
from wbmpc.robots.limited_process import CLOCK, OutOfTime, run_limited
from wbmpc.robots.xml_text import strict_parser

#: Bytes of a package.xml, at most.
LARGEST_MANIFEST = 1024 * 1024
PACKAGE, FILE = "package://", "file://"


def locate(name: str, folder: Path, packages: Mapping[str, Path]) -> Path | None:
    """The file that a model in ``folder`` calls ``name``, with ROS packages in ``packages`` (name to folder); None where there is none."""
    if name.startswith(PACKAGE):
        package, _, rest = name.removeprefix(PACKAGE).partition("/")
        home = packages.get(package)
        found = None if home is None else home / rest
    elif name.startswith(FILE):
        found = Path(unquote(name.removeprefix(FILE)))
    else:
        found = folder / name
    return found if found is not None and isfile(found) else None


def find_package(name: str, folder: Path, packages: Mapping[str, Path]) -> Path | None:
    """The folder of a ROS package: the one in ``packages`` (its name to its folder), else the nearest around ``folder`` that is called like
    it or whose ``package.xml`` names it, else one that is called like it although its ``package.xml`` has another name; None where there
    is none."""
    if name in packages:
        return packages[name] if isdir(packages[name]) else None
    around = list(_around(folder.resolve(), name))
    called = (home for home in around if home.name == name and isdir(home))
    return next((home for home in around if _is_package(home, name)), None) or next(called, None)


def _around(folder: Path, name: str) -> Iterator[Path]:
    """Folders above a model, and those beside them that are called like the package."""
    for parent in (folder, *folder.parents):
        yield parent
        yield parent / name


def _is_package(home: Path, name: str) -> bool:
    manifest = home / "package.xml"
    if not isfile(manifest):
        return home.name == name and isdir(home)
    try:
        return _name_in(read_file(manifest, LARGEST_MANIFEST)) == name
    except (expat.ExpatError, ValueError, LookupError):
        return home.name == name


def _name_in(manifest: bytes) -> str:
    """What the root's elements ``name`` say. Raises :class:`ValueError` for a manifest with entities, or of another encoding."""
    parser, names, texts = strict_parser(), list[str](), list[str]()
    parser.StartElementHandler = lambda name, _: names.append(name)
    parser.EndElementHandler = lambda _: names.pop()
    parser.CharacterDataHandler = lambda text: texts.append(text) if names[1:] == ["name"] else None
    parser.Parse(manifest, True)
    return "".join(texts).strip()


def package_of(name: str) -> str | None:
    """The ROS package of an address; None of a plain path."""
    return name.removeprefix(PACKAGE).partition("/")[0] if name.startswith(PACKAGE) else None


NAMESPACES = ("{http://www.ros.org/wiki/xacro}", "{http://ros.org/wiki/xacro}")
NEEDED = "its macros (xacro) have to be expanded: pip install 'wbmpc[xacro]', or expand the file with ROS' own xacro"
_UNKNOWN = re.compile(r"Package not found: ([\w-]+)")
#: A file of a package that is nowhere: pathlib makes one slash of two.
_MISSING = re.compile(rf"{PACKAGE[:-1]}([\w-]+)/")
_ARGUMENT = re.compile(r"Undefined substitution argument ([\w-]+)")
_UNDEFINED = re.compile(r"name '(\w+)' is not defined")
_DECLARED = re.compile(rb"""<xacro:arg\s[^<>]*?\bname\s*=\s*["']([\w-]+)["']""")
#: How long macros may take [s].
SECONDS = CLOCK
#: Expanded texts that are kept: a robot is read several times.
_KEPT = 8


def has_macros(root: ElementTree.Element) -> bool:
    """Whether a URDF has macros that are not expanded."""
    return any(isinstance(e.tag, str) and e.tag.startswith(NAMESPACES) for e in root.iter())


def expand(path: Path, packages: Mapping[str, Path], arguments: Mapping[str, str]) -> str:
    """The URDF of a file with macros. Raises :class:`InputError` naming the file, and the package or argument that is missing.

    A file with macros is a program: Python expressions of it are evaluated, in a process of its own with limits of time and memory. It
    is expanded once for each state of the file itself.
    """
    key = tuple(sorted((name, str(folder)) for name, folder in packages.items()))
    return _expanded(path.resolve(), path.stat().st_mtime_ns, key, tuple(sorted(arguments.items())), str(path))


@lru_cache(maxsize=_KEPT)
def _expanded(
    path: Path, changed: int, packages: tuple[tuple[str, str], ...], arguments: tuple[tuple[str, str], ...], name: str
) -> str:
    if find_spec("xacrodoc") is None:
        raise InputError(f"{name}: {NEEDED}")
    homes = dict(packages)
    while unknown := _UNKNOWN.search((answer := _answer(path, homes, arguments, name)).get("error", "")):
        package = unknown[1]
        if package in homes:
            break
        # missing ones do no harm as long as macros read nothing in them: settings of simulators and drivers
        homes[package] = str(find_package(package, path.parent, {}) or f"{PACKAGE}{package}")
    if "text" in answer:
        return str(answer["text"])
    text = " ".join(str(answer["error"]).split())
    if missing := _MISSING.search(text) or _UNKNOWN.search(text):
        raise InputError(
            f"{name}: ROS package '{missing[1]}' is not found; give its folder with 'packages: {{{missing[1]}: FOLDER}}' in the "
            f"robot's YAML, or --package {missing[1]}=FOLDER"
        )
    if argument := _ARGUMENT.search(text):
        raise InputError(
            f"{name}: its macros need the argument '{argument[1]}'; give it with 'xacro_arguments: {{{argument[1]}: VALUE}}' in the "
            f"robot's YAML, or --argument {argument[1]}:=VALUE"
        )
    old = (
        "; old files leave out the prefix of macros, which is needed: <xacro:property …>, <xacro:macro …>, <xacro:include …>, in every "
        'file below <robot xmlns:xacro="http://www.ros.org/wiki/xacro">'
    )
    hint = old if _UNDEFINED.search(text) else ""
    raise InputError(f"{name}: its macros cannot be expanded: {text[:300]}{hint}{_declared(path, arguments)}")


def _declared(path: Path, given: tuple[tuple[str, str], ...]) -> str:
    """The arguments of a file that were not given, for a message: macros fail at their defaults, often empty texts."""
    names = [n.decode() for n in _DECLARED.findall(read_file(path, LARGEST))]
    left = ", ".join(dict.fromkeys(n for n in names if n not in dict(given)))
    return f"; its arguments, which --argument NAME:=VALUE gives: {left[:200]}" if left else ""


def _answer(path: Path, homes: Mapping[str, str], arguments: tuple[tuple[str, str], ...], name: str) -> dict[str, Any]:
    """Of the program that expands the file, with ROS packages in ``homes``."""
    order = {"path": str(path), "packages": dict(homes), "arguments": dict(arguments)}
    try:
        return run_limited(order, SECONDS)
    except OutOfTime as limit:
        raise InputError(f"{name}: its macros are not expanded within {limit}") from None

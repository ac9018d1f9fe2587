"""Where files are that a robot's model names: relative paths, ``file://`` and ``package://`` addresses."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from os.path import isdir, isfile
from pathlib import Path
from urllib.parse import unquote
from xml.parsers import expat

from wbmpc.input_file import read_file
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
    it or whose ``package.xml`` names it; None where there is none."""
    if name in packages:
        return packages[name] if isdir(packages[name]) else None
    return next((home for home in _around(folder.resolve(), name) if _is_package(home, name)), None)


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

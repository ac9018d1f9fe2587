"""What a robot's XML may be at most, checked before MuJoCo grows anything of it.

A few lines can ask for millions of bodies (``replicate``, models attached to models, XML entities) or for an image of a
terabyte; the simulator's parser would build them all.

Numbers of a robot's XML that are none of a machine: not a number, infinite, or beyond everything.
"""

from __future__ import annotations

import math
import re
import struct
from dataclasses import dataclass, field
from os.path import exists, isdir, isfile
from pathlib import Path
from typing import Never
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from wbmpc.checks import parse_number
from wbmpc.errors import InputError
from wbmpc.input_file import open_file, read_file
from wbmpc.robots.xml_text import strict_parser, without_comments

#: Of any unit of a model: MuJoCo takes a larger value for the end of a simulation.
LARGEST_NUMBER = 1e10
#: Attributes that are names or texts.
_TEXTS = """name class childclass dclass model modelname file filename link parent child type body body1 body2 bodyname joint joint1 joint2
    jointinparent geom geom1 geom2 site site1 site2 sidesite refsite cranksite slidersite mesh meshname material texture hfield
    target objname objtype refname reftype tendon tendon1 tendon2 actuator base prefix plugin instance key flex skin element node
    frame package text data sensor"""
#: Attributes of limits: what is infinite is none.
_LIMITS = """range ctrlrange forcerange actfrcrange actrange lengthrange lower upper velocity effort soft_lower_limit soft_upper_limit"""
_NAMES, _BOUNDS = frozenset(_TEXTS.split()), frozenset(_LIMITS.split())
_NAN = re.compile(r"(?<!\S)[+-]?nan(\(\S*\))?(?!\S)", re.IGNORECASE)
_INFINITE = re.compile(r"(?<!\S)[+-]?inf(inity)?(?!\S)", re.IGNORECASE)
#: So many words of an attribute are checked one by one, where not all of them are numbers.
_FEW = 1000


def check_number(name: str, value: str) -> None:
    """Raise :class:`InputError` naming an attribute with a number that cannot be meant."""
    if name in _NAMES:
        return
    if found := _NAN.search(value):
        raise InputError(f"'{name}' has '{found[0]}', which is not a number")
    if name in _BOUNDS:
        return
    if found := _INFINITE.search(value):
        raise InputError(f"'{name}' has '{found[0]}'; at most {LARGEST_NUMBER:g} is read")
    words = value.split()
    too_large = np.abs(_numbers(words)) > LARGEST_NUMBER
    if too_large.any():
        raise InputError(f"'{name}' has '{words[int(np.argmax(too_large))][:40]}'; at most {LARGEST_NUMBER:g} is read")


def _numbers(words: list[str]) -> NDArray[np.float64]:
    """Of each word (n), 0 where it is none."""
    try:
        return np.array(words, float)
    except ValueError:
        return np.array([_number(word) for word in words[:_FEW]])


def _number(word: str) -> float:
    try:
        return parse_number(word)
    except ValueError:
        return 0.0


#: Bytes of one file; elements and bodies after all that is repeated; levels of nesting; pixels of all images and points of all
#: fields together.
LARGEST, MAX_ELEMENTS, MAX_BODIES, DEEPEST, MAX_PIXELS = 16 * 1024 * 1024, 5_000, 500, 128, 16_000_000
#: Elements that are beside the robot's bodies, which are taken out one by one: shapes and lights of the world, sensors, drives.
MAX_BESIDE = 1_000
#: Numbers and words of one attribute (a mesh or a field can stand in one), and of all; bytes of a mesh in a file of its own, which is
#: also too much for a page in a browser. MuJoCo takes seconds for more.
MAX_WORDS, MAX_ALL_WORDS, LARGEST_MESH = 100_000, 300_000, 5_000_000
#: Attributes of one element: MuJoCo's parser compares each with all of them, and nothing ends it meanwhile.
MAX_ATTRIBUTES = 256
#: Joints that move: what is done for each takes time that grows with their number.
MAX_JOINTS = 200
_OF_WORLD, _LISTS = (
    ("geom", "light", "camera"),
    ("sensor", "actuator", "keyframe", "contact", "tuple", "equality", "tendon"),
)
#: Elements that make several of what is inside, with the numbers whose product says how many.
_REPEAT = {"replicate": "count", "composite": "count", "flexcomp": "count"}
#: Attributes whose product is the size of an image or a field.
_AREAS = {"texture": ("width", "height"), "hfield": ("nrow", "ncol")}
#: Attributes whose every number is a count of what is made, and its largest value.
_COUNTS = {("mesh", "params"): 100.0, ("numeric", "size"): 10_000.0, ("texture", "width"): 2048.0} | {
    ("size", name): 10_000.0
    for name in (
        "nkey",
        "nuserdata",
        *(f"nuser_{k}" for k in ("body", "jnt", "geom", "site", "cam", "tendon", "actuator", "sensor")),
    )
}
_BODIES = ("body", "link", "composite", "flexcomp")
#: Attributes that say where files are.
_FOLDERS = ("meshdir", "texturedir", "assetdir")


@dataclass
class _Count:
    """What a file asks for."""

    elements: float = 0.0
    bodies: float = 0.0
    beside: float = 0.0
    pixels: float = 0.0
    joints: float = 0.0
    words: float = 0.0
    models: dict[str, Path] = field(default_factory=dict)


def check_size(path: Path, text: bytes | None = None) -> tuple[Path, ...]:
    """Raise :class:`InputError` naming file and element for a robot's XML that asks for too much, is not well-formed, or names what is
    no regular file (a pipe, a device): its reader would wait forever. ``text``: what a file's macros became, instead of the file.

    Returns the file and those that it names, as far as they are there."""
    known, found = _walked(path, text), {path: None}
    for named in known.named:
        found |= dict.fromkeys(named.files(known.folders))
    for picture in found:
        width, height = _picture(picture)
        if width * height > MAX_PIXELS:
            raise InputError(f"{picture}: a picture of {width} x {height} pixels; valid: at most {MAX_PIXELS} pixels")
    return tuple(found)


def _picture(path: Path) -> tuple[int, int]:
    """Width and height [pixels] that the head of a PNG file says; (0, 0) for another file."""
    try:
        with open_file(path) as file:
            head = file.read(24) or b""
    except InputError:  # its reader says so
        return 0, 0
    return struct.unpack(">II", head[16:]) if head[:8] == b"\x89PNG\r\n\x1a\n" and len(head) == 24 else (0, 0)


#: What walks found, by file and text, with the states of all files that they read: a robot is read several times.
_KNOWN: dict[tuple[Path, Path, bytes | None], _Found] = {}
_MOST_KNOWN = 16


@dataclass(frozen=True)
class _Named:
    """A file that ``attribute`` of ``element`` names; ``beside``: the folder of the file that ``where`` begins with."""

    where: str
    element: str
    attribute: str
    beside: Path
    name: str

    def files(self, folders: set[Path]) -> list[Path]:
        """Where it may be, in ``folders`` too. Raises :class:`InputError` for what cannot be read: a pipe, and in an MJCF a directory, or a
        mesh that is too large; those of a URDF are left out."""
        places = [folder / n for folder in (self.beside, *folders) for n in (self.name, self.name.rpartition("/")[2])]
        for place in places:
            if exists(place) and not (isfile(place) or isdir(place)):
                raise InputError(f"{self.where}: '{place}' is no regular file")
        found = [place for place in places if isfile(place)]
        if self.attribute == "filename":
            return found
        if not found and self.name and (directory := next(filter(isdir, places), None)):
            raise InputError(f"{self.where}: '{directory}' is a directory; a file is needed")
        for place in found if self.element == "mesh" else ():
            if (size := place.stat().st_size) > LARGEST_MESH:
                raise InputError(
                    f"{self.where}: '{place}' has {size} bytes; at most {LARGEST_MESH} are read: fewer faces are needed"
                )
        return found


@dataclass
class _Found:
    """``states`` of the files that were read; ``folders`` in which files may be; ``named``: files that elements name."""

    states: dict[Path, tuple[int, int]]
    folders: set[Path]
    named: list[_Named]


def _walked(path: Path, text: bytes | None) -> _Found:
    key = (path, path.absolute(), text)
    known = _KNOWN.get(key)
    if known is None or any(_state(file) != state for file, state in known.states.items()):
        found, done = _Found({}, {path.parent}, []), dict[Path, _Count]()
        _Walk(path, done, (), found.folders, found.named).run(text)
        found.states |= {file: _state(file) for file in (path, *done)}
        if len(_KNOWN) >= _MOST_KNOWN:
            _KNOWN.clear()
        known = _KNOWN[key] = found
    return known


def _state(file: Path) -> tuple[int, int]:
    try:
        about = file.stat()
    except OSError:
        return 0, -1
    return about.st_mtime_ns, about.st_size


class _Walk:
    """One file; ``done``: what other files ask for, ``above``: files that led here.

    Fills in ``folders``, in which files may be, and ``named``: files that elements name.
    """

    def __init__(
        self, path: Path, done: dict[Path, _Count], above: tuple[Path, ...], folders: set[Path], named: list[_Named]
    ) -> None:
        self._path, self._done, self._above = path, done, (*above, path.resolve())
        self._folders, self._named = folders, named
        self._main = above[0].parent if above else path.parent
        self._count, self._times, self._open = _Count(), [1.0], []  # type: _Count, list[float], list[str]

    def run(self, given: bytes | None = None) -> _Count:
        """What the file, or the text ``given`` for it, asks for, with all that it includes."""
        if given is not None and len(given) > LARGEST:
            raise InputError(f"{self._path}: has {len(given)} bytes; at most {LARGEST} are read")
        data = read_file(self._path, LARGEST) if given is None else given
        self._parser = strict_parser()
        self._parser.StartElementHandler, self._parser.EndElementHandler = self._start, self._end
        try:
            self._parser.Parse(without_comments(data), True)
        except InputError:
            raise
        except (expat.ExpatError, LookupError, ValueError) as error:  # the file names its encoding
            raise InputError(f"{self._path}: cannot be read: {error}") from error
        return self._count

    def _fail(self, text: str) -> Never:
        raise InputError(f"{self._path}: line {self._parser.CurrentLineNumber}: {text}")

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        if len(self._open) >= DEEPEST:
            self._fail(f"<{name}> is nested deeper than {DEEPEST} levels")
        if len(attributes) > MAX_ATTRIBUTES:
            self._fail(f"<{name}> has {len(attributes)} attributes; at most {MAX_ATTRIBUTES} are read")
        times = self._times[-1]
        if name in _REPEAT:
            times *= max(self._product(name, attributes.get("count", "1")), 1.0)
        beside = (name in _OF_WORLD and not self._in_body()) or (bool(self._open) and self._open[-1] in _LISTS)
        self._times.append(times)
        self._open.append(name)
        pixels = self._product(name, " ".join(attributes.get(a, "1") for a in _AREAS[name])) if name in _AREAS else 0.0
        moves = name in ("joint", "freejoint") and attributes.get("type") != "fixed" and not beside
        self._add(name, _Count(times, times * (name in _BODIES), times * beside, pixels, times * moves))
        for attribute, value in attributes.items():
            self._count_words(name, attribute, value)
            self._check_number(name, attribute, value)
            if attribute in _FOLDERS:
                self._folders.add(self._main / value)
            elif attribute.startswith("file"):
                where = f"{self._path}: line {self._parser.CurrentLineNumber}: <{name}>: '{attribute}'"
                self._named.append(_Named(where, name, attribute, self._path.parent, value))
            maximum = _COUNTS.get((name, attribute))
            if maximum is not None and max(self._numbers(name, attributes[attribute]), default=0.0) > maximum:
                self._fail(f"<{name}>: '{attribute}' has a number above {maximum:g}, the largest that is read")
        if name == "include":
            self._include(attributes.get("file", ""), times)
        elif name == "model" and "file" in attributes:
            self._count.models[attributes.get("name", "")] = self._found(attributes["file"])
        elif name == "attach" and (model := self._count.models.get(attributes.get("model", ""))) is not None:
            self._add_file(name, model, times)

    def _count_words(self, name: str, attribute: str, value: str) -> None:
        words = len(value.split())
        if words > MAX_WORDS:
            self._fail(f"<{name}>: '{attribute}' has {words} words; at most {MAX_WORDS} are read")
        self._add(name, _Count(words=words))

    def _check_number(self, name: str, attribute: str, value: str) -> None:
        try:
            check_number(attribute, value)
        except InputError as error:
            self._fail(f"<{name}>: {error}")

    def _end(self, name: str) -> None:
        self._open.pop()
        self._times.pop()

    def _in_body(self) -> bool:
        return "body" in self._open

    def _product(self, name: str, text: str) -> float:
        return math.prod(self._numbers(name, text))

    def _numbers(self, name: str, text: str) -> list[float]:
        try:
            return [parse_number(word) for word in text.split()]
        except ValueError:
            self._fail(f"<{name}>: numbers are needed, got '{text[:40]}'")

    def _add(self, name: str, more: _Count) -> None:
        count = self._count
        count.elements, count.bodies = count.elements + more.elements, count.bodies + more.bodies
        count.beside, count.pixels = count.beside + more.beside, count.pixels + more.pixels
        count.joints, count.words = count.joints + more.joints, count.words + more.words
        for what, value, maximum in (
            ("bodies", count.bodies, MAX_BODIES),
            ("elements", count.elements, MAX_ELEMENTS),
            ("shapes, sensors and drives beside the bodies", count.beside, MAX_BESIDE),
            ("joints", count.joints, MAX_JOINTS),
            ("pixels of pictures and points of fields", count.pixels, MAX_PIXELS),
            ("words of attributes", count.words, MAX_ALL_WORDS),
        ):
            if not value <= maximum:
                self._fail(f"<{name}>: more than {maximum} {what}; at most so many are read")

    def _found(self, name: str) -> Path:
        """Where MuJoCo looks for a file: beside the main one, or the one that names it."""
        beside = self._main / name
        return beside if isfile(beside) else self._path.parent / name

    def _include(self, name: str, times: float) -> None:
        if name:
            self._add_file("include", self._found(name), times)

    def _add_file(self, element: str, path: Path, times: float) -> None:
        if not isfile(path):
            return  # MuJoCo says so
        if path.resolve() in self._above:
            self._fail(f"<{element}>: '{path}' leads back to itself")
        inside = self._done.get(path.resolve())
        if inside is None:
            inside = self._done[path.resolve()] = _Walk(path, self._done, self._above, self._folders, self._named).run()
        if element == "include":
            self._count.models |= inside.models
        beside = 0.0 if self._in_body() else times * inside.beside
        more = _Count(
            times * inside.elements, times * inside.bodies, beside, inside.pixels, times * inside.joints, inside.words
        )
        self._add(element, more)

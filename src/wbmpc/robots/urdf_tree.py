"""Faults in the tree of links and joints of a URDF, named by link and joint: MuJoCo reports them without names."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from xml.etree.ElementTree import Element

from wbmpc.checks import parse_number
from wbmpc.errors import InputError, unknown_name

#: A ball joint, in MuJoCo's and Bullet's URDF; ROS has none.
BALL = "spherical"
#: Types of joints that a URDF may have (http://wiki.ros.org/urdf/XML/joint).
KINDS = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar", BALL)
#: Attributes of a joint's elements that are numbers. MuJoCo leaves some out, and a limit that cannot be read would be none.
_NUMBERS = {"limit": ("lower", "upper", "velocity", "effort"), "mimic": ("multiplier", "offset")}


def check_tree(path: Path, root: Element) -> None:
    """Raise :class:`InputError` naming file, joint and link where the joints of a URDF do not make a tree of its links: names that are
    missing or given twice, links that are not in the file or hang on two joints, and loops; and for limits that are no numbers."""
    links = _names(path, "link", root.findall("link"))
    joints = root.findall("joint")
    _names(path, "joint", joints)
    above: dict[str, tuple[str, str]] = {}
    for joint in joints:
        where = f"{path}: joint '{joint.get('name')}'"
        kind = joint.get("type", "")
        if kind not in KINDS:
            raise InputError(f"{where}: {unknown_name('type', kind, KINDS)}")
        _check_numbers(where, joint)
        parent, child = (_end(where, joint, end, links) for end in ("parent", "child"))
        if child in above:
            raise InputError(
                f"{where}: its child link '{child}' is the child of joint '{above[child][1]}' too; a link hangs on one joint"
            )
        above[child] = parent, str(joint.get("name"))
    rooted: set[str] = set()
    for link in links:
        _check_loop(path, link, above, rooted)


def _names(path: Path, kind: str, elements: Iterable[Element]) -> dict[str, None]:
    """Names of links or joints, in order."""
    found: dict[str, None] = {}
    for element in elements:
        name = element.get("name")
        if not name:
            raise InputError(f"{path}: a {kind} has no name")
        if name in found:
            raise InputError(f"{path}: {kind} '{name}' is in the file twice; each {kind} needs a name of its own")
        found[name] = None
    return found


def _check_numbers(where: str, joint: Element) -> None:
    for tag, names in _NUMBERS.items():
        for element in joint.findall(tag):
            for name in names:
                try:
                    parse_number(element.get(name, "0"))
                except ValueError:
                    raise InputError(
                        f"{where}: <{tag}>: '{name}' must be a number, got '{element.get(name, '')[:40]}'"
                    ) from None


def _end(where: str, joint: Element, end: str, links: Iterable[str]) -> str:
    """The link that a joint calls its parent or child."""
    element = joint.find(end)
    name = "" if element is None else element.get("link", "")
    if not name:
        raise InputError(f'{where}: it names no {end} link; <{end} link="NAME"/> is needed')
    if name not in links:
        raise InputError(f"{where}: its {end} link is not in the file: {unknown_name('link', name, list(links))}")
    return name


def _check_loop(path: Path, link: str, above: dict[str, tuple[str, str]], rooted: set[str]) -> None:
    """Follow a link up to a root, or to one of ``rooted``, from which that is done; those on the way are rooted then."""
    seen = dict.fromkeys([link])
    while link in above and link not in rooted:
        link, joint = above[link]
        if link in seen:
            raise InputError(f"{path}: joint '{joint}': links hang on each other in a loop: {', '.join(seen)}")
        seen[link] = None
    rooted.update(seen)

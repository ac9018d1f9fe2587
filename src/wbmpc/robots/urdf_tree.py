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
#: Those of them that are magnitudes: a negative one would count for none.
_MAGNITUDES = ("velocity", "effort")
#: Types of joints that have one value, which others can follow.
_VALUED = ("revolute", "continuous", "prismatic")


def check_tree(path: Path, root: Element) -> None:
    """Raise :class:`InputError` naming file, joint and link where the joints of a URDF do not make a tree of its links: names that are
    missing or given twice, links that are not in the file or hang on two joints, and loops; and for limits that are no numbers, speeds and
    efforts below 0, and joints that mimic one which is not there, has no value, or mimics them."""
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
    _check_mimics(path, joints)


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
                text = element.get(name, "0")
                try:
                    value = parse_number(text)
                except ValueError:
                    raise InputError(f"{where}: <{tag}>: '{name}' must be a number, got '{text[:40]}'") from None
                if name in _MAGNITUDES and not value >= 0.0:
                    raise InputError(
                        f"{where}: <{tag}>: '{name}' must not be negative, got '{text[:40]}'; valid: a number above 0,"
                        " or 0 or inf where the file gives no limit"
                    )


def _check_mimics(path: Path, joints: Iterable[Element]) -> None:
    """Joints follow joints of the file that move, none of them itself, not over others either."""
    known = {str(joint.get("name")): joint for joint in joints}
    leaders = {n: mimic.get("joint", "") for n, j in known.items() if (mimic := j.find("mimic")) is not None}
    settled: set[str] = set()
    for name, leader in leaders.items():
        where = f"{path}: joint '{name}': <mimic>"
        if not leader:
            raise InputError(f'{where}: it names no joint to follow; <mimic joint="NAME"/> is needed')
        if leader not in known:
            raise InputError(f"{where}: {unknown_name('joint', leader, [n for n in known if n != name])}")
        if (kind := known[leader].get("type")) not in _VALUED:
            raise InputError(f"{where}: '{leader}' is {kind}; valid: a joint that is {', '.join(_VALUED)}")
        chain: dict[str, None] = {}
        while name in leaders and name not in settled:
            chain[name] = None
            name = leaders[name]
            if name in chain:
                raise InputError(f"{where}: joints follow each other in a loop: {', '.join(chain)}")
        settled.update(chain)


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

"""What trips those who use a model that was made for something else: one small check for each trap, and a table of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from wbmpc.constants import TELESCOPE
from wbmpc.robots.arm_search import TOOLS, find_arms, is_gripper
from wbmpc.robots.findings import Finding, Severity
from wbmpc.robots.mechanism import Joint, Mechanism
from wbmpc.robots.model_file import MESHES
from wbmpc.robots.steadiness import tipping_share
from wbmpc.robots.wheel_search import Wheel, find_wheels
from wbmpc.robots.xacro_file import package_of

if TYPE_CHECKING:
    from wbmpc.robots.description import RobotDescription

#: Wheels at heights that differ by more [m] do not stand together; so far [m] beside its steering axis a wheel is a caster's.
LEVEL, BESIDE = 0.001, 0.005
#: How far [of it] a wheel's radius may be from what other parts of the file say.
RADIUS = 0.05
#: Share of an arm's postures in which a robot may tip over at rest.
TIPPING = 0.02


@dataclass(frozen=True)
class Subject:
    """A model, and the ``description`` that uses it; None of a model alone: then each joint may be used."""

    mechanism: Mechanism
    description: RobotDescription | None = None

    @cached_property
    def wheels(self) -> list[Wheel]:
        """Everything that looks like one."""
        return find_wheels(self.mechanism)

    @property
    def driven(self) -> list[Wheel]:
        """Without casters."""
        return [w for w in self.wheels if not w.passive]

    @property
    def rolling(self) -> list[Wheel]:
        """Wheels that a description uses; of a model alone those without casters."""
        return [w for w in self.driven if self.description is None or self.uses(w.joint)]

    def uses(self, joint: str) -> bool:
        """Whether a description names a joint for its arm or base."""
        return self.description is not None and joint in self.description.joints()

    @cached_property
    def moving(self) -> list[Joint]:
        """Joints that a description uses; of a model alone all that could be an arm's or a wheel's."""
        joints = self.mechanism.joints.values()
        if self.description is not None:
            return [j for j in joints if self.uses(j.name)]
        passive = {n for w in self.wheels if w.passive for n in (w.joint, w.steer)}
        return [j for j in joints if j.name not in passive and not is_gripper(self.mechanism, j)]


Check = Callable[[Subject], Iterable[Finding]]


# ---------------------------------------------------------------------- files
def check_macros(subject: Subject) -> Iterator[Finding]:
    """A file with macros is a program."""
    if subject.mechanism.file.macros:
        yield Finding("info", "", "", "macros were expanded; their Python expressions were evaluated")


def check_meshes(subject: Subject) -> Iterator[Finding]:
    """Files that are not there, and those in a format that is not read."""
    missing, file = subject.mechanism.missing, subject.mechanism.file
    unknown = sorted({p for name in missing if (p := package_of(name)) and file.home(p) is None})
    if missing:
        fix = (
            f"to show them: 'packages: {{{unknown[0]}: FOLDER}}' in the robot's YAML"
            if unknown
            else "put them beside the model to see them"
        )
        yield Finding(
            "info", "", f"{len(missing)} files", f"missing, '{missing[0]}' first; planning needs none of them", fix
        )
    unread = [name for name in file.meshes() if name not in missing and not name.lower().endswith(MESHES)]
    if unread:
        text = (
            f"of a format that is not read, '{unread[0]}' first: not shown, nor measured for wheel radii; where they are to collide, what "
            "is seen of the link stands for it, or what else of it collides"
        )
        yield Finding("info", "", f"{len(unread)} files", text, f"convert them to {' or '.join(MESHES[:2])}")


# ---------------------------------------------------------------------- links
def check_inertias(subject: Subject) -> Iterator[Finding]:
    """Masses and inertias that no link can have."""
    needed = subject.description is not None and subject.description.base.uses_inertia
    groups: dict[str, list[Finding]] = {}
    for finding in subject.mechanism.replaced:
        groups.setdefault(finding.text, []).append(finding)
    for alike in groups.values():
        first, names = alike[0], [f.where.removeprefix("link ").strip("'") for f in alike]
        yield replace(first, severity="error" if needed else "warning", where=_several("link", names))


def check_world(subject: Subject) -> Iterator[Finding]:
    """MuJoCo's world has that name."""
    root = subject.mechanism.file.root
    if root is not None and any(link.get("name") == "world" for link in root.findall("link")):
        yield Finding(
            "info", "", "link 'world'", "it is MuJoCo's world, which does not move",
            "'base.body' of a base that moves is a link on it",
        )  # fmt: skip


def check_body(subject: Subject) -> Iterator[Finding]:
    """A base that hangs on another body by a joint cannot float in the simulator; fixed to it, as base_link to base_footprint, it can."""
    description, mechanism = subject.description, subject.mechanism
    if description is None or not description.base.moves:
        return
    body = description.base.body
    above = mechanism.path(body)[1:-1]
    joints = [j.name for j in mechanism.joints.values() if j.body in (*above[1:], body)] if above else []
    loose = [n for n in joints if n not in description.fixed_joints]
    if loose:
        text = f"'{body}' hangs on '{above[-1]}' by joint '{loose[0]}': it cannot be simulated, only planned for"
        yield Finding(
            "warning", "", "key 'base.body'", text, f"give 'base.body: {above[0]}', or hold the joint (fixed_joints)"
        )


# ---------------------------------------------------------------------- joints
def check_names(subject: Subject) -> Iterator[Finding]:
    """Joints without a name, which no description can hold."""
    m = subject.mechanism.model
    for j in range(m.njnt):
        if not m.joint(j).name and m.jnt_type[j] >= 2:
            yield Finding(
                "warning", "", f"body '{m.body(int(m.jnt_bodyid[j])).name}'", "a joint of it has no name",
                "give it one in the file",
            )  # fmt: skip


def check_kinds(subject: Subject) -> Iterator[Finding]:
    """Joints of several degrees of freedom."""
    root = subject.mechanism.file.root
    for joint in [] if root is None else root.findall("joint"):
        if joint.get("type") in ("floating", "planar"):
            yield Finding(
                "warning", "", f"joint '{joint.get('name')}'", f"of type {joint.get('type')}, which only the joint of the base itself may be",
                "make it fixed in the file; the base type moves the base",
            )  # fmt: skip


def check_velocities(subject: Subject) -> Iterator[Finding]:
    """Joints whose speed nothing limits."""
    limits: Mapping[str, float] = {} if subject.description is None else subject.description.limits.velocity
    names = [j.name for j in subject.moving if j.drive.velocity is None and j.name not in limits]
    if names:
        fix = f"give 'limits.velocity: {{{names[0]}: …}}' [rad/s or m/s] in the robot's YAML"
        yield Finding(
            "warning", "", _joints(names), "no limit of velocity (missing, or not above 0): speed is not limited", fix
        )


def check_efforts(subject: Subject) -> Iterator[Finding]:
    """Joints whose file names an effort that limits nothing."""
    limits: Mapping[str, float] = {} if subject.description is None else subject.description.limits.effort
    names = [j.name for j in subject.moving if j.drive.no_effort and j.name not in limits]
    if names:
        fix = f"give 'limits.effort: {{{names[0]}: …}}' [N m or N] in the robot's YAML, or fix the file"
        yield Finding("warning", "", _joints(names), "efforts of 0, or to one side, count for none", fix)


def check_ranges(subject: Subject) -> Iterator[Finding]:
    """Ranges from 0 to 0, which MuJoCo takes for none at all."""
    d = subject.description
    settled = set() if d is None else {*d.limits.position, *d.fixed_joints}
    for joint in subject.mechanism.joints.values():
        if joint.drive.no_range and joint.name not in settled:
            used = subject.uses(joint.name)
            fix = f"hold it with 'fixed_joints: {{{joint.name}: 0}}'" + (
                f", or give 'limits.position: {{{joint.name}: [LOWER, UPPER]}}'" if used else ""
            )
            severity: Severity = "error" if used else "info"
            yield Finding(
                severity, "", f"joint '{joint.name}'", "its range is empty (lower is not below upper): it cannot move",
                fix,
            )  # fmt: skip


def check_mimics(subject: Subject) -> Iterator[Finding]:
    """Joints that follow others, of which the planner's equations know nothing."""
    groups: dict[str, list[str]] = {}
    for joint in subject.mechanism.joints.values():
        if joint.drive.mimics is not None:
            groups.setdefault(joint.drive.mimics, []).append(joint.name)
    for leader, followers in groups.items():
        coupled = {} if subject.description is None else subject.description.couple
        followers = [n for n in followers if n not in coupled]
        if not followers:
            continue
        used = any(subject.uses(n) for n in (leader, *followers))
        held = {} if subject.description is None else subject.description.fixed_joints
        if not used and {leader, *followers} <= held.keys():
            continue
        hold = ", ".join(f"{n}: 0" for n in (leader, *followers))
        follow = ", ".join(f"{n}: {leader}" for n in followers)
        text = f"{'it follows' if len(followers) == 1 else 'they follow'} '{leader}' (mimic)"
        yield Finding(
            "error" if used else "info",
            "",
            _joints(followers),
            text,
            f"hold all: 'fixed_joints: {{{hold}}}', or couple what follows a joint of the arm: 'couple: {{{follow}}}'",
        )


def check_telescopes(subject: Subject) -> Iterator[Finding]:
    """Slides along one line, one on the other, that nothing couples."""
    joints = subject.mechanism.joints
    coupled = {} if subject.description is None else subject.description.couple
    slides = [j for j in subject.moving if j.kind == "slide"]
    pairs = [(joints[j.above[-1]], j) for j in slides if j.above and j.above[-1] in joints]
    names = {
        k.name: None
        for a, b in pairs
        if a.kind == "slide" and abs(a.axis @ b.axis) > TELESCOPE and b.drive.mimics is None and b.name not in coupled
        for k in (a, b)
    }
    if names:
        yield Finding(
            "info", "", _joints(list(names)), "they slide along one line and nothing couples them: each is planned on its own",
            "name all of them in 'arm.joints', or the first one alone and the others in 'couple', or hold all but one with 'fixed_joints'",
        )  # fmt: skip


def check_home(subject: Subject) -> Iterator[Finding]:
    """A joint whose home, or where it is held, is outside of its range."""
    description = subject.description
    if description is None:
        return
    home = [("home", name, description.home.get(name, 0.0)) for name in description.joints()]
    for key, name, value in (*home, *(("fixed_joints", *held) for held in description.fixed_joints.items())):
        joint = subject.mechanism.joints.get(name)
        bounds = description.limits.position.get(name, joint.range if joint else None)
        if bounds is not None and not bounds[0] - 1e-6 <= value <= bounds[1] + 1e-6:
            yield Finding(
                "error", "", f"key '{key}.{name}'", f"{value:g} is outside its limits {bounds[0]:g} to {bounds[1]:g}",
                f"give '{key}: {{{name}: {0.5 * (bounds[0] + bounds[1]):.3g}}}'",
            )  # fmt: skip


def check_tools(subject: Subject) -> Iterator[Finding]:
    """An arm whose end no frame is named for."""
    if subject.description is not None:
        return
    others = {n for w in subject.wheels for n in (w.joint, w.steer, w.leg, *w.held) if n}
    arms = find_arms(subject.mechanism, others)
    if not arms:
        yield Finding(
            "warning", "", "", "no joint looks like an arm's", "an end effector is moved by one joint at least"
        )
    elif not any(pattern.search(arms[0].tool) for pattern in TOOLS):
        fix = "add a fixed joint and a link, or a site, where the tool grasps, or take that frame"
        yield Finding("info", "", f"frame '{arms[0].tool}'", "the arm's last; no frame is called like a tool", fix)


# ---------------------------------------------------------------------- wheels
def check_steering(subject: Subject) -> Iterator[Finding]:
    """Steering axes that point down, wheels beside their axes, where the base type has none."""
    if subject.description is not None and subject.description.base.describes_offsets:
        return
    for wheel in subject.rolling:
        if wheel.steer is None:
            continue
        if subject.mechanism.joints[wheel.steer].axis[2] < 0.0:
            fix = "turn the axis around in the file, and its range and 'home' with it"
            yield Finding(
                "warning", "", f"joint '{wheel.steer}'", "it steers about -z: its angles count the other way", fix
            )
        if wheel.offset > BESIDE:
            yield Finding(
                "warning", "", f"wheel '{wheel.joint}'", f"{1e3 * wheel.offset:.3g} mm beside its steering axis: it turns the base as it steers",
                "base type wheels describes it; those whose wheels stand under their axes reject it",
            )  # fmt: skip


def check_casters(subject: Subject) -> Iterator[Finding]:
    """Wheels that nothing drives, and whether they would lift the others."""
    passive = [w for w in subject.wheels if w.passive]
    if not passive:
        return
    names = sorted({n for w in passive for n in (w.joint, w.steer) if n})
    hold = ", ".join(f"{n}: 0" for n in names)
    yield Finding(
        "info", "", _joints(names), "they look like passive casters; the simulator adds casters of its own",
        f"'fixed_joints: {{{hold}}}'",
    )  # fmt: skip
    floor, low = _bottoms(subject.rolling), _bottoms(passive)
    if floor and low and abs(min(low) - min(floor)) < LEVEL:
        yield Finding(
            "info", "", _joints([w.joint for w in passive]),
            "they are level with the driven wheels: where they are rigid, the least unevenness lifts driven wheels",
            "a simulation with them needs springs or a gap of some millimeters",
        )  # fmt: skip


def check_steadiness(subject: Subject) -> Iterator[Finding]:
    """An arm that tips the robot over at rest: it is too heavy for the wheels, or the masses of the file are wrong."""
    description, mechanism = subject.description, subject.mechanism
    if description is None or len(subject.rolling) < 3 or any(w.passive for w in subject.wheels):
        return
    joints = [mechanism.joints[n] for n in description.arm.joints if n in mechanism.joints]
    given = description.limits.position
    ranges = {j.name: given.get(j.name, j.range or (-np.pi, np.pi)) for j in joints}
    places = np.array([w.center[:2] for w in subject.rolling])
    share = tipping_share(mechanism, places, ranges, description.fixed_joints)
    if share > TIPPING:
        yield Finding(
            "warning", "", "key 'arm'", f"in {100 * share:.0f} % of its postures the center of mass is beside the wheels: the robot tips over",
            "check the masses of the file; narrow the ranges with 'limits.position', or plan with loads of wheels (stability=wheel_loads)",
        )  # fmt: skip


def check_levels(subject: Subject) -> Iterator[Finding]:
    """Driven wheels that hang in the air."""
    wheels = [w for w in subject.rolling if w.radius is not None and not w.assumed]
    bottoms = np.array(_bottoms(wheels))
    if len(wheels) > 1 and np.ptp(bottoms) > LEVEL:
        high = int(np.argmax(bottoms))
        yield Finding(
            "warning", "", f"wheel '{wheels[high].joint}'", f"it hangs {1e3 * (bottoms[high] - bottoms.min()):.3g} mm above the lowest wheel",
            "fix its origin or its shape in the file; wheels of one base stand on one level",
        )  # fmt: skip


def check_radii(subject: Subject) -> Iterator[Finding]:
    """Wheels that are drawn with other radii than their height above a root on the ground."""
    for wheel in subject.rolling:
        height = float(wheel.center[2])
        if (
            wheel.radius is not None
            and not wheel.assumed
            and height > 0.0  # a frame above the wheels is not on the ground, however it is called
            and _on_the_ground(subject)
            and abs(wheel.radius - height) > RADIUS * wheel.radius
        ):
            yield Finding(
                "warning", "", f"wheel '{wheel.joint}'", f"its radius is {wheel.radius:.4g} m, but it stands {height:.4g} m above the ground frame",
                "give 'base.wheel_radius' [m] in the robot's YAML as it is measured",
            )  # fmt: skip


def _on_the_ground(subject: Subject) -> bool:
    return any("footprint" in subject.mechanism.model.body(b).name for b in range(1, subject.mechanism.model.nbody))


def _bottoms(wheels: Sequence[Wheel]) -> list[float]:
    return [float(w.center[2]) - w.radius for w in wheels if w.radius is not None]


def _several(kind: str, names: Sequence[str]) -> str:
    shown = ", ".join(f"'{n}'" for n in names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
    return f"{kind} {shown}" if len(names) == 1 else f"{kind}s {shown}"


def _joints(names: Sequence[str]) -> str:
    return _several("joint", names)


#: Name -> check, in the order in which they are reported.
CHECKS: dict[str, Check] = {
    "macros": check_macros, "meshes": check_meshes, "inertia": check_inertias, "world": check_world, "base-body": check_body, "names": check_names,
    "joint-types": check_kinds, "velocity": check_velocities, "effort": check_efforts, "range": check_ranges, "mimic": check_mimics,
    "telescope": check_telescopes, "home": check_home, "tool": check_tools, "steering": check_steering, "casters": check_casters,
    "level": check_levels, "wheel-radius": check_radii, "steadiness": check_steadiness,
}  # fmt: skip
#: Those that concern a robot when it is loaded: their errors are raised, their warnings logged.
AT_LOAD = ("inertia", "velocity", "range")


def examine(subject: Subject, names: Iterable[str] = tuple(CHECKS)) -> list[Finding]:
    """What checks find, by their names in the table."""
    return [replace(f, check=name) for name in names for f in CHECKS[name](subject)]

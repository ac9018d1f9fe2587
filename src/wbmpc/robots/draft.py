"""A first robot file (YAML) from what a robot's model shows."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from wbmpc.bases import base_type
from wbmpc.bases.base import Proposal, Question
from wbmpc.errors import InputError, unknown_name
from wbmpc.robots.arm_search import Arm, find_arms
from wbmpc.robots.doctor import propose_bases
from wbmpc.robots.home import Home, find_home
from wbmpc.robots.mechanism import Joint, Mechanism
from wbmpc.robots.model_checks import Subject
from wbmpc.robots.steadiness import steadiness
from wbmpc.robots.wheel_search import Wheel

#: Height [m] above the ground at which an end effector of a mobile robot works, where it can.
WORKING_HEIGHT = 0.8
#: Speeds [rad/s], [m/s] of arm joints for which a file has none; of the base [m/s].
TURN, SLIDE, BASE_SPEED = 2.0, 0.2, 1.0
#: An arm's joint has its largest speed after this time [s].
START = 1.0 / 3.0


@dataclass
class Draft:
    """What is found in a model, and what is chosen of it: ``base``, a name of ``bases``, ``arm`` one of ``arms``, ``tool`` one of its frames;
    ``beside``: further arms; ``answers`` to the base's questions, by key."""

    subject: Subject
    bases: dict[str, Proposal]
    base: str
    arms: list[Arm]
    arm: Arm
    tool: str
    beside: list[Arm] = field(default_factory=list)
    answers: dict[str, Any] = field(default_factory=dict)

    @property
    def chosen(self) -> list[Arm]:
        """All chosen arms, the one with the robot's end effector first."""
        return [self.arm, *self.beside]

    @property
    def torso(self) -> list[str]:
        """Joints that carry all of several chosen arms."""
        if not self.beside:
            return []
        return [name for name in self.arm.joints if all(name in a.joints for a in self.beside)]

    @property
    def joints(self) -> list[str]:
        """Of all chosen arms, each once."""
        return list(dict.fromkeys(name for arm in self.chosen for name in arm.joints))

    @property
    def mechanism(self) -> Mechanism:
        """The model."""
        return self.subject.mechanism

    @property
    def proposal(self) -> Proposal:
        """Of the chosen base type."""
        return self.bases[self.base]

    def choose_arm(self, name: str) -> None:
        """By its name, or by that of its last joint; several with commas between them. Raises :class:`InputError` listing the arms."""
        found = [self._arm(part.strip()) for part in name.split(",")]
        if len({a.name for a in found}) < len(found):
            raise InputError(f"arm: every arm once, got '{name}'")
        self.arm, self.tool, self.beside = found[0], found[0].tool, found[1:]

    def _arm(self, name: str) -> Arm:
        found = next((a for a in self.arms if name in (a.name, a.joints[-1])), None)
        if found is None:
            raise unknown_name("arm", name, [a.name for a in self.arms])
        return found

    def choose_base(self, name: str) -> None:
        """A base type that can describe the model. Raises :class:`InputError` listing them, and the wheels that were found."""
        if name not in self.bases:
            wheels = [
                f"{w.joint} ({'caster' if w.passive else 'driven' if w.driven else 'not driven'})"
                for w in self.subject.wheels
            ]
            what = ", ".join(wheels) or "none (a hinge near the ground with a horizontal axis and no range is one)"
            error = unknown_name("base type for this model", name, self.bases)
            raise InputError(f"{error}; its wheels, as found: {what}")
        self.base = name

    @property
    def wheels(self) -> list[Wheel]:
        radius = self.answers.get("wheel_radius")
        return [w if radius is None else replace(w, radius=radius, assumed=False) for w in self.subject.driven]

    @property
    def unanswered(self) -> list[Question]:
        """Questions of the base whose answers are assumed."""
        return [q for q in self.proposal.questions if q.key not in self.answers]

    def answer(self, key: str, value: Any) -> None:
        """Take the answer to a question of the base; speeds and accelerations that it proposes follow the radius of the wheels."""
        self.answers[key] = value
        if key == "wheel_radius":
            known = base_type(self.base).propose(self.mechanism, self.wheels)
            self.bases[self.base] = known or self.proposal

    def choose_tool(self, name: str) -> None:
        """A frame that the arm moves. Raises :class:`InputError` listing them."""
        if name not in self.arm.tools:
            raise unknown_name(f"frame behind '{self.arm.joints[-1]}'", name, self.arm.tools)
        self.tool = name


def make_draft(mechanism: Mechanism) -> Draft:
    """The best proposals. Raises :class:`InputError` for a model without an arm."""
    subject = Subject(mechanism)
    arms = find_arms(mechanism, {n for w in subject.wheels for n in (w.joint, w.steer, w.leg, *w.held) if n})
    if not arms:
        raise InputError(
            f"{mechanism.file.path}: no joint looks like an arm's; an end effector is moved by one joint at least"
        )
    bases = propose_bases(subject)
    return Draft(subject, bases, next(iter(bases)), arms, arms[0], arms[0].tool)


# ---------------------------------------------------------------------- what follows from the choices
def body_of(draft: Draft) -> str:
    """The highest body that is fixed to the one which carries arm and wheels; of a base that does not move the one that stands in the
    world."""
    mechanism = draft.mechanism
    arm = mechanism.path(mechanism.parent(mechanism.joints[draft.arm.joints[0]].body))
    if not base_type(draft.base).Description.moves:
        return arm[1] if len(arm) > 1 else arm[0]
    _check_whole_robot(draft)
    paths = [arm]
    for wheel in draft.subject.driven:
        first = (*mechanism.joints[wheel.joint].above, wheel.joint)[0]
        paths.append(mechanism.path(mechanism.parent(mechanism.joints[first].body)))
    common = [bodies[0] for bodies in zip(*paths) if len(set(bodies)) == 1]
    if len(common) < 2:
        raise InputError(
            f"{mechanism.file.path}: wheels and arm have no common body but the world: no body is the base's; where joints "
            f"from '{draft.arm.joints[0]}' on move the whole robot, as the base type does, make them fixed in the file"
        )
    carrier = draft.mechanism.model.body(common[-1])
    weld = draft.mechanism.model.body_weldid
    return next(b for b in common[1:] if weld[draft.mechanism.model.body(b).id] == weld[carrier.id])


def _check_whole_robot(draft: Draft) -> None:
    """Raise :class:`InputError` naming joints above all wheels and the arm, with which files for planners move a base."""
    mechanism, ends = draft.mechanism, [w.joint for w in draft.subject.driven] + [draft.arm.joints[-1]]
    moved = [f"'{n}'" for n in mechanism.joints if all(n in mechanism.joints[end].above for end in ends)]
    if moved and draft.subject.driven:
        raise InputError(
            f"{mechanism.file.path}: {', '.join(moved[:3])} move wheels and arm, as the base type does: make them fixed in the file"
        )


def held_joints(draft: Draft, body: str) -> dict[str, float]:
    """Joints below the base that neither base nor arm moves, with the values [rad or m] at which they are held."""
    used = {*draft.joints, *draft.proposal.joints, *couplings_of(draft)}
    inside = [j for j in draft.mechanism.joints.values() if body in draft.mechanism.path(j.body)[:-1]]
    return {j.name: round(j.rest, 4) for j in inside if j.name not in used}


def couplings_of(draft: Draft) -> dict[str, Any]:
    """Joints that follow those of the arm, as the key ``couple`` of the YAML has them."""
    found: dict[str, Any] = {}
    for joint in draft.mechanism.joints.values():
        d = joint.drive
        if d.mimics in draft.joints and joint.name not in draft.joints:
            plain = (d.ratio, d.offset) == (1.0, 0.0)
            found[joint.name] = d.mimics if plain else {"joint": d.mimics, "ratio": d.ratio, "offset": d.offset}
    return found


def ground_of(draft: Draft) -> float:
    """Height [m] of the floor in the file's world: under the driven wheels, 0 without any."""
    return min((float(w.center[2]) - (w.radius or 0.0) for w in draft.wheels), default=0.0)


def home_of(draft: Draft, held: Mapping[str, float], height: float | None) -> Home:
    """A home; ``height`` [m] of the end effector above the ground, None: the usual one of a mobile robot, or any."""
    moves = base_type(draft.base).Description.moves
    if height is None and moves:
        height = WORKING_HEIGHT
    ground = ground_of(draft)
    above, ahead, held = None if height is None else height + ground, np.array([1.0, 0.0]), dict(held)
    home = find_home(draft.mechanism, draft.arm.joints, draft.tool, held, above, ahead, floor=ground)
    for arm in draft.beside:
        held |= home.angles
        own = tuple(n for n in arm.joints if n not in held)
        other = find_home(draft.mechanism, own, arm.tool, held, above, ahead, floor=ground)
        free = other.free if home.free in (None, True) else home.free
        home = replace(home, angles=home.angles | other.angles, free=free)
    return home


def speed_of(joint: Joint) -> tuple[float, bool]:
    """Largest speed [rad/s or m/s] of an arm's joint, and whether the model has it."""
    if joint.drive.velocity is not None:
        return joint.drive.velocity, True
    return (SLIDE if joint.kind == "slide" else TURN), False


def limits_of(draft: Draft) -> tuple[dict[str, float], list[str]]:
    """Speeds by joint, and those of them that the model does not have."""
    joints, assumed = draft.mechanism.joints, []
    speeds = {}
    for name in draft.proposal.joints:
        given = joints[name].drive.velocity
        speeds[name] = draft.proposal.speed[name] if given is None else given
        assumed += [name] if given is None else []
    for name in draft.joints:
        speeds[name], known = speed_of(joints[name])
        assumed += [] if known else [name]
    return {n: round(v, 4) for n, v in speeds.items()}, assumed


def accelerations_of(draft: Draft, speeds: Mapping[str, float], angles: Mapping[str, float]) -> dict[str, float]:
    """By joint [rad/s² or m/s²]: the base type's, and an arm's by its speeds; of a robot on wheels no more than it stands in the posture
    ``angles``."""
    given, arm = dict(draft.proposal.acceleration), {n: speeds[n] / START for n in draft.joints}
    moves = base_type(draft.base).Description.moves
    steady = steadiness(draft.mechanism, draft.wheels, draft.joints, angles) if moves else None
    if steady is not None:
        arm = {n: min(a, steady.joints.get(n, np.inf)) for n, a in arm.items()}
        for w in draft.wheels:
            if w.radius and w.joint in given:
                given[w.joint] = min(given[w.joint], steady.base / w.radius)
    return {n: round(a, 3) for n, a in {**given, **arm}.items()}


def base_speed(draft: Draft) -> float | None:
    """Largest speed [m/s] of a base on wheels, as they can; None where its type has no such limit."""
    if "base_linear" not in base_type(draft.base).Description.limit_keys:
        return None
    speeds, _ = limits_of(draft)
    rims = [speeds[w.joint] * w.radius for w in draft.wheels if w.radius and w.joint in speeds]
    return round(min([BASE_SPEED, *rims]), 3)


def description_of(
    draft: Draft, out: Path, packages: Mapping[str, Path], arguments: Mapping[str, str], height: float | None
) -> tuple[dict[str, Any], Home]:
    """The content of the robot's YAML in the folder of ``out``, and its home."""
    body = body_of(draft)
    held = held_joints(draft, body)
    home = home_of(draft, held, height)
    speeds, _ = limits_of(draft)
    linear = base_speed(draft)
    limits: dict[str, Any] = {} if linear is None else {"base_linear": linear, "base_angular": 1.0}
    data: dict[str, Any] = {
        "name": robot_name(out.stem),
        "model": relative(draft.mechanism.file.path, out.parent),
        "packages": {name: relative(folder, out.parent) for name, folder in packages.items()},
        "xacro_arguments": dict(arguments),
        "base": {"type": draft.base, "body": body, **draft.proposal.section, **draft.answers},
        **arms_of(draft),
        "couple": couplings_of(draft),
        "fixed_joints": held,
        "home": home.angles,
        "limits": {**limits, "velocity": speeds, "acceleration": accelerations_of(draft, speeds, held | home.angles)},
    }
    return {key: value for key, value in data.items() if value != {}}, home


def arms_of(draft: Draft) -> dict[str, Any]:
    """The keys ``arm``, or ``torso`` and ``arms``, of the YAML."""
    torso, tools = draft.torso, [draft.tool, *(a.tool for a in draft.beside)]
    arms = {
        arm.name: {"joints": [n for n in arm.joints if n not in torso], "tool": tool}
        for arm, tool in zip(draft.chosen, tools, strict=True)
    }
    if not draft.beside:
        return {"arm": arms[draft.arm.name]}
    return {"torso": torso, "arms": arms} if torso else {"arms": arms}


def robot_name(text: str) -> str:
    """Letters, digits, - and _ of a text, as a robot's name has them."""
    plain = "".join(c if c.isascii() and (c.isalnum() or c in "-_") else "-" for c in text).strip("-_")
    return plain[:64] or "robot"


def relative(path: Path, folder: Path) -> str:
    """A path as a file in ``folder`` names it."""
    return os.path.relpath(path.resolve(), folder.resolve())

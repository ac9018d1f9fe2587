"""What of a model looks like an arm, and which frame like its tool."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from wbmpc.robots.mechanism import Joint, Mechanism

#: Joints of grippers and of what is no arm, by their own names or those of the bodies that they move.
GRIPPER = re.compile(
    r"finger|gripper|thumb|knuckle|jaw|claw|palm|hand(?!le)|suction|pinky|_index|_middle|_ring|puller", re.IGNORECASE
)
NO_ARM = re.compile(r"head|neck|camera|sensor|lidar|laser|kinect|antenna|tablet|screen|wheel|cast[eo]r", re.IGNORECASE)
#: Joints that an arm ends with, though what they move may be called a hand, or like a gripper or sensor that is mounted on it.
WRIST = re.compile(r"wrist", re.IGNORECASE)
#: Frames of tools, the best first.
TOOLS = [
    re.compile(p, re.IGNORECASE)
    for p in (
        r"tcp|tool_?cent", r"grasp", r"tool_?0|tool_frame|tool_link|\btool\b", r"end_?eff|\bee\b|_ee(_|\b)|^ee_|eef", r"gripper.*(frame|base|link)",
        r"tool", r"hand|palm|gripper", r"flange",
    )
]  # fmt: skip
#: Frames that are fixed to a hand and no tool.
NO_TOOL = re.compile(r"camera|optical|imu|sensor|aruco|inertia|_ft_|collision|visual|cable|light", re.IGNORECASE)
#: Several ends of one chain that are shorter than this share of what they have in common are fingers.
_FINGERS = 0.2
#: A range up to this [m] of a slide at a chain's end is a gripper's.
_STROKE = 0.12


@dataclass(frozen=True)
class Arm:
    """``name``: what sets it apart; ``joints`` from the base to the end effector, torso first; ``tool``: the proposed frame; ``tools``:
    all frames that its last joint moves and no gripper; ``length`` [m]: along the joints."""

    name: str
    joints: tuple[str, ...]
    tool: str
    tools: tuple[str, ...]
    length: float


def find_arms(mechanism: Mechanism, others: Collection[str]) -> list[Arm]:
    """Chains of joints that can move and are not among ``others``, the likeliest arm first."""
    moving = {n: j for n, j in mechanism.joints.items() if n not in others and not j.drive.no_range}
    joints = {n: j for n, j in moving.items() if not is_gripper(mechanism, j)}
    ends = [j for j in joints.values() if not any(n in joints for n in mechanism.below(j.name))]
    chains = [tuple(n for n in (*end.above, end.name) if n in joints) for end in ends]
    chains = [c for c in chains if not _no_arm(mechanism, c)]
    chains = list(dict.fromkeys(_without_fingers(mechanism, c, chains) for c in chains))
    arms = [_arm(mechanism, c, chains) for c in chains]
    return sorted(arms, key=lambda arm: (-min(len(arm.joints), 6), -round(arm.length, 2), arm.name))


def is_gripper(mechanism: Mechanism, joint: Joint) -> bool:
    """Whether a joint moves fingers, or follows another."""
    if joint.drive.mimics is not None or GRIPPER.search(joint.name):
        return True
    if GRIPPER.search(joint.body) and not WRIST.search(joint.name):
        return True
    short = joint.kind == "slide" and joint.range is not None and joint.range[1] - joint.range[0] <= _STROKE
    return short and not joint.vertical and not mechanism.below(joint.name) and len(joint.above) > 2


def _without_fingers(mechanism: Mechanism, chain: tuple[str, ...], chains: list[tuple[str, ...]]) -> tuple[str, ...]:
    """A chain up to where it parts from others, if all that hang there are short along their own joints."""
    shared = max((_shared(chain, c) for c in chains if c != chain), default=0)
    if not shared:
        return chain
    fingers = {chain, *(c for c in chains if c[:shared] == chain[:shared])}
    longest = max(_length(mechanism, c[shared:]) for c in fingers)
    return chain[:shared] if longest < _FINGERS * _length(mechanism, chain[:shared]) else chain


def _shared(chain: tuple[str, ...], other: tuple[str, ...]) -> int:
    """How many joints two chains have in common from their beginning."""
    return next((k for k, (a, b) in enumerate(zip(chain, other, strict=False)) if a != b), min(len(chain), len(other)))


def _length(mechanism: Mechanism, chain: Sequence[str]) -> float:
    """Along joints [m]."""
    at = np.array([mechanism.joints[n].position for n in chain])
    return float(np.sum(np.linalg.norm(np.diff(at, axis=0), axis=1)))


def _no_arm(mechanism: Mechanism, chain: tuple[str, ...]) -> bool:
    last = mechanism.joints[chain[-1]]
    return bool(NO_ARM.search(last.name) or (NO_ARM.search(last.body) and not WRIST.search(last.name)))


def _arm(mechanism: Mechanism, chain: tuple[str, ...], chains: list[tuple[str, ...]]) -> Arm:
    tools = list(_tools(mechanism, mechanism.joints[chain[-1]]))
    at = np.array([mechanism.joints[n].position for n in chain] + [tools[0][1]])
    length = float(np.sum(np.linalg.norm(np.diff(at, axis=0), axis=1)))
    return Arm(_name(chain, chains), chain, tools[0][0], tuple(name for name, _ in tools), length)


def _name(chain: tuple[str, ...], chains: list[tuple[str, ...]]) -> str:
    """The side in the name of the first joint that is the chain's own, else that joint's name."""
    own = next((n for n in chain if all(n not in c for c in chains if c != chain)), chain[-1])
    side = re.search(r"left|right|(?<![a-z])[lr](?=_)", own, re.IGNORECASE)
    names = {"l": "left", "r": "right"}
    return names.get(side[0].lower(), side[0].lower()) if side else own


def _fixed_behind(mechanism: Mechanism, joint: Joint, last: Joint) -> bool:
    """Whether a joint below ``last`` and all between them cannot move."""
    return all(mechanism.joints[n].drive.no_range for n in (*joint.above[len(last.above) + 1 :], joint.name))


def _tools(mechanism: Mechanism, last: Joint) -> Iterator[tuple[str, np.ndarray]]:
    """Frames behind a joint, the likeliest first: by their names, then the farthest."""
    still = (
        j for j in map(mechanism.joints.get, mechanism.below(last.name)) if j and _fixed_behind(mechanism, j, last)
    )
    frames = [frame for body in (last.body, *(j.body for j in still)) for frame in mechanism.frames(body)]
    good = [f for f in frames if not NO_TOOL.search(f[0])] or frames

    def rank(frame: tuple[str, np.ndarray]) -> tuple[int, float]:
        kind = next((i for i, pattern in enumerate(TOOLS) if pattern.search(frame[0])), len(TOOLS))
        return kind, -round(float(np.linalg.norm(frame[1] - last.position)), 4)

    yield from sorted(good, key=rank)

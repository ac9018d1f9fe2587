"""Weights that follow from a robot's size and limits: a start for any robot, without tuning."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from wbmpc.arrays import Array

if TYPE_CHECKING:
    from wbmpc.model.robot import RobotModel

#: Half range [rad] of a continuous joint; largest speed [rad/s] of one without a limit.
_TURNS, _FAST = np.pi, 2.0
#: Numbers of a pose, and of one in the plane.
_POSE, _BASE = 6, 3
#: Random postures of the arm whose spread is its reach.
_POSTURES = 400


@dataclass(frozen=True)
class ScaledWeights:
    """``end_effector`` (6): of position [1/m²] and orientation [1/rad²]; ``posture`` (n): of each arm joint; ``input``: of every input, by
    group. All per second."""

    end_effector: Array
    posture: Array
    input: dict[str, list[float]]


def scaled_weights(
    robot: RobotModel, end_effector: float = 4000.0, input: float = 0.4, posture: float = 0.5
) -> ScaledWeights:
    """Position ``end_effector`` [1/m²] and orientation that times (reach / 4)²; every input ``input`` over the square of its limit; every
    arm joint ``posture`` over the square of half its range, times :func:`free_share`. Sections of one telescope weigh together as one
    joint with all their range and speed: each alone is short, and would be held at home as if its few centimeters were all of the way."""
    limits, arm = robot.limits, robot.state["arm"]
    effector = end_effector * np.array([1.0] * 3 + [(reach(robot) / 4.0) ** 2] * 3)
    half = np.minimum(0.5 * (limits.state_upper[arm] - limits.state_lower[arm]), _TURNS)
    maximum = np.where(np.isfinite(limits.input_upper), limits.input_upper, _FAST)
    rates = {group: list(input / maximum[robot.input[group]] ** 2) for group in robot.input.groups}
    rates["arm"] = list(input / _shared(robot, maximum[robot.input["arm"]]))
    return ScaledWeights(effector, free_share(robot) * posture / _shared(robot, half), rates)


def _shared(robot: RobotModel, sizes: Array) -> Array:
    """Squares (n) of ``sizes`` (n) of arm joints; for a section of a telescope, its size times that of all of them together."""
    together = sizes.copy()
    for joints in telescopes(robot):
        together[joints] = sizes[joints].sum()
    return np.asarray(sizes * together)


def telescopes(robot: RobotModel) -> list[list[int]]:
    """Arm joints (by their order in the state) that slide one on the other along one direction."""
    found: dict[int, list[int]] = {}
    for number, name in enumerate(robot.state.groups["arm"]):
        first = robot.tree.joint(name)
        while (before := robot.tree.section_before(first)) >= 0:
            first = before
        found.setdefault(first, []).append(number)
    return [joints for joints in found.values() if len(joints) > 1]


def free_share(robot: RobotModel) -> float:
    """How much of a posture can be kept while the end effector follows poses: all of it by a robot with as many joints more than a pose
    has numbers as a base in the plane, none without any more: its posture would pull against every pose but home's. A telescope counts
    as one joint."""
    base = _BASE if robot.description.base.moves else 0
    own = len(robot.state.groups["arm"]) - sum(len(joints) - 1 for joints in telescopes(robot))
    return float(np.clip((own + base - _POSE) / _BASE, 0.0, 1.0))


def reach(robot: RobotModel) -> float:
    """How far [m] the end effector gets from the middle of where it can be: 98 % of random postures."""
    arm = robot.state["arm"]
    low, high = robot.limits.state_lower[arm], robot.limits.state_upper[arm]
    low, high = np.where(np.isfinite(low), low, -_TURNS), np.where(np.isfinite(high), high, _TURNS)
    states = np.zeros((_POSTURES, robot.state.size))
    states[:, arm] = np.random.default_rng(0).uniform(low, high, (_POSTURES, low.size))
    at = robot.poses(states)[:, :3]
    return float(np.quantile(np.linalg.norm(at - at.mean(axis=0), axis=1), 0.98))

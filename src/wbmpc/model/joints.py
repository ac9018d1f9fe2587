"""Limits and home of the joints that a robot's description names: what base types have in common."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from wbmpc.arrays import Array
from wbmpc.model.layout import Layout

if TYPE_CHECKING:
    from wbmpc.bases.base import Base
    from wbmpc.robots.description import RobotDescription


@dataclass(frozen=True)
class Limits:
    """Bounds of state (nx) and input (nu) in their units; infinite where there is none.

    ``state_lower`` (nx), ``state_upper`` (nx), ``input_lower`` (nu), ``input_upper`` (nu) [rad, m, rad/s, m/s];
    ``input_rate`` (nu): how fast an input that is a joint's speed may change [rad/s²]; ``actuator_upper`` (nu): largest command to
    a drive, above ``input_upper`` where it has a reserve to follow the plan.
    """

    state_lower: Array
    state_upper: Array
    input_lower: Array
    input_upper: Array
    input_rate: Array
    actuator_upper: Array


def joint_limits(
    base: Base, description: RobotDescription, groups: Sequence[str], sizes: Mapping[str, float],
    rates: Mapping[str, float], further: Mapping[str, ArrayLike],
) -> Limits:  # fmt: skip
    """Limits of a base's model from the file's ranges and what the description says instead.

    ``groups``: of joints, in state and input alike. ``sizes`` by joint: largest value of its input; ``rates``: how fast that may
    change; ``further``: largest values of other groups of the input.
    """
    state, inputs = Layout(base.state), Layout(base.input)
    lower, upper = np.full(state.size, -np.inf), np.full(state.size, np.inf)
    size, rate = np.full(inputs.size, np.inf), np.full(inputs.size, np.inf)
    ranges = {link.joint: link.range for link in base.tree.links if link.joint}
    for group in groups:
        for name in base.state.get(group, ()):
            i = state.index(f"{group}.{name}")
            lower[i], upper[i] = description.limits.position.get(name, ranges[name])
        for name in base.input.get(group, ()):
            i = inputs.index(f"{group}.{name}")
            size[i], rate[i] = sizes.get(name, np.inf), rates.get(name, np.inf)
    for group, value in further.items():
        size[inputs[group]] = value
    return Limits(lower, upper, -size, size, rate, size.copy())


def joint_home(base: Base, description: RobotDescription, groups: Sequence[str]) -> Array:
    """State (nx) of a ``base`` with the joints of ``groups`` where the description's home has them, and zeros elsewhere."""
    values = {g: [description.home.get(n, 0.0) for n in base.state[g]] for g in groups}
    return Layout(base.state).vector(values)

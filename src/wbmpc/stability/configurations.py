"""Leg configurations: angles of a robot's legs, by the names that its base type gives them or as numbers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from wbmpc.bases import base_type
from wbmpc.bases.footprint import Footprint
from wbmpc.checks import parse_number
from wbmpc.errors import InputError, unknown_name
from wbmpc.model.robot import RobotModel
from wbmpc.model.wheels import ModuleGeometry
from wbmpc.stability.robot import standing


def configurations(robot: RobotModel) -> Mapping[str, NDArray[np.float64]]:
    """Angles (n) [rad] of the legs by the names of the base type's configurations, within the limits or not; empty where it has none."""
    return base_type(robot.description.base.type).configurations(robot)


def configuration_positions(robot: RobotModel, configuration: str | Sequence[float]) -> NDArray[np.float64]:
    """Leg angles (n) [rad] of a configuration by name (:func:`configurations`), or of n joint angles given as numbers or as
    "0.1,0,-0.2,0".

    Raises :class:`InputError` for a name that the robot does not have, and for angles outside the limits.
    """
    legs, named = hinged(robot).modules, configurations(robot)
    name = configuration.upper() if isinstance(configuration, str) else ""
    angles = named[name] if name in named else _parsed(configuration, legs, named)
    reject_beyond(robot, leg_group(robot), angles, f"configuration {name}" if name in named else "configuration")
    return angles


def leg_group(robot: RobotModel) -> str:
    """The group of the robot's state that is the joints of its legs; empty where it has none that move."""
    footprint: Footprint | None = robot.base.footprint
    return "" if footprint is None or footprint.steered is None else footprint.steered.leg_group


def hinged(robot: RobotModel) -> ModuleGeometry:
    """The legs of a robot. Raises :class:`InputError` where they do not move."""
    geometry = standing(robot).modules
    if geometry is None or not geometry.legs_move:
        raise InputError(
            f"{robot.description.name}: its legs are fixed, so it has no leg configurations; valid: robots with hinged legs"
        )
    return geometry


def reject_beyond(robot: RobotModel, group: str, angles: NDArray[np.float64], what: str) -> None:
    """Raise :class:`InputError` where an angle [rad] of a joint of the group is outside its limits."""
    part, names = robot.state[group], robot.state.groups[group]
    limits = robot.limits.state_lower[part], robot.limits.state_upper[part]
    for name, value, low, high in zip(names, angles, *limits, strict=True):
        if not low <= value <= high:
            raise InputError(f"{what}: {name} at {value:g} rad is outside its limits {low:g} to {high:g}")


def _parsed(configuration: str | Sequence[float], legs: int, named: Iterable[str]) -> NDArray[np.float64]:
    try:
        parts = configuration.replace(",", " ").split() if isinstance(configuration, str) else configuration
        angles = np.array([parse_number(v) if isinstance(v, str) else float(v) for v in parts])
    except ValueError:
        choices = [*named, f"{legs} angles in rad such as {','.join(['0.1'] * legs)}"]
        raise unknown_name("configuration", str(configuration), choices) from None
    if angles.shape != (legs,) or not np.isfinite(angles).all():
        raise InputError(f"configuration: {legs} angles [rad] are needed, finite, one per leg, got {configuration!r}")
    return angles

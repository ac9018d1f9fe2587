"""What base types on fixed wheels have in common when they propose a description of a model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.base import Proposal, Question
from wbmpc.robots.wheel_search import Wheel

#: Rim speed [m/s] of wheels for which a file has no limit; rim acceleration [m/s²] at which they do not slip;
#: radius [m] that is
#: assumed where nothing shows it.
RIM_SPEED, RIM_ACCELERATION, RADIUS = 1.5, 2.0, 0.1
#: Radii that differ by more [m] are not those of one kind of wheels.
_SAME = 0.003


def propose(
    wheels: Sequence[Wheel], fit: float, reason: str, section: Mapping[str, Any], *questions: Question
) -> Proposal:
    """A proposal with these wheels, and their radius where the file draws none."""
    known = [w.radius for w in wheels if w.radius is not None]
    radius = float(np.median(known)) if known else RADIUS
    names = [w.joint for w in wheels]
    asked = list(questions)
    keys: dict[str, Any] = {"wheels": names, **section}
    if len(known) < len(wheels) or any(w.assumed for w in wheels):
        keys["wheel_radius"] = round(radius, 4)
        asked.append(Question("wheel_radius", "radius of the wheels [m]", round(radius, 4)))
    elif max(known) - min(known) > _SAME:
        return Proposal(keys, 0.0, f"{reason}, of different radii")
    held = tuple(n for w in wheels for n in w.held)
    speed, acceleration = ({n: round(rim / radius, 2) for n in names} for rim in (RIM_SPEED, RIM_ACCELERATION))
    return Proposal(keys, fit, reason, tuple(names), held, speed, acceleration, questions=tuple(asked))


def fixed_wheels(wheels: Sequence[Wheel]) -> list[Wheel]:
    """Those that do not steer."""
    return [w for w in wheels if w.steer is None]


def headings(wheels: Sequence[Wheel]) -> Array:
    """(n, 2): rolling directions."""
    return np.array([w.heading for w in wheels]).reshape(-1, 2)


def axles(wheels: Sequence[Wheel], direction: Array) -> Array:
    """(n) [m]: where the wheels' axles cross a line along ``direction`` (2)."""
    return np.array([w.center[:2] @ direction for w in wheels])

"""Residuals of an end effector and a door that move together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

from wbmpc.checks import finite, not_negative, positive
from wbmpc.ocp.symbols import Symbols

#: Spheres around the robot's parts that come near a door: frame, height in it [m], radius [m].
PARTS = {"wheels": ("base", 0.13, 0.2), "top": ("base", 0.45, 0.11), "elbow": ("arm_forearm_link", 0.0, 0.06)}


@dataclass(frozen=True)
class PanelContact:
    """End effector and door move together: the end effector stays at its place on the panel, by rows of acceleration (Baumgarte 1972).

    ``normal``: g̈ + 2 ``rate`` ġ + ``rate``² g for the distance g [m] from the panel, with g̈ = tᵀ(J q̈ + J̇ q̇) − ℓ φ̈ + … and φ̈ from
    the door's own equation: the row that Minniti et al. 2019, section V-A, leave out. ``stick``: s̈ + 2 ``rate`` ṡ for the
    place along the panel and the height: an end effector inside its friction cone does not slide. ``dynamics``: a
    :class:`wbmpc.studies.minniti2019.door_model.WithDoor`; ``rate`` [1/s].
    """

    dynamics: Any
    rate: float = 10.0

    size, reference = 3, 0
    groups = {"normal": slice(0, 1), "stick": slice(1, 3)}  # noqa: RUF012

    def __post_init__(self) -> None:
        finite("panel contact", rate=self.rate)
        not_negative("panel contact", rate=self.rate)

    def __call__(self, s: Symbols) -> ca.SX:
        place, speed, acceleration = self.dynamics.contact_motion(s.all_x, s.all_u, s.parameters, s.mode)
        pull = ca.vertcat(self.rate**2 * place[0], 0.0, 0.0)
        return acceleration + 2.0 * self.rate * speed + pull


@dataclass(frozen=True)
class ApproachSpeed:
    """How much slower than it may an end effector comes to the panel, L − ġ, and moves along it and up, L ∓ ṡ, over ``least``, for the
    limit L [m/s] of the reference (1), which is ``least`` [m/s] at the panel.

    A touch is then no faster than that, an impact of a hard tip, whose force grows with its speed, no harder, and a tip slides no
    farther before friction stops it. The limit is a reference and no function of the planned distance: the barrier of a row that
    has more room far from the panel would hold the end effector away from it. ``dynamics``: a
    :class:`wbmpc.studies.minniti2019.door_model.WithDoor`.
    """

    dynamics: Any
    least: float

    size, reference = 5, 1
    groups = {"approach": slice(0, 1), "along": slice(1, 5)}  # noqa: RUF012

    def __post_init__(self) -> None:
        positive("approach speed", least=self.least)

    def __call__(self, s: Symbols) -> ca.SX:
        _, speed, _ = self.dynamics.contact_motion(s.all_x, s.all_u, s.parameters, s.mode)
        fast = ca.vertcat(speed[0], speed[1], -speed[1], speed[2], -speed[2])
        return (s.reference[0] - fast) / self.least


@dataclass(frozen=True)
class BodyClearance:
    """How far [m] parts of the robot are before a door's panel, on the side from which it is pushed, minus ``margin`` [m]: base and elbow,
    as spheres of :data:`PARTS`. The panel counts as if it went on forever; a robot that pushes a door stays on one side of it. The
    reference (1) [m] is added: what may be missing where the panel does not count.

    ``dynamics``: a :class:`wbmpc.studies.minniti2019.door_model.WithDoor`, whose door's angle the plan knows.
    """

    dynamics: Any
    half_thickness: float
    margin: float

    size, reference = len(PARTS), 1
    groups = {name: slice(i, i + 1) for i, name in enumerate(PARTS)}  # noqa: RUF012

    def __post_init__(self) -> None:
        not_negative("body clearance", margin=self.margin, half_thickness=self.half_thickness)

    def __call__(self, s: Symbols) -> ca.SX:
        x, w = s.all_x, s.parameters
        frames = [self.dynamics.part(x, frame, height) for frame, height, _ in PARTS.values()]
        kept = [radius + self.half_thickness + self.margin for _, _, radius in PARTS.values()]
        return ca.vertcat(
            *[s.reference[0] - self.dynamics.beyond(x, w, p) - r for p, r in zip(frames, kept, strict=True)]
        )

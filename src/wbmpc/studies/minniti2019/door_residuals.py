"""Residuals of an end effector and a door that move together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

from wbmpc.checks import finite
from wbmpc.errors import InputError
from wbmpc.ocp.symbols import Symbols


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
        if self.rate < 0.0:
            raise InputError(f"panel contact: rate must not be negative, got {self.rate}")

    def __call__(self, s: Symbols) -> ca.SX:
        place, speed, acceleration = self.dynamics.contact_motion(s.all_x, s.all_u, s.parameters, s.mode)
        pull = ca.vertcat(self.rate**2 * place[0], 0.0, 0.0)
        return acceleration + 2.0 * self.rate * speed + pull

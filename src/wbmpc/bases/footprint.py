"""Where a base stands on the ground, and what the state says of feet that are steered wheels: protocols of :mod:`wbmpc.bases.base`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from wbmpc.arrays import Array

if TYPE_CHECKING:
    import casadi as ca

    from wbmpc.model.wheels import ModuleGeometry


class SteeredFeet(Protocol):
    """What a state x (nx) says of feet that are n steered wheels. ``leg_group``: group of the state of the joints that move their legs;
    empty where these are fixed."""

    leg_group: str

    def legs(self, x: Array) -> Array:
        """Positions (n) [rad, or m of those that slide] of the legs' joints; zero where they are fixed."""

    def headings(self, x: Array) -> Array:
        """Directions (n) [rad] of the wheels in the axes of the body."""

    def with_legs(self, x: Array, legs: Array) -> Array:
        """The state with the legs' joints at ``legs`` (n), the wheels along the same directions of the body."""

    def rolling(self, x: Array, twist: Array) -> Array:
        """The state with the wheels along a twist (vx, vy, wz) of the body, within a quarter turn of where they stand at zero."""


class Footprint(Protocol):
    """Where a base stands on the ground: ``size`` points, in the axes of its body, with ``names`` of their wheels or casters.
    ``even``: they share the load as equal springs under a stiff body do. Where the points are those of steered wheels, ``modules`` are
    its legs, and ``steered`` reads them from a state; else None."""

    size: int
    names: list[str]
    even: bool
    modules: ModuleGeometry | None
    steered: SteeredFeet | None

    def positions(self, x: Array) -> Array:
        """Feet (n, 2) [m] in the axes of the body at a state ``x`` (nx) [m, rad]."""

    def expressions(self, x: ca.SX) -> list[ca.SX]:
        """The same (2 each) [m] as symbols of the state ``x`` (nx) [m, rad]."""

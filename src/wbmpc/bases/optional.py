"""What generic code asks of some bases only, beside :class:`wbmpc.bases.base.Base`: a base offers a part by having its members."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from numpy.typing import ArrayLike

from wbmpc.arrays import Array
from wbmpc.errors import InputError

if TYPE_CHECKING:
    import casadi as ca

    from wbmpc.bases.base import Base
    from wbmpc.model.joints import Limits

Units = Mapping[str, str | Sequence[str]]


@runtime_checkable
class HasUnits(Protocol):
    """Units of state and input by group: one text for all of its names, or one for each."""

    @property
    def state_units(self) -> Units:
        """Of the state's groups."""

    @property
    def input_units(self) -> Units:
        """Of the input's groups."""


@runtime_checkable
class HasJacobian(Protocol):
    """A Jacobian of the dynamics that is cheaper than what differentiating ``derivative`` gives."""

    def jacobian(self, x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> tuple[ca.SX, ca.SX]:
        """ẋ and its Jacobian (nx, nx + nu) by [x; u]."""


@runtime_checkable
class HasAcceleration(Protocol):
    """Accelerations that its wheels allow the base."""

    def acceleration(self, limits: Limits) -> Array:
        """(m) bounds of the rates of the base's input [its unit per second] for which wheels keep their ``limits``."""


@runtime_checkable
class HasContacts(Protocol):
    """Forces of the world on frames of the robot as inputs."""

    @property
    def contacts(self) -> Mapping[str, Mapping[str, str]]:
        """Groups of the input by "force" and "moment", by frame."""


@runtime_checkable
class ChecksBrakes(Protocol):
    """A base that brakes can leave without a hold."""

    def check_brakes(self, leg: ArrayLike, brake: ArrayLike) -> None:
        """Raise :class:`InputError` if joints that stay at ``leg`` (n) [rad] with ``brake`` (n, 1 = open) let the base move freely."""


@runtime_checkable
class Mounted(Protocol):
    """A base that stands still: its pose in the model's world is a number."""

    @property
    def position(self) -> Array:
        """(3) [m]."""

    @property
    def quaternion(self) -> Array:
        """(4)."""


def mounting(base: Base) -> tuple[Array, Array]:
    """Position (3) [m] and quaternion (4) of a base that stands still. Raises :class:`InputError` for one that moves."""
    if not isinstance(base, Mounted):
        raise InputError("a base that stands still, with 'position' and 'quaternion', is needed; this one moves")
    return base.position, base.quaternion

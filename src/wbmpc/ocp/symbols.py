"""What residuals are: expressions of the symbols of a problem, with named rows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, Protocol, runtime_checkable

import casadi as ca


@dataclass(frozen=True)
class Symbols:
    """The symbols that a residual may use: the robot's state x and input u, the model's parameters and mode values, its reference.

    ``all_x`` and ``all_u`` are those of the problem, which may have more states and other inputs than the robot
    (:class:`wbmpc.model.augment.InputRate`, :class:`wbmpc.model.augment.DriveLag`).
    """

    x: ca.SX
    u: ca.SX
    parameters: ca.SX
    mode: ca.SX
    reference: ca.SX
    all_x: ca.SX
    all_u: ca.SX

    def rate_of(self, rows: ca.SX, dynamics: Any) -> ca.SX:
        """Time derivative of ``rows`` of the state under ``dynamics``, whose states and inputs are the first of the problem's: those of
        progress along a path (:class:`wbmpc.WithPath`) come after them."""
        x, u = self.all_x[: dynamics.state.size], self.all_u[: dynamics.input.size]
        return ca.jtimes(rows, x, dynamics(x, u, self.parameters, self.mode))


class Residual(Protocol):
    """``size`` rows in named ``groups``; ``reference`` numbers are compared with."""

    @property
    def size(self) -> int:
        """How many rows."""

    @property
    def groups(self) -> Mapping[str, slice]:
        """Rows by name."""

    @property
    def reference(self) -> int:
        """How many numbers it is compared with."""

    def __call__(self, s: Symbols) -> ca.SX: ...


@dataclass(frozen=True)
class Wrapping:
    """A residual with the rows of another one, ``inner``."""

    inner: Residual

    @property
    def size(self) -> int:
        """How many rows."""
        return self.inner.size

    @property
    def groups(self) -> Mapping[str, slice]:
        """Those of ``inner``."""
        return self.inner.groups

    @property
    def reference(self) -> int:
        """How many numbers it is compared with."""
        return self.inner.reference


@runtime_checkable
class FollowsLastInput(Protocol):
    """A residual whose reference is what was commanded last: ``last_inputs``, the indices of those inputs. Its reference has
    their values and then the time [s] since they were commanded; an MPC sets it before every solve."""

    @property
    def last_inputs(self) -> list[int]: ...


@runtime_checkable
class KeepsClear(Protocol):
    """A residual whose reference is nearest points, which an MPC sets before every solve: ``clear_of`` "obstacles", or of "self", between
    parts of the ``robot``."""

    @property
    def robot(self) -> Any: ...

    @property
    def clear_of(self) -> Literal["obstacles", "self"]: ...


@runtime_checkable
class FollowsPath(Protocol):
    """A residual whose reference is what the path of an MPC has near its progress, set before every solve: what it ``follows``."""

    @property
    def follows(self) -> Literal["pose", "speed", "acceleration"]: ...

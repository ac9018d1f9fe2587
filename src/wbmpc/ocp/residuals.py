"""Residuals: symbolic expressions of state, input, parameters and a reference, with named rows.

The same residual serves as a cost, a soft or a hard constraint. To add one: a frozen class with ``size``, ``groups``,
``reference`` (how many numbers it compares with) and ``__call__``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import casadi as ca
import numpy as np

from wbmpc.errors import unknown_name
from wbmpc.model.layout import Layout
from wbmpc.model.robot import RobotModel
from wbmpc.ocp.base_residuals import LockedJoints, Rolling, SupportMargin, TireFriction, Upright, WheelLoads
from wbmpc.ocp.clearance_residuals import Clearance, FloorClearance, SelfClearance
from wbmpc.ocp.contact_residuals import FrictionCone, PushForce, push_on_surface
from wbmpc.ocp.frame_residuals import FramePose, FrameTwist, FrameWrench, RelativeMotion, RelativePose
from wbmpc.ocp.path_residuals import Contour, PathAcceleration, Progress
from wbmpc.ocp.symbols import Residual, Symbols

__all__ = [
    "AccelerationLimit", "Clearance", "Contour", "Expression", "FloorClearance", "FramePose", "FrameTwist",
    "FrameWrench", "FrictionCone", "Input", "Limits", "LockedJoints", "PathAcceleration", "ProblemInput", "Progress",
    "PushForce", "RelativeMotion", "RelativePose", "Residual", "Rolling", "SelfClearance", "State", "SupportMargin",
    "Symbols", "TireFriction", "Upright", "WheelLoads", "push_on_surface",
]  # fmt: skip


@dataclass(frozen=True)
class Expression:
    """A residual of your own: ``size`` rows from a function of the symbols; ``reference`` numbers are compared with."""

    size: int
    function: Callable[[Symbols], ca.SX] = field(compare=False, repr=False)
    reference: int = 0

    @property
    def groups(self) -> dict[str, slice]:
        """One group of all rows."""
        return {"all": slice(0, self.size)}

    def __call__(self, s: Symbols) -> ca.SX:
        return self.function(s)


def _select(layout: Layout, names: Sequence[str] | None) -> tuple[dict[str, slice], list[int]]:
    chosen = tuple(layout.groups) if names is None else tuple(names)
    groups: dict[str, slice] = {}
    indices: list[int] = []
    for name in chosen:
        if name not in layout.groups:
            raise unknown_name("group", name, layout.groups)
        part = list(range(layout.size))[layout[name]]
        groups[name] = slice(len(indices), len(indices) + len(part))
        indices += part
    return groups, indices


@dataclass(frozen=True, init=False)
class _Component:
    robot: RobotModel
    names: Sequence[str] | None
    #: how many numbers the groups are compared with
    reference: int
    groups: Mapping[str, slice] = field(init=False, repr=False)
    indices: list[int] = field(init=False, repr=False)

    def _layout(self) -> Layout:
        raise NotImplementedError

    def __init__(
        self, robot: RobotModel, names: Sequence[str] | None = None, *, reference: Literal["tracked"] | None = "tracked"
    ) -> None:
        object.__setattr__(self, "robot", robot)
        object.__setattr__(self, "names", names)
        groups, indices = _select(self._layout(), names)
        object.__setattr__(self, "groups", groups)
        object.__setattr__(self, "indices", indices)
        object.__setattr__(self, "reference", 0 if reference is None else len(indices))

    @property
    def size(self) -> int:
        """How many rows."""
        return len(self.indices)


@dataclass(frozen=True, init=False)
class State(_Component):
    """Groups of the state (all when ``names`` is left out) minus their reference, in the state's units.

    ``reference=None``: the values themselves, as limits need them. ``groups``: rows by group; ``indices`` of the rows in the state.
    """

    def _layout(self) -> Layout:
        return self.robot.state

    def __call__(self, s: Symbols) -> ca.SX:
        value = s.x[self.indices]
        return value - s.reference if self.reference else value


@dataclass(frozen=True, init=False)
class Input(_Component):
    """Groups of the input (all when ``names`` is left out) minus their reference, in the input's units.

    ``reference=None``: the values themselves, as limits need them. ``groups``: rows by group; ``indices`` of the rows in the input.
    """

    def _layout(self) -> Layout:
        return self.robot.input

    def __call__(self, s: Symbols) -> ca.SX:
        value = s.u[self.indices]
        return value - s.reference if self.reference else value


@dataclass(frozen=True)
class AccelerationLimit:
    """How far joint speeds (groups ``names`` of the input) are inside of what accelerations allow, as shares of the range: ≥ 0.

    Rows: below the upper bounds (n), above the lower ones (n). Reference: the last command (n) and the time [s] since it was
    given. A speed u in [l, L] that may change by a per second is after Δt in [u_last − a Δt, u_last + a Δt]: in a receding
    horizon that is the limit itself where it acts next, and a cone that widens with the time from now. A joint at q that can
    stop before its range ends at Q has u ≤ (a / L)(Q − q): that bound falls by less than a per second. Steering goes without:
    it has to follow rolling wheels up to the end of its range, where a turn about is due. Without a time (0), and for a joint
    whose brake is closed (it stops as hard as it likes), only the rest counts. Limits of speed must be finite.
    ``share`` of the accelerations that plans use: what is left is for feedback, and for drives that are limited together.
    ``inputs``: their indices in the input.
    """

    robot: RobotModel
    names: Sequence[str]
    share: float = 1.0
    inputs: list[int] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "inputs", _select(self.robot.input, self.names)[1])

    @property
    def last_inputs(self) -> list[int]:
        """Inputs whose last command is the reference: see :class:`wbmpc.ocp.symbols.FollowsLastInput`."""
        return self.inputs

    @property
    def size(self) -> int:
        """How many rows."""
        return 2 * len(self.inputs)

    @property
    def reference(self) -> int:
        """How many numbers it is compared with."""
        return len(self.inputs) + 1

    @property
    def groups(self) -> dict[str, slice]:
        """The upper and the lower bounds."""
        n = len(self.inputs)
        return {"upper": slice(0, n), "lower": slice(n, 2 * n)}

    @property
    def row_names(self) -> list[str]:
        """What the rows are called."""
        names = [self.robot.input.names[i] for i in self.inputs]
        return [f"{name} {side}" for side in ("upper", "lower") for name in names]

    def __call__(self, s: Symbols) -> ca.SX:
        limits, since = self.robot.limits, s.reference[len(self.inputs)]
        above, below = [], []
        for k, i in enumerate(self.inputs):
            name = self.robot.input.names[i]
            low, high, most = (float(v[i]) for v in (limits.input_lower, limits.input_upper, limits.input_rate))
            maximum = self.share * most
            last = ca.fmin(ca.fmax(s.reference[k], low), high)
            change = maximum * since + ((since <= 0.0) + self._braked(s, name)) * (high - low)
            upper, lower = ca.fmin(high, last + change), ca.fmax(low, last - change)
            if name.split(".", 1)[0] not in self.robot.base.steering_groups and name in self.robot.state.names:
                j = self.robot.state.index(name)
                if np.isfinite(limits.state_upper[j]):
                    upper = ca.fmin(upper, maximum / high * (float(limits.state_upper[j]) - s.x[j]))
                if np.isfinite(limits.state_lower[j]):
                    lower = ca.fmax(lower, maximum / low * (s.x[j] - float(limits.state_lower[j])))
            above.append((upper - s.u[i]) / (high - low))
            below.append((s.u[i] - lower) / (high - low))
        return ca.vertcat(*above, *below)

    def _braked(self, s: Symbols, name: str) -> ca.SX | float:
        """1 for a joint whose brake is closed."""
        group, joint = name.split(".", 1)
        for brakes, joints in self.robot.base.brakes.items():
            if group == joints:
                return 1.0 - s.mode[self.robot.mode.index(f"{brakes}.{joint}")]
        return 0.0


@dataclass(frozen=True)
class Limits:
    """Distances to the model's limits, all to be at least zero.

    ``of``: "state" (positions), "input" (speeds or torques) or "both". The rows are x − lower, upper − x, u − lower,
    upper − u for finite limits only, each in its own unit. ``groups``: all of them as "limits"; ``rows``: what each is of, its index
    there, its sign and the limit.
    """

    robot: RobotModel
    of: Literal["state", "input", "both"] = "both"
    groups: Mapping[str, slice] = field(init=False, repr=False)
    rows: tuple[tuple[str, int, float, float], ...] = field(init=False, repr=False)

    reference = 0

    def __post_init__(self) -> None:
        if self.of not in ("state", "input", "both"):
            raise unknown_name("kind", self.of, ("state", "input", "both"), where="limits, of")
        limits = self.robot.limits
        rows: list[tuple[str, int, float, float]] = []
        for kind, lower, upper in (
            ("state", limits.state_lower, limits.state_upper),
            ("input", limits.input_lower, limits.input_upper),
        ):
            if self.of in (kind, "both"):
                rows += [(kind, i, 1.0, -float(v)) for i, v in enumerate(lower) if np.isfinite(v)]
                rows += [(kind, i, -1.0, float(v)) for i, v in enumerate(upper) if np.isfinite(v)]
        object.__setattr__(self, "rows", tuple(rows))
        object.__setattr__(self, "groups", {"limits": slice(0, len(rows))})

    @property
    def size(self) -> int:
        """How many rows."""
        return len(self.rows)

    def __call__(self, s: Symbols) -> ca.SX:
        return ca.vertcat(*[sign * (s.x if kind == "state" else s.u)[i] + c for kind, i, sign, c in self.rows])


@dataclass(frozen=True)
class ProblemInput:
    """Groups of the problem's own input (all when ``names`` is left out), e.g. ``arm_rate`` of an ``InputRate``.

    As a cost: input-rate costs; in a box: acceleration limits. ``groups``: rows by group; ``indices`` of the rows in the input.
    """

    dynamics: Any
    names: Sequence[str] | None = None
    groups: Mapping[str, slice] = field(init=False, repr=False)
    indices: list[int] = field(init=False, repr=False)

    reference = 0

    def __post_init__(self) -> None:
        groups, indices = _select(self.dynamics.input, self.names)
        object.__setattr__(self, "groups", groups)
        object.__setattr__(self, "indices", indices)

    @property
    def size(self) -> int:
        """How many rows."""
        return len(self.indices)

    def __call__(self, s: Symbols) -> ca.SX:
        return s.all_u[self.indices]

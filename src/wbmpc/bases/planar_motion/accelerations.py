"""What wheels that are fixed to the body allow plans: each of them has one limit for all speeds of the base together."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from wbmpc.model.kinematics import constant
from wbmpc.ocp.residuals import AccelerationLimit
from wbmpc.ocp.symbols import Symbols

if TYPE_CHECKING:
    from wbmpc.bases.planar_motion.model import PlanarBase


@dataclass(frozen=True)
class WheelAccelerationLimit(AccelerationLimit):
    """How far wheel rates are inside of what the wheels' accelerations allow, as shares of the range: ≥ 0.

    Rows: below the upper bounds of the limited wheels (n), above the lower ones (n). Reference, time and ``share``: see
    :class:`wbmpc.residuals.AccelerationLimit`. Its limits of the base's single speeds would allow a speed ahead and a turn at once what
    wheels can do for one of them; a controller slows everything down then, the arm too, and what the arm does is not what was planned.
    ``base``: the robot's, whose wheels they are.
    """

    base: PlanarBase = field(kw_only=True, repr=False)

    @property
    def size(self) -> int:
        return len(self.row_names)

    @property
    def groups(self) -> dict[str, slice]:
        n = self.size // 2
        return {"upper": slice(0, n), "lower": slice(n, 2 * n)}

    @property
    def row_names(self) -> list[str]:
        wheels = np.flatnonzero(np.isfinite(self.base.wheel_acceleration))
        return [f"wheel {i} {side}" for side in ("upper", "lower") for i in wheels]

    def __call__(self, s: Symbols) -> ca.SX:
        base, limits, m = self.base, self.robot.limits, len(self.inputs)
        limited = np.isfinite(base.wheel_acceleration)
        rates, since = base.rates[limited], s.reference[m]
        span = np.abs(rates) @ (limits.input_upper - limits.input_lower)[self.inputs]
        change = self.share * constant(base.wheel_acceleration[limited]) * since + (since <= 0.0) * constant(span)
        step = constant(rates) @ (s.u[self.inputs] - s.reference[:m])
        return ca.vertcat((change - step) / constant(span), (change + step) / constant(span))

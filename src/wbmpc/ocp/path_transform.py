"""A problem that follows a path at its own speed, made of one that follows a clock."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from wbmpc.errors import InputError
from wbmpc.model.augment import WithPath
from wbmpc.ocp.frame_residuals import FramePose
from wbmpc.ocp.norms import Quadratic, RelaxedBarrier, SmoothL1
from wbmpc.ocp.path_residuals import Contour, PathAcceleration, Progress
from wbmpc.ocp.problem import OptimalControlProblem
from wbmpc.ocp.residuals import ProblemInput
from wbmpc.ocp.sets import NonNegative
from wbmpc.ocp.terms import Constraint, Cost

#: Weight of the speed along the path [s²/m²] as a share of the end effector's [1/m²]: large enough to matter, so small that a robot
#: which is held up stands within millimeters of its path.
SHARE = 0.02
#: Speeds [m/s] that are farther from the desired one than this pull no harder: who asks for more than a robot can do does not get a
#: path with its corners cut.
PULL = 0.1
#: Weight of the acceleration along the path as a share of the speed's [s²]: it chooses among plans that are equally fast.
SMOOTH = 0.01


def path_problem(
    ocp: OptimalControlProblem, pose: str = "end_effector", *, frame: str | None = None, share: float = SHARE,
    mu: float = 3e-3,
) -> OptimalControlProblem:  # fmt: skip
    """The same problem with progress along a path in the place of a clock; ``ocp`` is left as it is.

    The cost ``pose``, of a :class:`wbmpc.residuals.FramePose`, becomes ``contour``: the weights [1/m²] of its positions are those of
    the contour, the largest that of the lag. ``frame``: which one follows the path, as that of the base's body (left out: that of
    ``pose``). ``progress`` weighs the difference of the speed along the path to the desired one with
    ``share`` of that; ``path_acceleration`` is a hard limit with the barrier ``mu``. All other terms stay. Raises :class:`InputError` where
    there is no such cost.
    """
    dynamics = WithPath(ocp.dynamics)
    cost = ocp.term(pose)
    if not (isinstance(cost, Cost) and isinstance(cost.residual, FramePose)):
        raise InputError(
            f"path problem: '{pose}' is no cost of a FramePose; valid: the one that the path takes the place of"
        )
    wrapped = ocp.on(dynamics)
    for name, term in ocp.terms.items():
        if name != pose:
            wrapped.add(term)
    wrapped.add(_contour(dynamics, cost, frame))
    add_progress(wrapped, share * float(np.max(cost.expand(cost.weight)[:3])), mu)
    return wrapped


def add_progress(ocp: OptimalControlProblem, weight: float, mu: float = 3e-3) -> None:
    """What a problem on a :class:`wbmpc.WithPath` needs besides a :class:`wbmpc.residuals.Contour`: ``weight`` [s²/m²] of the speed along
    the path, and the limit of its acceleration, with the barrier ``mu``."""
    dynamics, barrier = ocp.dynamics, RelaxedBarrier(mu, 0.02)
    ocp.add(Cost("progress", Progress(dynamics), weight, SmoothL1(PULL)))
    ocp.add(Cost("path_smoothness", ProblemInput(dynamics, ["path"]), SMOOTH * weight))
    ocp.add(Constraint("path_acceleration", PathAcceleration(dynamics), NonNegative(), penalty=barrier, hard=True))


def _contour(dynamics: Any, cost: Cost, frame: str | None) -> Cost:
    """A cost of a pose as one of a contour: as many rows, and the lag."""
    pose: Any = cost.residual
    widen = lambda v: [*v[:3], float(np.max(v[:3])), *v[3:]]
    end = None if cost.terminal_weight is None else widen(cost.expand(cost.terminal_weight))
    norm = cost.norm
    if isinstance(norm, SmoothL1) and isinstance(norm.scale, tuple):
        norm = SmoothL1(tuple(widen(norm.scale)))
    elif not isinstance(norm, SmoothL1 | Quadratic):
        raise InputError(f"path problem: the norm of '{cost.name}' has rows of its own; valid: Quadratic, SmoothL1")
    residual = Contour(dynamics, pose.robot, frame or pose.frame, pose.axes)
    return replace(
        cost, name="contour", residual=residual, weight=widen(cost.expand(cost.weight)), norm=norm, terminal_weight=end
    )

"""Named terms of an optimal control problem: costs and constraints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from wbmpc.checks import quoted, real_numbers
from wbmpc.errors import InputError, unknown_name
from wbmpc.ocp.norms import AugmentedLagrangian, Norm, Quadratic, RelaxedBarrier
from wbmpc.ocp.residuals import Residual
from wbmpc.ocp.sets import Box, NonNegative, Set, Zero

Weight = float | Sequence[float] | Mapping[str, float | Sequence[float]]
At = Literal["path", "terminal", "path+terminal"]
_AT = ("path", "terminal", "path+terminal")


def _check_at(name: str, at: str, modes: tuple[str, ...] | None) -> None:
    if at not in _AT:
        raise unknown_name("part of the horizon", at, _AT, where=f"term '{name}', at")
    if modes is not None and (isinstance(modes, str) or not modes or not all(isinstance(m, str) for m in modes)):
        raise InputError(f"term '{name}': modes must be a tuple of names, at least one, got {modes!r}")


def _check_residual(name: str, residual: Any) -> None:
    """Raise :class:`InputError` for what is no residual, such as a function or a residual's class."""
    if isinstance(residual, type) or not (callable(residual) and hasattr(residual, "size")):
        raise InputError(
            f"term '{name}', residual: got {quoted(residual)!r}; valid: one of wb.residuals, or your own (wb.residuals.Expression)"
        )


@dataclass(frozen=True)
class Cost:
    """``weight · norm(residual)``, integrated along the path or taken at the end of the horizon.

    ``name``: unique in the problem. ``residual`` r (rows) with its ``norm``; ``at``: "path", "terminal", or "path+terminal".
    ``weight``: one number, one per row, or by the residual's groups, per squared unit of r (and second, along the path).
    ``terminal_weight``: the same for the end (for
    ``at="path+terminal"``; the path's weight when left out; its unit is that of the path's weight times a second).
    ``modes``: the names of the modes in which the term counts; all when left out.
    """

    name: str
    residual: Residual
    weight: Weight = 1.0
    norm: Norm = field(default_factory=Quadratic)
    at: At = "path"
    modes: tuple[str, ...] | None = None
    terminal_weight: Weight | None = None

    def __post_init__(self) -> None:
        _check_at(self.name, self.at, self.modes)
        _check_residual(self.name, self.residual)
        if isinstance(self.norm, type) or not hasattr(self.norm, "curvature"):
            raise InputError(
                f"cost '{self.name}', norm: got {quoted(self.norm)!r}; valid: wb.SmoothL1(scale), or none for the quadratic norm"
            )
        self.expand(self.weight)
        if self.terminal_weight is not None:
            self.expand(self.terminal_weight, "terminal weight")

    def expand(self, weight: Weight, kind: str = "weight") -> np.ndarray:
        """A weight as one number per row of the residual."""
        return expand_rows(weight, self.residual, f"cost '{self.name}', {kind}")


@dataclass(frozen=True)
class Constraint:
    """``residual ∈ set``, at the path's nodes, at the end of the horizon, or both (``at``), in ``modes`` (names; default: all). Messages
    and logs refer to it by ``name``.

    ``name``: unique in the problem. ``modes``: the names of the modes in which it holds; default: all.

    Equalities (``Zero``): rows of state and input enter the Riccati recursion exactly; ``softness`` (one number for all
    rows) softens them: the residual may be softness times its multiplier. Rows of the state alone, and rows at the end,
    have proximal multipliers: exact at convergence. With ``penalty=AugmentedLagrangian(ρ)`` all rows have multipliers.

    Inequalities: relaxed barriers (``penalty=RelaxedBarrier(μ, δ)``), multipliers (``AugmentedLagrangian``), or ``hard``:
    a primal-dual interior point inside the Riccati recursion. A hard row that depends on the state holds wherever it can be
    held and else has the exact L1 ``slack`` penalty (one number, or one for each row, per unit of the row's range and second); rows of
    inputs alone have no slack, but for those that move with the last command (:class:`wbmpc.residuals.AccelerationLimit`). State rows do
    not apply to the measured state itself.
    """

    name: str
    residual: Residual
    set: Set = field(default_factory=Zero)
    at: At = "path"
    modes: tuple[str, ...] | None = None
    penalty: RelaxedBarrier | AugmentedLagrangian = field(default_factory=RelaxedBarrier)
    hard: bool = False
    slack: float | Sequence[float] = 1e3
    softness: float = 0.0

    def __post_init__(self) -> None:
        _check_at(self.name, self.at, self.modes)
        _check_residual(self.name, self.residual)
        if not isinstance(self.set, (Zero, NonNegative, Box)):
            raise InputError(
                f"constraint '{self.name}', set: got {quoted(self.set)!r}; valid: wb.sets.Zero(), wb.sets.NonNegative(), "
                "wb.sets.Box(lower, upper)"
            )
        if not isinstance(self.penalty, (RelaxedBarrier, AugmentedLagrangian)):
            raise InputError(
                f"constraint '{self.name}', penalty: got {quoted(self.penalty)!r}; valid: wb.RelaxedBarrier(mu, delta), "
                "wb.AugmentedLagrangian(rho)"
            )
        if not 0.0 <= self.softness < np.inf:
            raise InputError(f"constraint '{self.name}': softness must not be negative, got {self.softness}")
        prices = np.asarray(self.slack, float)
        if prices.ndim and prices.shape != (self.residual.size,):
            raise InputError(
                f"constraint '{self.name}', slack: one number or {self.residual.size} are needed, got {prices.size}"
            )
        if not (prices > 0.0).all():
            raise InputError(f"constraint '{self.name}': slack must be positive (math.inf: none), got {self.slack}")
        if self.hard and isinstance(self.penalty, AugmentedLagrangian):
            raise InputError(f"constraint '{self.name}': hard=True and an AugmentedLagrangian exclude each other")

    @property
    def equality(self) -> bool:
        """Whether the residual has to vanish."""
        return isinstance(self.set, Zero)

    @property
    def slacks(self) -> np.ndarray:
        """``slack`` of every row."""
        return np.broadcast_to(np.asarray(self.slack, float), (self.residual.size,))


def expand_rows(value: Weight, residual: Residual, where: str) -> np.ndarray:
    """One non-negative number per row from a number, a sequence or a mapping by the residual's groups."""
    if not isinstance(value, Mapping):
        return _expand(value, residual.size, where)
    rows = np.zeros(residual.size)
    for group, entry in value.items():
        if group not in residual.groups:
            raise unknown_name("group", group, residual.groups, where=where)
        part = residual.groups[group]
        rows[part] = _expand(entry, part.stop - part.start, f"{where} of '{group}'")
    return rows


def _expand(value: float | Sequence[float], size: int, where: str) -> np.ndarray:
    """``size`` finite numbers that are not negative from one or ``size``."""
    array = real_numbers(where, value)
    if array.ndim and array.shape != (size,):
        raise InputError(f"{where}: one number or {size} are needed, got {array.size}")
    if not np.isfinite(array).all() or np.any(array < 0.0):
        bad = array[~(np.isfinite(array) & (array >= 0.0))].flat[0] if array.ndim else array
        raise InputError(f"{where}: must be finite and not negative, got {float(bad):g}")
    return np.broadcast_to(array, size).copy()

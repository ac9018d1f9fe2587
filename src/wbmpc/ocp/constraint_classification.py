"""Constraints sorted by how the solver treats their rows.

Four ways: rows of the Riccati recursion (state-input equalities), relaxed barriers on single variables (boxes), relaxed
barriers on expressions (part of the cost function), and rows with a state of their own: slack and multiplier.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import NamedTuple

import casadi as ca
import numpy as np

from wbmpc.errors import InputError
from wbmpc.ocp.norms import AugmentedLagrangian
from wbmpc.ocp.sets import Box, NonNegative
from wbmpc.ocp.symbols import FollowsLastInput
from wbmpc.ocp.terms import Constraint

#: Of the proximal multipliers of equality rows that cannot enter the Riccati recursion.
EQUALITY_RHO = 1e4
#: Where a row's gradient is evaluated, to find its magnitude.
POINTS = 5


class Kind(IntEnum):
    """How a row with a state of its own is treated."""

    HARD = 0  # h ≥ 0 by the interior point
    MULTIPLIER = 1  # h ≥ 0 by an augmented Lagrangian
    EQUAL = 2  # h = 0 by a proximal multiplier


class BoxRow(NamedTuple):
    """Relaxed barrier on h = sign z[variable] + offset ≥ 0, z = [x; u]."""

    variable: int
    sign: float
    offset: float
    mu: float
    delta: float


@dataclass(frozen=True)
class Row:
    """A row with a state of its own: h = sign z[variable] + offset of one variable, or (``variable`` −1) a general expression.

    ``penalty``: weight of the L1 slack (infinite: no slack) or ρ; ``unit``: size of one unit of h in the residual's own;
    ``state_only``: does not count at the measured state. ``from_now``: its bound follows the last command, as a cone that opens with the time
    from now does: at the next solve it is where it was, at the same node.
    """

    name: str
    kind: Kind
    variable: int
    sign: float
    offset: float
    penalty: float
    unit: float
    state_only: bool
    from_now: bool = False


@dataclass
class RowGroup:
    """The rows along the path, or at the end of the horizon: those of single variables first, then general ones."""

    barriers: list[BoxRow] = field(default_factory=list)
    general_barriers: list[tuple[Constraint, ca.SX]] = field(default_factory=list)
    boxes: list[Row] = field(default_factory=list)
    general: list[Row] = field(default_factory=list)
    expressions: list[ca.SX] = field(default_factory=list)
    #: (variable, slope, offset) with slope z + offset ≥ 0, from both sides, of rows that are equalities
    fixed: list[tuple[int, float, float]] = field(default_factory=list)

    @property
    def rows(self) -> list[Row]:
        return [*self.boxes, *self.general]

    def expression(self) -> ca.SX:
        """All general rows, (rows, 1)."""
        return ca.vertcat(*self.expressions) if self.expressions else ca.SX(0, 1)


class Equalities(NamedTuple):
    """Rows of the Riccati recursion."""

    expression: ca.SX
    softness: np.ndarray
    names: list[str]


def row_names(term: Constraint) -> list[str]:
    """A name for every row of a term's residual: term.group[i], or term.component where the residual names its rows."""
    own = getattr(term.residual, "row_names", None)
    if own is not None:
        return [f"{term.name}.{n}" for n in own]
    names = [term.name] * term.residual.size
    for group, part in term.residual.groups.items():
        for i, row in enumerate(range(part.start, part.stop)):
            names[row] = f"{term.name}.{group}[{i}]"
    return names


def missed(term: Constraint, r: ca.SX) -> ca.SX:
    """By how much every row of a term's residual ``r`` is below its set (negative) or above it; 0 inside."""
    if term.equality:
        return r
    n = r.shape[0]
    lower, upper = term.set.bounds(n) if isinstance(term.set, Box) else (np.zeros(n), np.full(n, np.inf))
    below = [ca.fmin(r[i] - bound, 0.0) if np.isfinite(bound) else ca.SX(0) for i, bound in enumerate(lower)]
    above = [ca.fmax(r[i] - bound, 0.0) if np.isfinite(bound) else ca.SX(0) for i, bound in enumerate(upper)]
    return ca.vertcat(*below) + ca.vertcat(*above)


def equality_rows(
    terms: Sequence[tuple[Constraint, ca.SX, ca.SX | float]],
    inequalities: Sequence[tuple[Constraint, ca.SX, ca.SX | float]], x: ca.SX, u: ca.SX, path: RowGroup, end: RowGroup,
) -> Equalities:  # fmt: skip
    """Sort the rows of equality terms, given as (term, residual, switch), and those that bounds of ``inequalities`` fix."""
    parts, softness, names = [], [], []
    z = ca.vertcat(x, u)
    fixed_rows = [_fixed_part(*t, x, u, path) for t in inequalities]
    for term, r, switch, row_name in [*((*t, row_names(t[0])) for t in terms), *fixed_rows]:
        with_input = depends(r, u)
        soft = isinstance(term.penalty, AugmentedLagrangian)
        rho = term.penalty.rho if isinstance(term.penalty, AugmentedLagrangian) else EQUALITY_RHO
        if term.at == "terminal" and with_input.any():
            raise InputError(f"constraint '{term.name}': at the end of the horizon there is no input to depend on")
        scales = row_scales(ca.jacobian(r, z))
        for i in range(r.shape[0]):
            row = switch * (r[i] if scales[i] == 1.0 else r[i] / scales[i])
            if term.at != "terminal" and with_input[i] and not soft:
                parts.append(row)
                softness.append(term.softness / scales[i] ** 2)
                names.append(row_name[i])
                continue
            # the ρ that a term gives is per squared unit of its residual
            per_unit = rho * scales[i] ** 2 if soft else rho
            own = Row(row_name[i], Kind.EQUAL, -1, 1.0, 0.0, per_unit, float(scales[i]), not with_input[i])
            if term.at != "terminal":
                path.general.append(own)
                path.expressions.append(row)
            if term.at != "path" and not with_input[i]:
                end.general.append(own)
                end.expressions.append(row)
    expression = ca.vertcat(*parts) if parts else ca.SX(0, 1)
    return Equalities(expression, np.array(softness, float), names)


#: Bounds that are nearer to each other [of the row's scale + their size] are one.
FIXED = 1e-7


class _Side(NamedTuple):
    """One side of an inequality: h = sign r[i] + offset ≥ 0."""

    i: int
    sign: float
    offset: float
    width: float  # of the allowed range, 1 where it is open
    name: str


def fixed(lower: np.ndarray, upper: np.ndarray, jacobian: ca.SX) -> np.ndarray:
    """Where both bounds are one, of rows with a ``jacobian`` by state and input: in tiny units bounds are always near each other."""

    def near(scale: np.ndarray | float) -> np.ndarray:
        with np.errstate(invalid="ignore"):
            return np.asarray(np.isfinite(upper - lower) & (upper - lower <= FIXED * (scale + np.abs(lower))))

    found = near(1.0)
    return found & near(row_scales(jacobian)) if found.any() else found


def _sides(term: Constraint, jacobian: ca.SX) -> list[_Side]:
    names, rows = row_names(term), jacobian.shape[0]
    if isinstance(term.set, NonNegative):
        return [_Side(i, 1.0, 0.0, 1.0, names[i]) for i in range(rows)]
    assert isinstance(term.set, Box)
    lower, upper = term.set.bounds(rows)
    # bounds that are equal but for rounding would be rows in a unit of rounding: the residual is fixed between them
    held = fixed(lower, upper, jacobian)
    middle = 0.5 * (np.where(held, lower, 0.0) + np.where(held, upper, 0.0))
    width = np.where(np.isfinite(upper - lower) & ~held, upper - lower, 1.0)
    lower, upper = np.where(held, middle, lower), np.where(held, middle, upper)
    low = [
        _Side(int(i), 1.0, -float(lower[i]), float(width[i]), f"{names[i]} >= {lower[i]:g}")
        for i in np.flatnonzero(np.isfinite(lower))
    ]
    high = [
        _Side(int(i), -1.0, float(upper[i]), float(width[i]), f"{names[i]} <= {upper[i]:g}")
        for i in np.flatnonzero(np.isfinite(upper))
    ]
    return low + high


def _becomes_equality(term: Constraint, r: ca.SX, x: ca.SX, u: ca.SX) -> np.ndarray:
    """For every row, whether it is hard, without slack, and fixed by its bounds: a barrier has no room between them."""
    held = np.zeros(r.shape[0], bool)
    if term.hard and isinstance(term.set, Box):
        held = fixed(*term.set.bounds(r.shape[0]), ca.jacobian(r, ca.vertcat(x, u)))
    if not held.any() or np.isinf(term.slacks).all():
        return held
    return np.asarray(held & (np.isinf(term.slacks) | (depends(r, u) & ~depends(r, x))))


def _fixed_part(
    term: Constraint, r: ca.SX, switch: ca.SX | float, x: ca.SX, u: ca.SX, path: RowGroup
) -> tuple[Constraint, ca.SX, ca.SX | float, list[str]]:
    """The rows of an inequality that are equalities: (term, residual minus its value, switch, names)."""
    chosen = np.flatnonzero(_becomes_equality(term, r, x, u))
    if not chosen.size:
        return term, ca.SX(0, 1), switch, []
    assert isinstance(term.set, Box)
    value, names = 0.5 * np.sum(term.set.bounds(r.shape[0]), axis=0), row_names(term)
    part = ca.vertcat(*[r[int(i)] - value[i] for i in chosen])
    selection = None if term.modes is not None else single_variables(part, ca.vertcat(x, u))
    for index, scale, shift in selection or []:
        path.fixed += [(index, scale, shift), (index, -scale, -shift)]
    return term, part, switch, [names[i] for i in chosen]


def inequality_rows(
    terms: Sequence[tuple[Constraint, ca.SX, ca.SX | float]], x: ca.SX, u: ca.SX, path: RowGroup, end: RowGroup
) -> None:
    """Sort the rows of inequality terms, given as (term, residual, switch)."""
    z = ca.vertcat(x, u)
    for term, r, switch in terms:
        jacobian = ca.jacobian(r, z)
        sides = _sides(term, jacobian)
        selection = None if term.modes is not None else single_variables(r, z, jacobian)
        with_state, with_input = (
            _rows_in(jacobian.sparsity(), part) for part in (slice(x.shape[0]), slice(x.shape[0], None))
        )
        taken = _becomes_equality(term, r, x, u)
        sides = [s for s in sides if not taken[s.i]]
        if term.at == "terminal" and with_input.any():
            raise InputError(f"constraint '{term.name}': at the end of the horizon there is no input to depend on")
        groups = [(path, term.at != "terminal", sides)]
        groups.append((end, term.at != "path", [s for s in sides if not with_input[s.i]]))
        for group, applies, chosen in groups:
            if not applies or not chosen:
                continue
            if term.hard or isinstance(term.penalty, AugmentedLagrangian):
                _own_rows(term, r, switch, chosen, selection, with_input, with_state, group, jacobian)
            else:
                _barriers(term, r, chosen, selection, group)
    for group in (path, end):
        group.barriers.sort(key=lambda b: (b.mu, b.variable))
        group.boxes.sort(key=lambda b: b.variable)


def _barriers(
    term: Constraint, r: ca.SX, sides: list[_Side], selection: list[tuple[int, float, float]] | None, group: RowGroup
) -> None:
    assert not isinstance(term.penalty, AugmentedLagrangian)
    if selection is None:
        group.general_barriers.append((term, ca.vertcat(*[s.sign * r[s.i] + s.offset for s in sides])))
        return
    for s in sides:
        index, scale, shift = selection[s.i]
        penalty = term.penalty
        box = BoxRow(index, s.sign * scale, s.offset + s.sign * shift, penalty.mu, penalty.delta)
        group.barriers.append(box)


def _own_rows(
    term: Constraint, r: ca.SX, switch: ca.SX | float, sides: list[_Side],
    selection: list[tuple[int, float, float]] | None, with_input: np.ndarray, with_state: np.ndarray, group: RowGroup,
    jacobian: ca.SX,
) -> None:  # fmt: skip
    multiplier = isinstance(term.penalty, AugmentedLagrangian)
    held = not isinstance(term.residual, FollowsLastInput)
    kind = Kind.MULTIPLIER if multiplier else Kind.HARD
    widths = _paired_widths(sides, selection)
    scales = row_scales(jacobian) if multiplier or 1.0 in widths else None
    for s, span in zip(sides, widths, strict=True):
        # hard rows in units of their range; without one, and with multipliers, of the variables
        width = span if scales is None or not (multiplier or span == 1.0) else float(scales[s.i])
        # rows of inputs alone can always be held, but for those that move with the last command
        slack = np.inf if held and with_input[s.i] and not with_state[s.i] else float(term.slacks[s.i]) * width / span
        penalty = term.penalty.rho * width**2 if isinstance(term.penalty, AugmentedLagrangian) else slack
        if selection is not None:
            index, scale, shift = selection[s.i]
            sign, offset = s.sign * scale / width, (s.offset + s.sign * shift) / width
            group.boxes.append(Row(s.name, kind, index, sign, offset, penalty, width, not with_input[s.i], not held))
        else:
            # a term that does not count in the present mode is h = 1: far inside
            h = switch * ((s.sign * r[s.i] + s.offset) / width) + (1.0 - switch)
            group.general.append(Row(s.name, kind, -1, 1.0, 0.0, penalty, width, not with_input[s.i], not held))
            group.expressions.append(ca.SX(h))


def _paired_widths(sides: list[_Side], selection: list[tuple[int, float, float]] | None) -> list[float]:
    """Widths of the ranges; rows of a NonNegative set that bound one variable from both sides make a range too."""
    if selection is None:
        return [s.width for s in sides]
    bounds: dict[tuple[int, bool], float] = {}
    for s in sides:
        index, scale, shift = selection[s.i]
        bounds[index, s.sign * scale > 0.0] = (s.offset + s.sign * shift) / abs(scale)
    out = []
    for s in sides:
        index, scale, _ = selection[s.i]
        pair = [bounds.get((index, side)) for side in (True, False)]
        total = sum(p for p in pair if p is not None) if None not in pair else 0.0
        out.append(total * abs(scale) if total > 0.0 else s.width)
    return out


def depends(r: ca.SX, u: ca.SX) -> np.ndarray:
    """For every row, whether it depends on the input."""
    return _rows_in(ca.jacobian_sparsity(r, u), slice(None))


def _rows_in(jacobian: ca.Sparsity, columns: slice) -> np.ndarray:
    """For every row, whether it has an entry in some columns."""
    found = np.zeros(jacobian.shape, bool)
    found[tuple(np.array(jacobian.get_triplet(), int))] = True
    return np.asarray(found[:, columns].any(axis=1))


def row_scales(jacobian: ca.SX) -> np.ndarray:
    """For every row of a Jacobian by state and input its length, where that is far from 1 everywhere (a thousandth, a thousand); else 1.

    Rows in unlucky units (mm², GPa) are divided by it: every tolerance of the solver is absolute. A gradient that is not constant
    is evaluated at a few points, and counts with its power of ten.
    """
    lengths = _gradient_lengths(jacobian)
    with np.errstate(divide="ignore", invalid="ignore"):
        orders = np.log10(lengths)
        tiny, huge = (orders < -3.0).all(axis=1), (orders > 3.0).all(axis=1)
        middle = 10.0 ** np.round(orders.mean(axis=1))
    constant = np.ptp(lengths, axis=1) == 0.0
    found = np.where(constant, lengths[:, 0], middle)
    return np.where((tiny | huge) & np.isfinite(found) & (found > 0.0), found, 1.0)


def _gradient_lengths(jacobian: ca.SX) -> np.ndarray:
    """Length of every row at POINTS fixed points, (rows, POINTS); NaN where it is not defined."""
    symbols = ca.symvar(jacobian)
    if not symbols:
        return np.tile(np.linalg.norm(np.array(ca.DM(ca.densify(jacobian))), axis=1)[:, None], POINTS)
    points = np.random.default_rng(0).normal(size=(len(symbols), POINTS))
    square = ca.sum2(jacobian**2)
    return np.sqrt(np.array(ca.Function("square", [ca.vertcat(*symbols)], [ca.densify(square)])(points)))


def nonlinear_in_inputs(group: RowGroup, u: ca.SX) -> bool:
    """Whether a hard row has second derivatives by the inputs: its linearization does not say where it ends. (Slopes that move with the
    state, as those of distances that limit speeds, are the next linearization's matter, as those of any row of the state.)"""
    hard = [e for e, row in zip(group.expressions, group.general, strict=True) if row.kind is Kind.HARD]
    if not hard or not u.shape[0]:
        return False
    slopes = ca.jacobian(ca.vertcat(*hard), u)
    return bool(ca.jacobian(ca.vec(slopes), u).nnz())


def nonlinear_equalities(equality: ca.SX, group: RowGroup, u: ca.SX) -> bool:
    """Whether an equality, or a row with a multiplier, has second derivatives by the inputs."""
    own = [e for e, row in zip(group.expressions, group.general, strict=True) if row.kind is not Kind.HARD]
    slopes = ca.jacobian(ca.vertcat(equality, *own), u)
    return bool(ca.jacobian(ca.vec(slopes), u).nnz())


def single_variables(r: ca.SX, z: ca.SX, jacobian: ca.SX | None = None) -> list[tuple[int, float, float]] | None:
    """(index, scale, offset) of every row if each is an affine function of one state or input, else None; ``jacobian``: of r by z, where
    there is one already."""
    jacobian = ca.jacobian(r, z) if jacobian is None else jacobian
    if ca.symvar(jacobian):
        return None
    dense = np.array(ca.DM(ca.densify(jacobian)))
    if np.any((dense != 0.0).sum(axis=1) != 1):
        return None
    offset = ca.substitute(r, z, ca.DM.zeros(z.shape[0]))
    if ca.symvar(offset):
        return None
    shift = np.array(ca.DM(ca.densify(offset))).ravel()
    index = np.argmax(dense != 0.0, axis=1)
    return [(int(i), float(dense[k, i]), float(shift[k])) for k, i in enumerate(index)]

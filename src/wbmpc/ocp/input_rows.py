"""What hard rows give the inputs alone, whatever the state: for policies, which hold their feedback to it."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import casadi as ca
import numpy as np

from wbmpc.ocp.constraint_classification import Kind, single_variables

if TYPE_CHECKING:
    from wbmpc.ocp.transcription import Transcription


def input_bounds(t: Transcription) -> tuple[np.ndarray, np.ndarray]:
    """(lower, upper) (nu): what hard rows of one input alone allow it in all modes; infinite where there is none."""
    group, nx, z = t.path, t.nx, t.z
    hard = [(r.variable, r.sign, r.offset) for r in group.boxes if r.kind is Kind.HARD] + group.fixed
    for expression, row in zip(group.expressions, group.general, strict=True):
        if row.kind is Kind.HARD and not ca.depends_on(expression, t.x):
            hard += single_variables(expression, z) or []
    lower, upper = np.full(t.nu, -np.inf), np.full(t.nu, np.inf)
    for index, slope, offset in hard:  # slope z + offset ≥ 0
        i, bound = index - nx, -offset / slope
        if i >= 0 and slope > 0.0:
            lower[i] = max(lower[i], bound)
        elif i >= 0:
            upper[i] = min(upper[i], bound)
    return lower, upper


class InputPlanes(NamedTuple):
    """Hard rows of inputs alone that are no bounds of single inputs for good, in units of their ranges.

    ``matrix`` u + ``offset`` + ``by_node`` p + ``by_constant`` w ≥ 0, (r, nu), (r,), (r, np) and (r, nw), with the parameters p of
    the node (references, mode values) and w of the whole horizon. ``switches`` (r,): which term's switch turns each of them on, −1
    for always.
    """

    matrix: np.ndarray
    offset: np.ndarray
    by_node: np.ndarray
    by_constant: np.ndarray
    switches: np.ndarray

    @property
    def move(self) -> bool:
        """Whether offsets depend on references, mode values or parameters."""
        return bool(self.by_node.any() or self.by_constant.any())


def input_planes(t: Transcription) -> InputPlanes:
    """Hard rows of inputs alone beyond :func:`input_bounds`, of several inputs, and of single ones in some modes only or around a reference:
    those that are linear in the inputs and in the parameters p and w, and depend on nothing else but one switch."""
    every, switches = ca.vertcat(t.u, t.p, t.w), t.switches
    ends = np.cumsum([t.nu, t.node.size, t.constant.size])
    found: list[tuple[np.ndarray, float, int]] = []
    for h, row in zip(t.path.expressions, t.path.general, strict=True):
        if row.kind is not Kind.HARD or row.state_only or ca.depends_on(h, t.x):
            continue
        own, straight = _in_its_mode(h, every, switches)
        if straight is None:
            continue
        slope, offset = straight
        if own or slope[ends[0] :].any() or (slope[: ends[0]] != 0.0).sum() > 1:
            found.append((slope, offset, own[0] if own else -1))
    slopes = np.array([f[0] for f in found]).reshape(-1, ends[-1])
    matrix, by_node, by_constant = np.split(slopes, ends[:-1], axis=1)
    offsets, switched = np.array([f[1] for f in found]), np.array([f[2] for f in found], int)
    return InputPlanes(matrix, offsets, by_node, by_constant, switched)


def nonlinear_rows(t: Transcription) -> list[str]:
    """Names of the hard rows that depend on inputs and not on states, and are not among :func:`input_planes`, since they are
    not linear in the inputs or in what moves them: nothing says by numbers alone how far an input may go."""
    every, switches, found = ca.vertcat(t.u, t.p, t.w), t.switches, []
    for h, row in zip(t.path.expressions, t.path.general, strict=True):
        alone = row.kind is Kind.HARD and not row.state_only and not ca.depends_on(h, t.x)
        if alone and _in_its_mode(h, every, switches)[1] is None:
            found.append(row.name)
    return found


def _in_its_mode(h: ca.SX, every: ca.SX, switches: list[ca.SX]) -> tuple[list[int], tuple[np.ndarray, float] | None]:
    """Which of the ``switches`` a row depends on, and its (slope, offset) where it counts; None: see :func:`_straight`."""
    own = [i for i, switch in enumerate(switches) if ca.depends_on(h, switch)]
    on = ca.substitute(h, switches[own[0]], ca.SX(1)) if len(own) == 1 else h
    return own, _straight(on, every) if len(own) < 2 else None


def _straight(h: ca.SX, z: ca.SX) -> tuple[np.ndarray, float] | None:
    """(slope, offset) of a row h = slope z + offset; None if it is nonlinear, or depends on anything else."""
    slope = ca.simplify(ca.jacobian(h, z))
    offset = ca.substitute(h, z, ca.DM.zeros(z.shape[0]))
    if ca.symvar(slope) or ca.symvar(offset):
        return None
    return np.array(ca.DM(ca.densify(slope))).ravel(), float(ca.DM(offset))

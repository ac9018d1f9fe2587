"""Costs of a transcription along the path and at the end of the horizon, and their parts."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import casadi as ca

from wbmpc.errors import InputError
from wbmpc.ocp.norms import RelaxedBarrier
from wbmpc.ocp.terms import Constraint, Cost

if TYPE_CHECKING:
    from wbmpc.ocp.transcription import Transcription


def _weight(t: Transcription, cost: Cost, stage: str) -> ca.SX:
    """The cost's weights at ``stage``, 0 in modes where it does not count."""
    return t.w[t.constant.slices[f"{stage}.{cost.name}"]] * t.switch(cost.name)


def term_values(t: Transcription, stage: str) -> dict[str, ca.SX]:
    """The weighted value of every cost, and the residual of every constraint, at ``stage`` (path or terminal)."""
    at = (stage, "path+terminal")
    out = {c.name: t.residual(c) for c in t.ocp.terms.values() if isinstance(c, Constraint) and c.at in at}
    for cost in t.ocp.costs:
        if cost.at in at:
            out[cost.name] = _weight(t, cost, stage) * cost.norm.value(t.residual(cost))
    return out


def cost_parts(t: Transcription, stage: str) -> list[tuple[ca.SX, ca.SX, ca.SX, ca.SX]]:
    """(residual, value, gradient by the residual, curvature) of every cost and general barrier at ``stage``."""
    out = []
    for cost in t.ocp.costs:
        if cost.at not in (stage, "path+terminal"):
            continue
        weight, r, norm = _weight(t, cost, stage), t.residual(cost), cost.norm
        if stage == "terminal" and ca.depends_on(r, t.u):
            raise InputError(
                f"cost '{cost.name}', at: its residual depends on the input, which ends before the horizon does; valid: path"
            )
        out.append((r, weight * norm.value(r), weight * norm.gradient(r), weight * norm.curvature(r)))
    for term, h in (t.path if stage == "path" else t.end).general_barriers:
        switch, b = t.switch(term.name), cast(RelaxedBarrier, term.penalty)
        out.append((h, switch * b.value(h), switch * b.gradient(h), switch * b.curvature(h)))
    return out


def stage_cost(t: Transcription, stage: str) -> ca.SX:
    """The cost at ``stage``, with general barriers."""
    return sum((ca.sum1(v) for _, v, _, _ in cost_parts(t, stage)), ca.SX(0))

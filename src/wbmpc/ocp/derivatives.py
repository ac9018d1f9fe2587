"""Derivatives of a transcription's stage functions: Gauss-Newton Hessians, Jacobians, and what exact Hessians have beyond them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import casadi as ca

from wbmpc.ocp.stage_costs import cost_parts, stage_cost

if TYPE_CHECKING:
    from wbmpc.ocp.transcription import Transcription


def _function(name: str, inputs: list[ca.SX], outputs: Sequence[ca.SX | ca.DM]) -> ca.Function:
    """A function with common parts computed once."""
    return ca.Function(name, inputs, [ca.SX(e) for e in ca.cse(outputs)])


def stage_derivatives(t: Transcription) -> dict[str, ca.Function]:
    """Functions with derivatives. Path costs come multiplied by the interval h [s]."""
    args, at_end = [t.x, t.u, t.p, t.w], [t.x, t.p, t.w]
    f, jacobian = t.linearized
    value, gradient, hessian = _quadratic(t, "path", t.z)
    end = _quadratic(t, "terminal", t.x)
    with_jacobian = lambda e, z: [ca.densify(e), ca.jacobian(e, z)]
    h = t.h
    return {
        "dynamics_jacobian": _function("dynamics_jacobian", args, [ca.densify(f), jacobian]),
        "cost_quadratic": _function("cost_quadratic", [*args, h], [h * value, h * gradient, h * hessian]),
        "equality_jacobian": _function("equality_jacobian", args, with_jacobian(t.equality, t.z)),
        "rows_jacobian": _function("rows_jacobian", args, with_jacobian(t.path.expression(), t.z)),
        "terminal_quadratic": _function("terminal_quadratic", at_end, list(end)),
        "end_rows_jacobian": _function("end_rows_jacobian", at_end, with_jacobian(t.end.expression(), t.x)),
        "jump_jacobian": _function("jump_jacobian", at_end, with_jacobian(t.jump, t.x)),
        **_second_derivatives(t),
    }


def _quadratic(t: Transcription, stage: str, z: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Value, gradient and Gauss-Newton Hessian (upper triangle with a full diagonal) by z."""
    n = z.shape[0]
    value, gradient, hessian = ca.SX(0), ca.SX(n, 1), ca.SX(n, n)
    for r, v, g, c in cost_parts(t, stage):
        jacobian = ca.jacobian(r, z)
        value += ca.sum1(v)
        gradient += jacobian.T @ g
        hessian += jacobian.T @ (ca.repmat(c, 1, n) * jacobian)
    structural = ca.SX(ca.Sparsity.diag(n), ca.SX.zeros(n))
    return value, ca.densify(gradient), ca.triu(hessian) + structural


def _second_derivatives(t: Transcription) -> dict[str, ca.Function]:
    """What the exact Hessian of the Lagrangian has and the Gauss-Newton one has not.

    Without ``exact``: νᵀ equalities + h κᵀ rows by the inputs alone, where they are nonlinear in them, else nothing.
    """
    if t.exact:
        return exact_derivatives(t)
    args, at_end = [t.x, t.u, t.p, t.w, t.h], [t.x, t.p, t.w]
    nu, kappa, last, adjoint = _multipliers(t)
    nothing = [ca.SX(1, 1)]
    return {
        "lagrangian": _function("lagrangian", [*args, nu, kappa], _curvature(t, nu, kappa) or nothing),
        "dynamics_hessian": _function("dynamics_hessian", [*args, adjoint], nothing),
        "end_lagrangian": _function("end_lagrangian", [*at_end, last], nothing),
    }


def _multipliers(t: Transcription) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
    """ν of equalities, κ of the rows along the path and at the end, a of the dynamics."""
    path, end = t.path.expression().shape[0], t.end.expression().shape[0]
    sizes = {"nu": t.equality.shape[0], "kappa": path, "last": end, "a": t.nx}
    nu, kappa, last, adjoint = (ca.SX.sym(name, size) for name, size in sizes.items())
    return nu, kappa, last, adjoint


def exact_derivatives(t: Transcription) -> dict[str, ca.Function]:
    """``lagrangian`` (…, h, ν, κ): second derivatives of h cost + νᵀ equalities + h κᵀ rows that the Gauss-Newton Hessian has
    not; ``end_lagrangian`` the same at the end; ``dynamics_hessian`` (…, h, a): of aᵀ f."""
    args, at_end = [t.x, t.u, t.p, t.w, t.h], [t.x, t.p, t.w]
    nu, kappa, last, adjoint = _multipliers(t)
    path = t.h * (stage_cost(t, "path") + ca.dot(kappa, t.path.expression())) + ca.dot(nu, t.equality)
    end = stage_cost(t, "terminal") + ca.dot(last, t.end.expression())
    more = lambda f, z, gauss_newton: ca.triu(ca.hessian(f, z)[0]) - gauss_newton
    path_more = more(path, t.z, t.h * _quadratic(t, "path", t.z)[2])
    end_more = more(end, t.x, _quadratic(t, "terminal", t.x)[2])
    curvature = ca.triu(ca.hessian(ca.dot(adjoint, t.rates), t.z)[0])
    return {
        "lagrangian": _function("lagrangian", [*args, nu, kappa], [path_more]),
        "dynamics_hessian": _function("dynamics_hessian", [*args, adjoint], [curvature]),
        "end_lagrangian": _function("end_lagrangian", [*at_end, last], [end_more]),
    }


def _curvature(t: Transcription, nu: ca.SX, kappa: ca.SX) -> list[ca.SX]:
    """[Hessian of νᵀ equalities + h κᵀ rows by the inputs, upper triangle in the size of z]; empty where all are linear in them."""
    if not t.second:
        return []
    rows = t.h * ca.dot(kappa, t.path.expression()) + ca.dot(nu, t.equality)
    second = ca.triu(ca.hessian(rows, t.u)[0])
    return [ca.diagcat(ca.SX(t.nx, t.nx), second)]

"""The same discretized problem for IPOPT: what the solutions are compared with."""

from __future__ import annotations

import casadi as ca
import numpy as np

from wbmpc.ocp import RelaxedBarrier
from wbmpc.ocp.constraint_classification import Kind, RowGroup
from wbmpc.solver import Solver


def _boxes(rows: list, size: int) -> ca.Function:
    z = ca.SX.sym("z", size)
    terms = [RelaxedBarrier(mu, delta).value(s * z[i] + c) for i, s, c, mu, delta in rows]
    return ca.Function("boxes", [z], [sum(terms, ca.SX(0))])


def _step(solver: Solver, x: ca.SX, u: ca.SX, p: ca.SX | np.ndarray, h: ca.SX | float) -> ca.SX:
    """The integrator rewritten."""
    f = lambda x: solver.problem.values["dynamics"](x, u, p, solver.ws.w)
    if solver.ocp.integrator == "rk2":
        end = x + h * f(x + 0.5 * h * f(x))
    else:
        k1 = f(x)
        k2 = f(x + 0.5 * h * k1)
        k3 = f(x + 0.5 * h * k2)
        end = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + f(x + h * k3))
    for q in solver.ocp.dynamics.unit_quaternions:
        end[q : q + 4] = end[q : q + 4] / ca.norm_2(end[q : q + 4])
    return end


def _stage(solver: Solver) -> ca.Function:
    """Of x, u, p and h at one node: what it costs, the next state, equalities and general rows. One function for all nodes, so
    that it is differentiated once."""
    t, w = solver.problem, solver.ws.w
    x, u, h = ca.SX.sym("x", t.nx), ca.SX.sym("u", t.nu), ca.SX.sym("h")
    p = ca.SX.sym("p", solver.ws.p.shape[1])
    path = _boxes(t.path.barriers, t.nx + t.nu)(ca.vertcat(x, u))
    rows = [t.values[name](x, u, p, w) for name in ("equality", "rows")]
    return ca.Function(
        "stage", [x, u, p, h], [h * (t.values["cost"](x, u, p, w) + path), _step(solver, x, u, p, h), *rows]
    )


def _own_rows(group: RowGroup, z: ca.SX, general: ca.SX, first: bool) -> tuple[list[ca.SX], list[float]]:
    """Hard rows h >= 0 and equality rows h = 0 at one node, with their upper bounds (infinite, 0)."""
    values = [r.sign * z[r.variable] + r.offset for r in group.boxes] + ca.vertsplit(general)
    kept = [(v, r) for v, r in zip(values, group.rows, strict=True) if not (first and r.state_only)]
    return [v for v, _ in kept], [0.0 if r.kind == Kind.EQUAL else np.inf for _, r in kept]


def solve(solver: Solver, x0: np.ndarray, plugin: str = "ipopt") -> tuple[np.ndarray, np.ndarray, float]:
    """Optimal x (N + 1, nx), u (N, nu) and cost, from the solver's present trajectories and parameters.

    ``plugin``: "ipopt" or "fatrop" (which gets the program stage by stage). Hard rows are inequalities without slack: both
    fail where they cannot be met.
    """
    t = solver.problem
    n, nx, nu, p, w = t.ocp.intervals, t.nx, t.nu, solver.ws.p, solver.ws.w
    end, stage = _boxes(t.end.barriers, nx + nu), _stage(solver)
    x, u = [ca.MX.sym("x", nx) for _ in range(n + 1)], [ca.MX.sym("u", nu) for _ in range(n)]
    cost = t.values["terminal"](x[n], p[n], w) + end(ca.vertcat(x[n], ca.MX(nu, 1)))
    rows: list[ca.MX] = []
    upper: list[np.ndarray] = []
    for k, h in enumerate(np.diff(t.ocp.grid)):
        added, following, equalities, general = stage(x[k], u[k], p[k], h)
        cost += added
        rows += [x[k + 1] - following, *([x[0] - x0] if k == 0 else []), equalities]
        upper.append(np.zeros(nx + (nx if k == 0 else 0) + t.equality.shape[0]))
        own, bounds = _own_rows(t.path, ca.vertcat(x[k], u[k]), general, k == 0)
        rows += own
        upper.append(np.array(bounds))
    own, bounds = _own_rows(t.end, x[n], t.values["end_rows"](x[n], p[n], w), False)
    rows, upper = [*rows, *own], [*upper, np.array(bounds)]
    stages = [v for k in range(n) for v in (x[k], u[k])]
    problem = {"x": ca.vertcat(*stages, x[n]), "f": cost, "g": ca.vertcat(*rows)}
    above = np.concatenate(upper)
    guess = np.concatenate([np.hstack([solver.ws.x[:-1], solver.ws.u]).ravel(), solver.ws.x[-1]])
    options: dict = {"print_time": 0}
    if plugin == "fatrop":
        options |= {"structure_detection": "auto", "equality": list(above == 0.0)}
        options |= {"fatrop.print_level": 0, "fatrop.tolerance": 1e-9, "fatrop.max_iter": 500}
    else:
        options |= {"ipopt.tol": 1e-11, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.max_iter": 300}
        options |= {"ipopt.bound_relax_factor": 0.0}
        # its last barrier parameter: by default the larger bias of the two
        options |= {"ipopt.mu_min": 1e-15, "ipopt.compl_inf_tol": 1e-13}
    other = ca.nlpsol("s", plugin, problem, options)
    found = other(x0=guess, lbg=0, ubg=above)
    assert other.stats()["success"], other.stats()["return_status"]
    z = np.array(found["x"]).ravel()
    table = z[: n * (nx + nu)].reshape(n, nx + nu)
    return np.vstack([table[:, :nx], z[n * (nx + nu) :]]), table[:, nx:], float(found["f"])

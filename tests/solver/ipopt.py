"""The same discretised problem for IPOPT: what the solutions are compared with."""

from __future__ import annotations

import casadi as ca
import numpy as np

from wbmpc.ocp import RelaxedBarrier
from wbmpc.ocp.rows import Kind, Place
from wbmpc.solver import Solver


def _boxes(rows: list, size: int) -> ca.Function:
    z = ca.SX.sym("z", size)
    terms = [RelaxedBarrier(mu, delta).value(s * z[i] + c) for i, s, c, mu, delta in rows]
    return ca.Function("boxes", [z], [sum(terms, ca.SX(0))])


def _step(solver: Solver, x: ca.SX, u: ca.SX, p: np.ndarray, h: float) -> ca.SX:
    """The integrator written anew."""
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


def _own_rows(place: Place, z: ca.SX, general: ca.SX, first: bool) -> tuple[list[ca.SX], list[float]]:
    """Hard rows h >= 0 and equality rows h = 0 at one node, with their upper bounds (infinite, 0)."""
    values = [r.sign * z[r.place] + r.offset for r in place.boxes] + ca.vertsplit(general)
    kept = [(v, r) for v, r in zip(values, place.rows, strict=True) if not (first and r.state_only)]
    return [v for v, _ in kept], [0.0 if r.kind == Kind.EQUAL else np.inf for _, r in kept]


def solve(solver: Solver, x0: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Optimal x (N + 1, nx), u (N, nu) and cost, from the solver's present trajectories and parameters.

    Hard rows are inequalities without slack: IPOPT fails where they cannot be met.
    """
    t = solver.problem
    n, nx, nu, p, w = t.ocp.intervals, t.nx, t.nu, solver.ws.p, solver.ws.w
    path, end = _boxes(t.path_boxes, nx + nu), _boxes(t.terminal_boxes, nx + nu)
    x, u = [ca.SX.sym("x", nx) for _ in range(n + 1)], [ca.SX.sym("u", nu) for _ in range(n)]
    cost = t.values["terminal"](x[n], p[n], w) + end(ca.vertcat(x[n], ca.SX(nu, 1)))
    rows, upper = [x[0] - x0], [np.zeros(nx)]
    for k, h in enumerate(np.diff(t.ocp.grid)):
        cost += h * (t.values["cost"](x[k], u[k], p[k], w) + path(ca.vertcat(x[k], u[k])))
        rows += [_step(solver, x[k], u[k], p[k], h) - x[k + 1], t.values["equality"](x[k], u[k], p[k], w)]
        upper.append(np.zeros(nx + t.equality.shape[0]))
        general = t.values["rows"](x[k], u[k], p[k], w)
        own, bounds = _own_rows(t.path, ca.vertcat(x[k], u[k]), general, k == 0)
        rows += own
        upper.append(np.array(bounds))
    own, bounds = _own_rows(t.end, x[n], t.values["end_rows"](x[n], p[n], w), False)
    rows, upper = [*rows, *own], [*upper, np.array(bounds)]
    problem = {"x": ca.vertcat(*x, *u), "f": cost, "g": ca.vertcat(*rows)}
    options = {"ipopt.tol": 1e-10, "ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": 0, "ipopt.max_iter": 300}
    ipopt = ca.nlpsol("s", "ipopt", problem, {**options, "ipopt.bound_relax_factor": 0.0})
    guess = np.concatenate([solver.ws.x.ravel(), solver.ws.u.ravel()])
    found = ipopt(x0=guess, lbg=0, ubg=np.concatenate(upper))
    assert ipopt.stats()["return_status"] in ("Solve_Succeeded", "Solved_To_Acceptable_Level")
    z, size = np.array(found["x"]).ravel(), (n + 1) * nx
    return z[:size].reshape(n + 1, nx), z[size:].reshape(n, nu), float(found["f"])

"""What rows that miss their bounds would do along a direction. Truth: NumPy, with the derivatives of the rows by hand."""

from __future__ import annotations

import casadi as ca
import numpy as np

from toys import Rows, ToyDynamics
from wbmpc.ocp import Constraint, Cost, OptimalControlProblem
from wbmpc.solver import Solver, infeasibility, riccati
from wbmpc.solver import memory_layout as places


def test_every_node_has_its_own_derivatives() -> None:
    """A point on a curve whose slope differs from node to node, for 20 nodes, which are two and a half blocks of eight."""
    r, n = np.random.default_rng(3), 20
    ocp = OptimalControlProblem(ToyDynamics(2, 2, lambda x, u, w, m: u), 2.0, n)
    ocp.add(Cost("state", Rows(2, lambda s: s.x), 1.0, at="path+terminal"))
    ocp.add(Cost("input", Rows(2, lambda s: s.u), 1.0))
    ocp.add(Constraint("curve", Rows(1, lambda s: ca.sumsqr(s.x) - 1.0), at="path+terminal"))
    solver = Solver(ocp, use_cache=False)
    x, v = r.normal(size=(n + 1, 2)), r.normal(size=(n, 2))
    solver.warm_start(x, r.normal(size=(n, 2)))
    ws = solver.ws
    riccati.backward(ws.memory, ws.table, True)
    ws.k[:], ws.u_trial[:] = 0.0, v
    changes = ws.table[places.ROW_D]
    ws.memory[changes : changes + (n + 1) * ws.table[places.ROWS]] = 0.0
    found = infeasibility.squared_lengths(ws.memory, ws.table)
    weight = np.append(np.diff(ws.grid), 1.0)
    weight[0] = 0.0  # rows of the state alone do not count at the measured one
    moved = np.vstack([np.zeros(2), np.cumsum(v * np.diff(ws.grid)[:, None], axis=0)])
    rows, change = np.sum(x**2, axis=1) - 1.0, np.sum(2.0 * x * moved, axis=1)
    np.testing.assert_allclose(found, [weight @ rows**2, weight @ change**2], rtol=1e-9)

"""A trolley with a pendulum goes to a place that changes, its acceleration limited. Exported for ``loop.cpp``."""

import casadi as ca
import numpy as np

import wbmpc as wb

LIMIT = 3.0


def crane(x, u):
    """x: position [m], angle [rad], their rates; u: the trolley's acceleration [m/s²]."""
    return ca.vertcat(x[2], x[3], u[0], -(9.81 * ca.sin(x[1]) + u[0] * ca.cos(x[1])))


def make_mpc() -> wb.MPC:
    dynamics = wb.Ode({"x": ["position", "angle", "speed", "rate"]}, {"u": ["acceleration"]}, crane)
    ocp = wb.OptimalControlProblem(dynamics, horizon=3.0, intervals=30)
    ocp.add(wb.Cost("state", wb.residuals.State(dynamics), [10.0, 5.0, 1.0, 1.0], at="path+terminal"))
    effort = wb.residuals.Expression(1, lambda s: s.u)
    ocp.add(wb.Cost("effort", effort, 0.1))
    ocp.add(wb.Constraint("limit", effort, wb.sets.Box(-LIMIT, LIMIT), hard=True))
    mpc = wb.MPC(ocp, rate=50.0)
    mpc.reference["state"] = wb.Reference.constant(np.array([1.0, 0.0, 0.0, 0.0]))
    mpc.reset(np.zeros(4))
    return mpc

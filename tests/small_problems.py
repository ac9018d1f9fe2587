"""Textbook problems: double integrator with a limited input, cart-pole swing-up."""

from __future__ import annotations

import casadi as ca
import numpy as np

from wbmpc.benchmark.problems import SampleProblem
from wbmpc.constants import GRAVITY
from wbmpc.model.ode import Ode
from wbmpc.ocp import Constraint, Cost, OptimalControlProblem, RelaxedBarrier, residuals, sets


def double_integrator(
    intervals: int = 30, limit: float = 1.0, hard: bool = False, penalty: RelaxedBarrier | None = None
) -> SampleProblem:
    """p̈ = u, |u| ≤ ``limit`` [m/s²], from rest 2 m beside the goal, 3 s; the limit is active at the start.

    ``hard``: the limit as a hard inequality, else a relaxed barrier (``penalty``).
    """
    dynamics = Ode({"x": ["p", "v"]}, {"u": ["a"]}, lambda x, u: ca.vertcat(x[1], u[0]))
    ocp = OptimalControlProblem(dynamics, 3.0, intervals)
    state = residuals.Expression(2, lambda s: s.x)
    ocp.add(Cost("state", state, [10.0, 1.0], at="path+terminal", terminal_weight=[20.0, 5.0]))
    ocp.add(Cost("input", residuals.Expression(1, lambda s: s.u), 0.1))
    penalty = penalty or RelaxedBarrier(1e-3, 1e-3)
    ocp.add(
        Constraint("limit", residuals.Expression(1, lambda s: s.u), sets.Box(-limit, limit), penalty=penalty, hard=hard)
    )
    return SampleProblem("double integrator", ocp, np.array([2.0, 0.0]), np.array([2.0, 0.0]), np.zeros(1))


#: Cart [kg], pole's point mass [kg], length [m].
_CART, _POLE, _LENGTH = 1.0, 0.3, 0.5


def _cartpole(x: ca.SX, u: ca.SX) -> ca.SX:
    """State: cart, angle (0 hanging), their rates. Source: Tedrake, "Underactuated Robotics", cart-pole."""
    s, c = ca.sin(x[1]), ca.cos(x[1])
    inertia = _CART + _POLE * s * s
    cart = (u[0] + _POLE * s * (_LENGTH * x[3] ** 2 + GRAVITY * c)) / inertia
    pole = -u[0] * c - _POLE * _LENGTH * x[3] ** 2 * c * s - (_CART + _POLE) * GRAVITY * s
    return ca.vertcat(x[2], x[3], cart, pole / (_LENGTH * inertia))


def cartpole(intervals: int = 60, force: float = 25.0, hard: bool = False) -> SampleProblem:
    """Swing-up of a pole on a cart in 2 s, |force| ≤ ``force`` [N]; guess: the angle turns evenly from 0 to π."""
    dynamics = Ode({"x": ["cart", "angle", "cart_rate", "angle_rate"]}, {"u": ["force"]}, _cartpole)
    ocp = OptimalControlProblem(dynamics, 2.0, intervals, integrator="rk4")
    goal = np.array([0.0, np.pi, 0.0, 0.0])
    error = residuals.Expression(4, lambda s: s.x - goal)
    ocp.add(Cost("state", error, [1.0, 1.0, 0.1, 0.1], at="path+terminal", terminal_weight=[100.0, 200.0, 20.0, 20.0]))
    ocp.add(Cost("input", residuals.Expression(1, lambda s: s.u), 0.01))
    penalty = RelaxedBarrier(1e-2, 0.1)
    ocp.add(
        Constraint("limit", residuals.Expression(1, lambda s: s.u), sets.Box(-force, force), penalty=penalty, hard=hard)
    )
    guess = np.linspace(0.0, 1.0, intervals + 1)[:, None] * goal
    return SampleProblem("cart-pole swing-up", ocp, np.zeros(4), guess, np.zeros((intervals, 1)))

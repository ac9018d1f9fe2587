"""Random problems with structure that users write: friction cones, obstacles, fixed variables, free time, redundant equalities.

``python benchmarks/random_problems.py --kind structured --seeds 0-499`` solves them by our solver and by IPOPT.
"""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np

from wbmpc.model.ode import Ode
from wbmpc.ocp import Constraint, Cost, OptimalControlProblem, residuals, sets
from wbmpc.solver import SQP

Rows = residuals.Expression
Made = tuple[OptimalControlProblem, np.ndarray, str]


def _goal(ocp: OptimalControlProblem, goal: np.ndarray, weight: float, inputs: float) -> None:
    """Costs of a distance to ``goal`` (first states) and of inputs."""
    n = goal.size
    ocp.add(Cost("goal", Rows(n, lambda s: s.x[:n] - ca.DM(goal)), weight, at="path+terminal"))
    ocp.add(Cost("input", Rows(ocp.dynamics.input.size, lambda s: s.u), inputs))


def _masses(axes: int) -> Ode:
    """A point mass with one force for each axis."""
    names = [f"{k}{i}" for k in "pv" for i in range(axes)]
    return Ode({"x": names}, {"u": [f"f{i}" for i in range(axes)]}, lambda x, u: ca.vertcat(x[axes:], u))


def friction_cone(r: np.random.Generator) -> Made:
    """A body of 1 kg that is pushed over a floor: the force is within a friction cone, gravity is carried."""
    gravity, friction = 9.81, float(r.uniform(0.2, 1.0))
    fall = ca.DM([0.0, 0.0, -gravity])
    names = {"x": ["px", "py", "pz", "vx", "vy", "vz"]}
    dynamics = Ode(names, {"u": ["fx", "fy", "fz"]}, lambda x, u: ca.vertcat(x[3:], u + fall))
    ocp = OptimalControlProblem(dynamics, float(r.uniform(0.5, 2.0)), int(r.choice([10, 20, 40])))
    ocp.add(
        Cost(
            "goal",
            Rows(3, lambda s: s.x[:3] - ca.DM(r_goal)),
            float(10 ** r.uniform(0, 2)),
            at="path+terminal",
        )
    )
    r_goal = r.normal(size=3) * [1.0, 1.0, 0.1]
    ocp.add(Cost("input", Rows(3, lambda s: s.u + fall), float(10 ** r.uniform(-3, -1))))
    slip: Callable[[residuals.Symbols], ca.SX] = (
        (lambda s: friction * s.u[2] - ca.sqrt(ca.sumsqr(s.u[:2]) + 1e-6))
        if r.random() < 0.5
        else (lambda s: (friction * s.u[2]) ** 2 - ca.sumsqr(s.u[:2]))
    )
    ocp.add(Constraint("cone", Rows(1, slip), sets.NonNegative(), hard=True))
    ocp.add(Constraint("lift", Rows(1, lambda s: s.u[2:]), sets.Box(0.0, 30.0), hard=True))
    return ocp, 0.1 * r.normal(size=6), "friction cone"


def obstacles(r: np.random.Generator) -> Made:
    """A point mass or a unicycle on its way past discs."""
    unicycle = bool(r.random() < 0.5)
    turn = lambda x, u: ca.vertcat(u[0] * ca.cos(x[2]), u[0] * ca.sin(x[2]), u[1])
    dynamics = Ode({"x": ["x", "y", "yaw"]}, {"u": ["v", "w"]}, turn) if unicycle else _masses(2)
    ocp = OptimalControlProblem(dynamics, float(r.uniform(2.0, 4.0)), int(r.choice([20, 40])))
    goal = np.array([2.0, float(r.uniform(-0.5, 0.5))])
    _goal(ocp, goal, float(10 ** r.uniform(0, 1.5)), float(10 ** r.uniform(-2, 0)))
    ocp.add(Constraint("bounds", Rows(2, lambda s: s.u), sets.Box(-2.0, 2.0), hard=True))
    for i in range(int(r.integers(1, 4))):
        center, radius = np.array([r.uniform(0.6, 1.5), r.uniform(-0.7, 0.7)]), float(r.uniform(0.1, 0.3))
        away = lambda s, c=center, d=radius: ca.sumsqr(s.x[:2] - ca.DM(c)) - d * d
        slack = float(r.choice([1e3, np.inf]))
        ocp.add(Constraint(f"disc {i}", Rows(1, away), sets.NonNegative(), hard=True, slack=slack, at="path+terminal"))
    return ocp, np.concatenate([0.1 * r.normal(size=2), np.zeros(1 if unicycle else 2)]), "obstacles"


def fixed_variables(r: np.random.Generator) -> Made:
    """Inputs, or states at the end, whose lower and upper bounds are equal, or nearly."""
    axes = int(r.integers(2, 4))
    ocp = OptimalControlProblem(_masses(axes), float(r.uniform(0.5, 3.0)), int(r.choice([5, 20, 50])))
    _goal(ocp, r.normal(size=axes), float(10 ** r.uniform(0, 2)), float(10 ** r.uniform(-2, 0)))
    gap = float(r.choice([0.0, 0.0, 1e-14, 1e-12, 1e-10, 1e-9, 1e-8, 1e-7, 1e-6, 1e-4]))
    lower, upper = -5.0 * np.ones(axes), 5.0 * np.ones(axes)
    held = r.random(axes) < 0.5
    lower[held] = r.uniform(-1.0, 1.0, held.sum())
    upper[held] = lower[held] + gap
    ocp.add(Constraint("bounds", Rows(axes, lambda s: s.u), sets.Box(lower, upper), hard=True))
    if r.random() < 0.5 and not held[0]:
        stop = Rows(1, lambda s: s.x[axes : axes + 1])
        slack = float(r.choice([1e4, np.inf]))
        ocp.add(Constraint("stop", stop, sets.Box(0.0, gap), hard=True, at="terminal", slack=slack))
    return ocp, r.normal(size=2 * axes) * 0.5, f"fixed variables, gap {gap:g}"


def free_time(r: np.random.Generator) -> Made:
    """The grid's time is scaled by an input, which is paid for: how long a motion to rest takes is found."""
    names = {"u": ["a", "scale"]}
    dynamics = Ode({"x": ["p", "v"]}, names, lambda x, u: u[1] * ca.vertcat(x[1], u[0]))
    ocp = OptimalControlProblem(dynamics, 1.0, int(r.choice([10, 20, 40])))
    goal = float(r.uniform(0.5, 2.0))
    price = float(10 ** r.uniform(-1, 1))
    ocp.add(Cost("time", Rows(1, lambda s: s.u[1:]), price))
    ocp.add(Cost("input", Rows(1, lambda s: s.u[:1]), float(10 ** r.uniform(-2, 0))))
    ocp.add(Constraint("bounds", Rows(2, lambda s: s.u), sets.Box([-4.0, 0.2], [4.0, 5.0]), hard=True))
    ocp.add(Constraint("there", Rows(2, lambda s: s.x - ca.DM([goal, 0.0])), at="terminal"))
    return ocp, np.array([0.1 * r.normal(), 0.0]), "free time"


def redundant_equalities(r: np.random.Generator) -> Made:
    """Rows that say the same: once more, scaled, or the sum of two others."""
    axes = int(r.integers(2, 5))
    ocp = OptimalControlProblem(_masses(axes), float(r.uniform(0.5, 2.0)), int(r.choice([5, 20, 50])))
    _goal(ocp, r.normal(size=axes), float(10 ** r.uniform(0, 2)), float(10 ** r.uniform(-2, 0)))
    one = r.normal(size=(1, 3 * axes))
    two = r.normal(size=(1, 3 * axes))
    rows = {0: [one, one], 1: [one, -3.0 * one], 2: [one, two, one + two], 3: [one, 1e-3 * one, 1e3 * one]}
    matrix = np.vstack(rows[int(r.integers(0, 4 if axes > 2 else 2))])
    if matrix.shape[0] == 3 and np.linalg.matrix_rank(matrix) == 2 and axes < 3:
        matrix = matrix[:1]
    curve = bool(r.random() < 0.3)
    bend = lambda s: ca.vertcat(ca.sin(s.x) if curve else s.x, s.u)
    ocp.add(Constraint("rows", Rows(matrix.shape[0], lambda s: ca.DM(matrix) @ bend(s))))
    if r.random() < 0.5:
        ocp.add(Constraint("bounds", Rows(axes, lambda s: s.u), sets.Box(-8.0, 8.0), hard=True))
    return ocp, 0.3 * r.normal(size=2 * axes), "redundant equalities"


KINDS = (friction_cone, obstacles, fixed_variables, free_time, redundant_equalities)


def draw(seed: int) -> tuple[OptimalControlProblem, np.ndarray, SQP, str]:
    """(Problem, start, settings, what it is) of a seed."""
    r = np.random.default_rng([seed, 1])
    ocp, x0, kind = KINDS[seed % len(KINDS)](r)
    exact = bool(r.random() < 0.2)
    return ocp, x0, SQP(hessian="exact") if exact else SQP(), f"{'exact' if exact else 'SQP'}: {kind}"

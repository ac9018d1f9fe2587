"""Plans that stop the robot as fast as its limits allow: what replaces a plan that would run into something."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from wbmpc.arrays import Array
from wbmpc.model.augment import InputRate, WithPath
from wbmpc.model.robot import RobotModel
from wbmpc.solver import Solver

#: A stop takes so long [s] at least and, where no limit says how fast inputs change, exactly the second; no longer than the last.
SHORTEST, USUAL, LONGEST = 0.2, 0.5, 1.5


def braking_time(dynamics: Any, robot: RobotModel, x0: Array, u0: Array) -> float:
    """How long [s] a stop from the state ``x0`` (nx) under the input ``u0`` (nu) takes with all inputs in proportion."""
    rates, u = robot.limits.input_rate, _speeds(dynamics, robot, x0, u0)
    known = np.isfinite(rates) & (rates > 0.0)
    if not known.any():
        return USUAL
    return float(np.clip((np.abs(u[known]) / rates[known]).max(), SHORTEST, LONGEST))


class BrakingPlan(NamedTuple):
    """States ``x`` (N + 1, nx) and inputs ``u`` (N, nu) of a stop."""

    x: Array
    u: Array


def braking_plan(solver: Solver, robot: RobotModel, x0: Array, u0: Array, grid: Array, duration: float) -> BrakingPlan:
    """A stop of ``duration`` [s] from the state ``x0`` (nx) under the input ``u0`` (nu), at nodes ``grid`` (N + 1) [s] from now."""
    dynamics = solver.ocp.dynamics
    # the mean over each interval of what is left of the speed, and how much of the interval the stop lasts
    left = _remaining(grid, duration)
    lasts = np.clip((duration - grid[:-1]) / np.diff(grid), 0.0, 1.0)
    inputs = left[:, None] * u0
    if isinstance(dynamics, WithPath):  # its speed is a state
        inputs[:, dynamics.input["path"]] = -np.outer(lasts, x0[dynamics.state["path"]][1:]) / duration
        dynamics = dynamics.dynamics
    if isinstance(dynamics, InputRate):
        for group in dynamics.groups:
            inputs[:, dynamics.input[f"{group}_rate"]] = (
                -np.outer(lasts, x0[dynamics.state[group + "_input"]]) / duration
            )
    states = np.empty((len(grid), len(x0)))
    states[0] = x0
    for k, h in enumerate(np.diff(grid)):
        states[k + 1] = solver.simulate(states[k], inputs[k], float(h))
    return BrakingPlan(states, inputs)


def _remaining(grid: Array, duration: float) -> Array:
    """Mean (N) over each interval of max(0, 1 − t / duration)."""
    t = np.minimum(grid, duration)
    distance = t - 0.5 * t**2 / duration
    return np.asarray(np.diff(distance) / np.diff(grid))


def _speeds(dynamics: Any, robot: RobotModel, x0: Array, u0: Array) -> Array:
    """Inputs of the robot (nu): of a wrapper that has them as states, those."""
    u = np.zeros(robot.input.size)
    for group in robot.input.groups:
        if group in dynamics.input:
            u[robot.input[group]] = u0[dynamics.input[group]]
        elif isinstance(dynamics, InputRate) and group in dynamics.groups:
            u[robot.input[group]] = x0[dynamics.state[group + "_input"]]
    return u

"""Plans that stop: how long a stop takes, and its states and inputs."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wbmpc.arrays import Array
from wbmpc.clearance.plan_step import stop_duration, stop_inputs
from wbmpc.model.augment import InputRate, WithPath
from wbmpc.model.robot import RobotModel
from wbmpc.solver import Solver

Ints = NDArray[np.int64]


class BrakingPlan(NamedTuple):
    """States ``x`` (N + 1, nx) and inputs ``u`` (N, nu) of a stop."""

    x: Array
    u: Array


def rate_limits(dynamics: Any, robot: RobotModel) -> tuple[Array, Ints]:
    """Limits of how fast inputs of the robot change, as far as there are any, and where the inputs are: see
    :func:`~wbmpc.clearance.plan_step.stop_duration`."""
    rates, sources = robot.limits.input_rate, np.zeros(robot.input.size, np.int64)
    found = np.zeros(robot.input.size, bool)
    for group in robot.input.groups:
        if group in dynamics.input:
            sources[robot.input[group]] = np.arange(dynamics.input.size)[dynamics.input[group]]
        elif isinstance(dynamics, InputRate) and group in dynamics.groups:
            sources[robot.input[group]] = -1 - np.arange(dynamics.state.size)[dynamics.state[group + "_input"]]
        else:
            continue
        found[robot.input[group]] = True
    known = np.isfinite(rates) & (rates > 0.0)
    return np.where(found, rates, np.inf)[known], sources[known]


def braking_time(dynamics: Any, robot: RobotModel, x0: Array, u0: Array) -> float:
    """How long [s] a stop from the state ``x0`` (nx) under the input ``u0`` (nu) takes with all inputs in proportion."""
    rates, sources = rate_limits(dynamics, robot)
    return stop_duration(len(rates), rates, sources, np.ascontiguousarray(x0), np.ascontiguousarray(u0))


def rated_states(dynamics: Any) -> Ints:
    """Of each input the state whose rate it is and that a stop takes to zero; −1: the input itself falls."""
    found = np.full(dynamics.input.size, -1)
    states = np.arange(dynamics.state.size)
    if isinstance(dynamics, WithPath):  # its speed is a state
        found[dynamics.input["path"]] = states[dynamics.state["path"]][1:]
        dynamics = dynamics.dynamics
    if isinstance(dynamics, InputRate):
        for group in dynamics.groups:
            found[dynamics.input[f"{group}_rate"]] = states[dynamics.state[group + "_input"]]
    return found


def braking_plan(solver: Solver, x0: Array, u0: Array, grid: Array, duration: float) -> BrakingPlan:
    """A stop of ``duration`` [s] from the state ``x0`` (nx) under the input ``u0`` (nu), at nodes ``grid`` (N + 1) [s] from now."""
    dynamics, n = solver.ocp.dynamics, len(grid) - 1
    states, inputs = np.empty((n + 1, len(x0))), np.empty((n, len(u0)))
    x0, u0, grid = np.ascontiguousarray(x0), np.ascontiguousarray(u0), np.ascontiguousarray(grid)
    stop_inputs(n, len(u0), grid, x0, u0, rated_states(dynamics), duration, inputs)
    states[0] = x0
    for k, h in enumerate(np.diff(grid)):
        states[k + 1] = solver.simulate(states[k], inputs[k], float(h))
    return BrakingPlan(states, inputs)

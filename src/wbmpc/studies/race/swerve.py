"""The swerve base on brakes with its pose as position and quaternion, without and with its arm.

States: position 3, quaternion 4, four legs, four steering axes, four wheels (19), six arm joints (25). Inputs: body twist
3, the joints' rates (15, 21). Rows: four rolling, four side-slip, four brakes. The sizes are those of the swerve robots that
were measured with OCS2; the weights are this library's.
"""

from __future__ import annotations

from functools import cache
from typing import Any, Literal

import casadi as ca
import numpy as np

from wbmpc.benchmark.problems import SampleProblem
from wbmpc.model.layout import Layout
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.ocp import (
    Constraint,
    Cost,
    Mode,
    ModeSchedule,
    OptimalControlProblem,
    Reference,
    RelaxedBarrier,
    residuals,
    sets,
)

Brakes = Literal["closed", "open", "events"]


@cache
def _robot() -> RobotModel:
    return load_robot("swerve-ur10", orientation="quaternion")


class WithoutArm:
    """A robot's dynamics with the arm (the last group of state and input) standing still at zero."""

    def __init__(self, dynamics: Any) -> None:
        self.dynamics = dynamics
        kept = lambda groups: {g: own for g, own in groups.items() if g != "arm"}
        drop = lambda layout: Layout(kept(layout.groups), kept(layout.unit_groups))
        self.state, self.input = drop(dynamics.state), drop(dynamics.input)
        self.parameters, self.mode = dynamics.parameters, dynamics.mode
        self.unit_quaternions = dynamics.unit_quaternions

    def view(self, x: ca.SX, u: ca.SX) -> tuple[ca.SX, ca.SX]:
        """The robot's own state and input, zero for the arm."""
        still = lambda own, layout: ca.vertcat(own, ca.SX(layout.size - own.shape[0], 1))
        return still(x, self.dynamics.state), still(u, self.dynamics.input)

    def __call__(self, x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> ca.SX:
        """ẋ (nx)."""
        return self.dynamics(*self.view(x, u), w, m)[: self.state.size]

    def jacobian(self, x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> tuple[ca.SX, ca.SX]:
        """ẋ and its Jacobian (nx, nx + nu) by [x; u]."""
        f = self(x, u, w, m)
        return f, ca.jacobian(f, ca.vertcat(x, u))


_POSTURE = {"leg": 1.0, "steer": 0.05, "arm": 0.05}
_RATES = {"base": 0.5, "leg": 1.0, "steer": 0.05, "wheel": 0.001, "arm": 0.1}


def _terms(ocp: OptimalControlProblem, robot: RobotModel, groups: tuple[str, ...]) -> None:
    """Costs and constraints; ``groups``: the joints that there are."""
    joints = [g for g in groups if g in _POSTURE]
    rates = ["base", *groups]
    body = residuals.FramePose(robot, robot.description.base.body)
    ocp.add(Cost("body", body, [10.0, 10.0, 0.1, 0.1, 0.1, 10.0], at="path+terminal"))
    ocp.add(Cost("posture", residuals.State(robot, joints), {g: _POSTURE[g] for g in joints}, at="path+terminal"))
    ocp.add(Cost("rates", residuals.Input(robot, rates, reference=None), {g: _RATES[g] for g in rates}))
    if "arm" in groups:
        end_effector = residuals.FramePose(robot, robot.tool)
        ocp.add(Cost("end_effector", end_effector, [1000.0] * 3 + [200.0] * 3, at="path+terminal"))
    ocp.add(Constraint("rolling", residuals.Rolling(robot)))
    ocp.add(Constraint("brakes", residuals.LockedJoints(robot)))
    barrier, limits = RelaxedBarrier(1e-3, 0.02), robot.limits
    state, speed = residuals.State(robot, joints, reference=None), residuals.Input(robot, rates, reference=None)
    ranges = sets.Box(limits.state_lower[state.indices], limits.state_upper[state.indices])
    speeds = sets.Box(limits.input_lower[speed.indices], limits.input_upper[speed.indices])
    ocp.add(Constraint("ranges", state, ranges, at="path+terminal", penalty=barrier))
    ocp.add(Constraint("speeds", speed, speeds, penalty=barrier))


def swerve(arm: bool = True, intervals: int = 101, horizon: float = 10.0, brakes: Brakes = "closed") -> SampleProblem:
    """The body drives 0.2 m/s ahead from rest, the end effector (with ``arm``) keeps its place on the body.

    ``brakes``: those of all legs, over the whole horizon, or opened from 2 s to 5 s ("events").
    """
    robot = _robot()
    groups = ("leg", "steer", "wheel", "arm") if arm else ("leg", "steer", "wheel")
    dynamics = robot.dynamics() if arm else WithoutArm(robot.dynamics())
    ocp = OptimalControlProblem(dynamics, horizon, intervals)
    _terms(ocp, robot, groups)
    t = np.linspace(0.0, 2.0 * horizon, 200)
    along = 0.2 * np.where(t < 1.0, 0.5 * t * t, t - 0.5)
    size = dynamics.state.size
    home = np.concatenate([robot.home[: robot.state["arm"].start], np.zeros(6)]) if not arm else robot.home
    move = along[:, None] * np.array([1.0, 0.0, 0.0])
    posture = np.concatenate([home[robot.state[g]] for g in groups if g in _POSTURE])
    references = {
        "body": Reference.poses(t, home[:3] + move, home[3:7]),
        "posture": Reference.constant(posture),
    }
    if arm:
        position, quaternion = robot.pose(robot.home)
        references["end_effector"] = Reference.poses(t, position + move, quaternion)
    closed, free = Mode("closed", {"brake": [0.0] * 4}), Mode("open", {"brake": [1.0] * 4})
    schedule = {
        "closed": ModeSchedule((closed,)),
        "open": ModeSchedule((free,)),
        "events": ModeSchedule((closed, free, closed), (2.0, 5.0)),
    }[brakes]
    name = f"swerve base{' with arm' if arm else ''}, brakes {'with events' if brakes == 'events' else brakes}"
    return SampleProblem(name, ocp, home[:size], home[:size], np.zeros(dynamics.input.size), references, schedule)

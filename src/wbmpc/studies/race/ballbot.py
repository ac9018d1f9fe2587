"""The ball robot of OCS2's example: 10 states, 3 wheel torques.

Model and weights are those published in leggedrobotics/ocs2, ocs2_robotic_examples/ocs2_ballbot: urdf/ballbot.urdf (a ball
that slides on x and y and does not spin, ZYX Euler joints, the base), the actuation of BallbotSystemDynamics.cpp, which is
the virtual power of three omni wheels, and config/mpc/task.info (Q, R, no terminal cost, 2 s, RK2).
Not published there and chosen here: the goal.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from wbmpc.benchmark.problems import SampleProblem
from wbmpc.model.kinematics import constant, rotation_about
from wbmpc.model.tree import Link
from wbmpc.ocp import Cost, OptimalControlProblem, Reference, residuals
from wbmpc.studies.race.multibody import Multibody

_BALL_RADIUS, _WHEEL_RADIUS = 0.125, 0.064
_AXES = {"yaw": (0.0, 0.0, 1.0), "pitch": (0.0, 1.0, 0.0), "roll": (1.0, 0.0, 0.0)}
_POSE = ["x", "y", *_AXES]
_WEIGHTS = [100.0, 100.0, 400.0, 0.0, 0.0, 40.0, 40.0, 40.0, 20.0, 20.0]


def _links() -> list[Link]:
    """Ball and base of ballbot.urdf, with its links of 1 g between them."""
    small, zero, eye = 1e-4 * np.eye(3), np.zeros(3), np.eye(3)
    ball = 0.0166 * np.eye(3)
    links = [
        Link("x", -1, "x", "prismatic", np.array([1.0, 0, 0]), np.array([0, 0, _BALL_RADIUS]), eye, 1e-3, zero, small),
        Link("ball", 0, "y", "prismatic", np.array([0, 1.0, 0]), zero, eye, 2.65, zero, ball),
    ]
    base = (18.66, np.array([0.003, 0.0033, 0.1956]), np.diag([1.80, 1.8037, 0.166703]))
    for k, (name, axis) in enumerate(_AXES.items()):
        body = base if name == "roll" else (1e-3, zero, small)
        links.append(Link(name, 1 + k, name, "revolute", np.array(axis), zero, eye, *body))
    return links


def actuation(q: ca.SX) -> ca.SX:
    """S(q), (5, 3): generalized forces per wheel torque, by the virtual power of the wheels' speeds ψ̇ = Sᵀ v.

    ψ̇ = −(r / r_w) aᵀ Rᵀ (Ω − ω) with wheel axes a under 45° at 0°, 120°, 240°, and the ball's spin Ω = (−ẏ, ẋ, 0) / r.
    """
    azimuth = np.deg2rad([0.0, 120.0, 240.0])
    axes = np.stack([np.cos(azimuth), np.sin(azimuth), -np.ones(3)]) * np.sqrt(0.5)
    yaw, pitch, roll = (rotation_about(np.array(axis), q[2 + k]) for k, axis in enumerate(_AXES.values()))
    unit = ca.SX.eye(3)
    rates = ca.horzcat(unit[:, 2], yaw @ unit[:, 1], yaw @ pitch @ unit[:, 0])  # ω by (yaw, pitch, roll) rates
    spin = constant(np.array([[0.0, -1.0], [1.0, 0.0], [0.0, 0.0]]) / _BALL_RADIUS)
    relative = ca.horzcat(spin, -rates)
    return (-_BALL_RADIUS / _WHEEL_RADIUS * constant(axes.T) @ (yaw @ pitch @ roll).T @ relative).T


def ballbot_dynamics() -> Multibody:
    """State: x, y, yaw, pitch, roll and their rates; inputs: wheel torques [N m]."""
    wheels = {"wheel": ["wheel_1", "wheel_2", "wheel_3"]}
    return Multibody(_links(), {"pose": _POSE, "rate": _POSE}, wheels, lambda q, u: actuation(q) @ u)


def ballbot(intervals: int = 101, goal: tuple[float, float, float] = (1.0, 0.5, 0.5)) -> SampleProblem:
    """From rest at the origin to rest at ``goal`` (x [m], y [m], yaw [rad]), 2 s."""
    ocp = OptimalControlProblem(ballbot_dynamics(), 2.0, intervals)
    ocp.add(Cost("state", residuals.Expression(10, lambda s: s.x - s.reference, 10), _WEIGHTS))
    ocp.add(Cost("input", residuals.Expression(3, lambda s: s.u), 2.0))
    references = {"state": Reference.constant([*goal, *np.zeros(7)])}
    return SampleProblem("OCS2's ballbot", ocp, np.zeros(10), np.zeros(10), np.zeros(3), references)

"""An arm of any number of equal links with torques at its joints: how solvers scale with the degrees of freedom."""

from __future__ import annotations

import casadi as ca
import numpy as np

from wbmpc.benchmark.problems import SampleProblem
from wbmpc.model.kinematics import constant
from wbmpc.model.tree import Frame, Link
from wbmpc.ocp import Cost, OptimalControlProblem, Reference, residuals
from wbmpc.studies.race.multibody import Multibody

#: Length [m] and mass [kg] of the whole arm, however many links; radius [m] of the links; inertia of a drive [kg m²].
LENGTH, MASS, RADIUS, ARMATURE = 1.2, 12.0, 0.05, 0.1
#: Weights: end effector [1/m²], joint angles [1/rad²] and rates, torques [1/(N m)²]; the end counts as one second.
END_EFFECTOR_WEIGHT, ANGLE, RATE, TORQUE = 100.0, 0.1, 0.1, 1e-4
_AXES = ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0))


def torque_arm_links(joints: int) -> list[Link]:
    """Uniform rods along +z, joint axes z, y, x, z, … in turn."""
    length, mass = LENGTH / joints, MASS / joints
    side = mass * (3.0 * RADIUS**2 + length**2) / 12.0
    inertia = np.diag([side, side, 0.5 * mass * RADIUS**2])
    com, links = np.array([0.0, 0.0, 0.5 * length]), []
    for k in range(joints):
        place = np.array([0.0, 0.0, length if k else 0.0])
        axis = np.array(_AXES[k % 3])
        links.append(Link(f"link_{k}", k - 1, f"joint_{k}", "revolute", axis, place, np.eye(3), mass, com, inertia))
    return links


def torque_arm(joints: int = 6, intervals: int = 50, horizon: float = 1.0) -> SampleProblem:
    """The end effector is to go 0.3 m to the side from a bent posture at rest. State: angles and rates, input: torques [N m]."""
    names = [f"joint_{k}" for k in range(joints)]
    groups = ({"q": names, "v": names}, {"torque": names})
    dynamics = Multibody(torque_arm_links(joints), *groups, lambda q, u: u, ARMATURE)
    tip = Frame(joints - 1, np.array([0.0, 0.0, LENGTH / joints]), np.eye(3))
    ocp = OptimalControlProblem(dynamics, horizon, intervals)
    end_effector = residuals.Expression(3, lambda s: dynamics.chain(s.x).frame_pose(tip).position - s.reference, 3)
    state = residuals.Expression(2 * joints, lambda s: s.x - s.reference, 2 * joints)
    ocp.add(Cost("end_effector", end_effector, END_EFFECTOR_WEIGHT, at="path+terminal"))
    ocp.add(Cost("state", state, [ANGLE] * joints + [RATE] * joints, at="path+terminal"))
    ocp.add(Cost("torque", residuals.Expression(joints, lambda s: s.u), TORQUE))
    q0 = np.array([(0.0, 0.6, 0.1)[k % 3] * 6.0 / joints for k in range(joints)])
    x, u, rest = ca.SX.sym("x", 2 * joints), ca.SX.sym("u", joints), np.concatenate([q0, np.zeros(joints)])
    at_rest = ca.Function("rest", [x, u], [dynamics.chain(x).frame_pose(tip).position, holding_torque(dynamics, x)])
    position, torque = (np.array(v).ravel() for v in at_rest(rest, np.zeros(joints)))
    references = {
        "end_effector": Reference.constant(position + np.array([0.0, 0.3, 0.0])),
        "state": Reference.constant(rest),
    }
    return SampleProblem(f"torque arm, {joints} joints", ocp, rest, rest, torque, references)


def holding_torque(dynamics: Multibody, x: ca.SX) -> ca.SX:
    """Torques (nq) that hold the arm against gravity."""
    nothing = {i: constant(0.0) for i in range(dynamics.nq)}
    return dynamics.chain(x).inverse_dynamics(nothing, nothing)

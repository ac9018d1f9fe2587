"""A mobile manipulator like that of OCS2's example: a differential-drive base with an arm of six joints.

Weights and limits: leggedrobotics/ocs2, ocs2_mobile_manipulator, config/mabi_mobile/task.info (end effector, input costs,
relaxed barriers of joint ranges and speeds, 1 s), self-collision left out. The arm is a UR10 in place of the Mabi.
"""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np

from wbmpc import lie
from wbmpc.benchmark.problems import SampleProblem
from wbmpc.model.kinematics import Chain, FramePose, constant, rotation_about
from wbmpc.model.ode import Ode
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.model.tree import Link
from wbmpc.ocp import Constraint, Cost, OptimalControlProblem, Reference, RelaxedBarrier, residuals, sets
from wbmpc.ocp.residuals import Symbols

#: Where the arm's swerve robot stands in for the arm alone, and where its base link is on the base [m] (assumed).
_MOUNT = np.array([0.2, 0.0, 0.4])
_UP = np.array([0.0, 0.0, 1.0])


@cache
def _arm() -> RobotModel:
    return load_robot("swerve-fixed-ur10")


def end_effector_pose(x: ca.SX) -> FramePose:
    """Pose of the end effector for a state (x, y, yaw, six joints)."""
    tree, yaw = _arm().tree, x[2]
    joints = [tree.joint(name) for name in _arm().description.arm.joints]
    first = tree.links[joints[0]].parent
    position = ca.vertcat(x[0], x[1], ca.SX(1, 1)) + rotation_about(_UP, yaw) @ constant(_MOUNT)
    root = FramePose(position, ca.sparsify(lie.quaternion_about(_UP, yaw)), rotation_about(_UP, yaw))
    # the links from the arm's own base on, with that as the root
    links: list[Link] = []
    place: dict[int, int] = {}
    for i in [i for i in range(len(tree.links)) if _descends(tree.links, i, first)]:
        link = tree.links[i]
        place[i] = len(links)
        links.append(type(link)(**{**link.__dict__, "parent": place.get(link.parent, -1)}))
    frame = tree.frames[_arm().tool]
    chain = Chain(links, {place[joint]: x[3 + k] for k, joint in enumerate(joints)}, root)
    return chain.frame_pose(type(frame)(place[frame.link], frame.position, frame.rotation))


def _descends(links: tuple, i: int, root: int) -> bool:  # type: ignore[type-arg]
    while i >= 0:
        if links[i].parent == root:
            return True
        i = links[i].parent
    return False


def _error(s: Symbols) -> ca.SX:
    """Position error (3) [m] and vector part of the error quaternion (3), as OCS2's quaternionDistance."""
    pose = end_effector_pose(s.x)
    error = lie.quaternion_multiply(pose.quaternion, lie.quaternion_conjugate(s.reference[3:7]))
    return ca.vertcat(pose.position - s.reference[0:3], lie.quaternion_error_vector(error))


def _unicycle(x: ca.SX, u: ca.SX) -> ca.SX:
    return ca.vertcat(ca.cos(x[2]) * u[0], ca.sin(x[2]) * u[0], u[1:])


def differential_manipulator(intervals: int = 21, step: tuple[float, float, float] = (0.2, 0.1, -0.1)) -> SampleProblem:
    """The end effector is to move by ``step`` [m] and keep its orientation, 1 s. State 9, inputs v, ω and six joint speeds."""
    joints = list(_arm().description.arm.joints)
    dynamics = Ode({"base": ["x", "y", "yaw"], "arm": joints}, {"base": ["v", "w"], "arm": joints}, _unicycle)
    ocp = OptimalControlProblem(dynamics, 1.0, intervals)
    ocp.add(Cost("end_effector", residuals.Expression(6, _error, 7), [10.0] * 3 + [5.0] * 3, at="path+terminal"))
    ocp.add(Cost("input", residuals.Expression(8, lambda s: s.u), [0.05] * 2 + [0.01] * 6))
    speed = np.array([0.1, 0.3] + [0.45] * 6)
    box = sets.Box(-speed, speed)
    ocp.add(Constraint("speeds", residuals.Expression(8, lambda s: s.u), box, penalty=RelaxedBarrier(0.01, 1e-3)))
    limit, arm = 2.0 * np.pi, residuals.Expression(6, lambda s: s.x[3:])
    ocp.add(Constraint("ranges", arm, sets.Box(-limit, limit), at="path+terminal", penalty=RelaxedBarrier(1e-3, 1e-3)))
    x0 = np.concatenate([np.zeros(3), _arm().home[_arm().state["arm"]]])
    x = ca.SX.sym("x", 9)
    pose = end_effector_pose(x)
    position, quaternion = (np.array(v).ravel() for v in ca.Function("p", [x], [pose.position, pose.quaternion])(x0))
    references = {"end_effector": Reference.poses([0.0], [position + np.array(step)], quaternion)}
    return SampleProblem("differential-drive manipulator", ocp, x0, x0, np.zeros(8), references)

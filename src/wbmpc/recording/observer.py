"""What can be seen of a running loop: what recordings and views have in common.

Frames (REP 105; names: :mod:`wbmpc.robots.frames`): ``map`` is the simulated world with z = 0 on the floor, ``odom`` the frame
of the controller's estimate, in which references and plans are; ``map`` → ``odom`` is the drift. Where the controller has no
estimate of the base the two are one. Poses (7) are position [m] and quaternion.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.model.layout import Layout
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.mpc.policy_queue import PolicyQueue
from wbmpc.robots.frames import BASE, frame_names
from wbmpc.simulation.lockstep import Running
from wbmpc.simulation.scene import SceneReader

#: Points of a plan that is shown or written.
PLAN_POINTS = 31


@dataclass(frozen=True)
class Moment:
    """``bodies`` (n, 7) in the order of the scene, ``base`` and ``end_effector`` in ``map``; ``estimated`` base in ``odom``; ``drift``
    of ``odom`` in ``map``."""

    bodies: Array
    base: Array
    end_effector: Array
    estimated: Array
    drift: Array


class Observer:
    """Reads one loop. ``lift`` (3) [m]: the planner's z = 0 above the floor."""

    def __init__(self, running: Running) -> None:
        description = running.plant.description
        self.running = running
        model = running.plant.model
        names = frame_names(description.base.body, [model.body(i).name for i in range(1, model.nbody)])
        self.reader = SceneReader(model, BASE, names)
        self.scene = self.reader.scene
        self._base = self.scene.index
        self.lift = np.array([0.0, 0.0, -description.base.ground])

    def see(self) -> Moment:
        """The present moment."""
        plant, controller = self.running.plant, self.running.controller
        frames = plant.world.frames(height=0.0)  # brings positions up to date
        bodies = self.reader.poses(plant.data)
        base = bodies[self._base]
        belief = getattr(controller, "base_pose", None)
        estimated = base if belief is None else belief()
        end_effector = np.concatenate([frames["tool"], lie.rotation_to_quaternion(frames["tool_rotation"])])
        return Moment(bodies, base, end_effector, estimated, lie.pose_compose(base, lie.pose_inverse(estimated)))

    def end_effector_goal(self, t: float) -> Array | None:
        """The end effector's reference in ``odom`` at time t [s], if the problem has one."""
        return end_effector_goal(self.running.mpc, t, self.lift)

    def plan(self, plans: PolicyQueue) -> tuple[Array, Array]:
        """Predicted poses of base and end effector (n, 7) in ``odom``, n at most PLAN_POINTS, none before the first plan.

        A base that is planned in the plane lies at the planner's z = 0.
        """
        if plans.current is None or self.running.mpc is None:
            return np.zeros((0, 7)), np.zeros((0, 7))
        layout = self.running.mpc.dynamics.state
        assert self.running.controller is not None, "a controller made the plan"
        return predicted(self.running.controller.robot, layout, thinned(plans.current.x), self.lift)


def end_effector_goal(mpc: MPC | None, t: float, lift: Array) -> Array | None:
    """The end effector's reference (7) of an MPC at time t [s] above the floor, None if its problem has none; ``lift`` (3) [m]."""
    path = getattr(mpc, "path", None)
    if mpc is not None and path is not None and path.following is not None:
        if not path.of_end_effector:
            return None
        goal = mpc.path.pose(t)
        return np.concatenate([goal[:3] + lift, goal[3:]])
    if mpc is None or "end_effector" not in mpc.reference or mpc.reference["end_effector"].values.shape[1] != 7:
        return None
    goal = mpc.reference["end_effector"].at(t)
    return np.concatenate([goal[:3] + lift, goal[3:]])


def thinned(states: Array) -> Array:
    """PLAN_POINTS of a plan's states (n, nx) at most, from the first to the last."""
    return states[_spread(len(states))]


@cache
def _spread(count: int) -> Array:
    """PLAN_POINTS of ``count`` rows at most, spread over them."""
    return np.unique(np.linspace(0, count - 1, PLAN_POINTS).round().astype(int))


def predicted(robot: RobotModel, layout: Layout, states: Array, lift: Array) -> tuple[Array, Array]:
    """Poses of base and end effector (n, 7) above the floor at states (n, nx), whose groups are in ``layout``; ``lift`` (3) [m]. A base that
    is not in the state is drawn at the origin."""
    end_effector = robot.poses(np.hstack([states[:, layout[group]] for group in robot.state.groups]))
    planned = states[:, layout["base"]] if "base" in robot.state else np.zeros((len(states), 3))
    base = base_poses(planned)
    base[:, :3] += lift
    end_effector[:, :3] += lift
    return base, end_effector


def base_poses(planned: Array) -> Array:
    """Poses (n, 7) of planned bases (n, 7), or (n, 3 or more): x, y, yaw and more, which lie at the planner's z = 0."""
    if planned.shape[1] == 7:
        return planned.copy()
    poses, half = np.zeros((len(planned), 7)), 0.5 * planned[:, 2]
    poses[:, :2], poses[:, 3], poses[:, 6] = planned[:, :2], np.cos(half), np.sin(half)
    return poses

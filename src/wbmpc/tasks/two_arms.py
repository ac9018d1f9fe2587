"""`two-arms`: two end effectors hold one thing and carry it along a path while the base drives."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
from pydantic import Field

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.default_problem import default_mpc_settings, default_problem, keep_clear, make_mpc, stay_at_home
from wbmpc.errors import InputError
from wbmpc.experiment import Experiment, Scenario
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.mpc.mpc import MPC
from wbmpc.obstacles.world import Obstacles
from wbmpc.ocp import Constraint, Reference, residuals
from wbmpc.result import Metric, Plot, Series
from wbmpc.robots.examples import EXAMPLES
from wbmpc.settings import Positive, Robot
from wbmpc.tasks.definitions import DEFINITIONS
from wbmpc.tasks.loop import Hooks, closed_loop
from wbmpc.tasks.path_settings import AnyPath, Sine, follow, timed
from wbmpc.tasks.settings import SimulationSettings, TaskMpcSettings, scale_weights

#: How soft the grasp is: speeds of one end effector against the other are as good as zero, and no plan is infeasible.
SOFTNESS = 1e-6
IDEALIZATION = "what is held has no mass and does not bend: the grasp error is by how much it would have to yield"


class TwoArmsSettings(SimulationSettings):
    """``robot``: a name or a file, with ``arms``; ``path`` of its first end effector, and of what both hold with it; ``mpc``: what differs from
    the default problem; ``weights``: factors of costs by name."""

    robot: Robot = EXAMPLES["two-arms"]
    path: AnyPath = Sine(length=4.0, amplitude=0.2, lift=0.05)
    mpc: TaskMpcSettings = TaskMpcSettings()
    weights: dict[str, Positive] = Field(default={})


def grasp_of(robot: RobotModel) -> ca.Function:
    """States (nx) to position (3) [m] and quaternion (4) of the second end effector in the axes of the first. Raises :class:`InputError` for
    a robot with one."""
    if len(robot.tools) < 2:
        raise InputError(
            f"two-arms: robot: '{robot.description.name}' has one arm; valid: a robot whose file has 'arms' with two"
        )
    x = ca.SX.sym("x", robot.state.size)
    one, other = (robot.frame_pose(x, frame) for frame in list(robot.tools.values())[:2])
    turned = lie.quaternion_multiply(lie.quaternion_conjugate(one.quaternion), other.quaternion)
    return ca.Function("grasp", [x], [one.rotation.T @ (other.position - one.position), turned])


def holding_mpc(settings: TwoArmsSettings, robot: RobotModel) -> MPC:
    """The default MPC with an equality: the second end effector moves with the first, as they are at home."""
    changes: dict[str, Any] = {name: value for name, value in settings.mpc.model_dump().items() if value is not None}
    chosen, (first, second, *_) = default_mpc_settings(**changes), robot.tools.values()
    obstacles = None if settings.obstacles is None else Obstacles()
    ocp = keep_clear(default_problem(robot, chosen), robot, obstacles)
    ocp.add(Constraint("grasp", residuals.RelativeMotion(robot, first, second), softness=SOFTNESS))
    mpc = make_mpc(ocp, chosen, obstacles=obstacles)
    stay_at_home(robot, mpc)
    position, quaternion = grasp_of(robot)(robot.home)
    mpc.reference["grasp"] = Reference.constant(np.array(ca.vertcat(position, quaternion)).ravel())
    scale_weights(mpc, settings.weights)
    return mpc


def grasp_errors(robot: RobotModel, states: Array) -> tuple[Array, Array]:
    """By how much the pose of one end effector in the other's axes in states (n, nx) differs from that in the first one: distances (n) [m] and
    angles (n) [rad]."""
    positions, turns = (np.array(v).T for v in grasp_of(robot).map(len(states))(states.T))
    start = lie.quaternion_conjugate(turns[0])
    angles = [np.linalg.norm(lie.quaternion_log(lie.quaternion_multiply(q, start))) for q in turns]
    return np.linalg.norm(positions - positions[0], axis=1), np.array(angles)


def build(settings: TwoArmsSettings, seed: int) -> Scenario:
    """One run; the object is grasped when the path begins, with the end effectors where they are then."""
    robot = load_robot(settings.robot)
    grasp_of(robot)  # a robot with one arm is rejected before anything is compiled
    mpc, since = holding_mpc(settings, robot), settings.settle_time
    pose = mpc.reference["end_effector"].at(0.0)
    reference, end = timed(
        settings.path.curve(robot, pose[:3], pose[3:]), settings.path.speed, settings.path.ramp, since
    )
    follow(robot, mpc, reference)

    def held(log: Log) -> tuple[Array, Array, Array]:
        t = log.times("state")
        use = t >= min(since, t[-1])
        return t[use], *grasp_errors(robot, log.array("state")[use])

    def metrics(log: Log) -> dict[str, Metric]:
        _, off, turned = held(log)
        goal = 2e-3 if settings.plant.kind == "mujoco" else 5e-5
        return {
            "grasp_error_mean": Metric(float(off.mean()), "m"),
            "grasp_error_max": Metric(float(off.max()), "m", goal=goal),
            "grasp_rotation_max": Metric(float(turned.max()), "rad"),
        }

    def plots(log: Log) -> list[Plot]:
        t, off, _ = held(log)
        return [Plot("Grasp error", "time [s]", "error [mm]", [Series("between the end effectors", t, 1e3 * off)])]

    hooks = Hooks(metrics=metrics, plots=plots)
    scenario = closed_loop(robot, mpc, end + 1.0, seed, settings, since=since, hooks=hooks)
    return replace(scenario, idealizations=[*scenario.idealizations, IDEALIZATION])


EXPERIMENT = Experiment.of(
    "two-arms",
    "two end effectors carry one object along a path while the base drives",
    TwoArmsSettings,
    build,
    DEFINITIONS,
)

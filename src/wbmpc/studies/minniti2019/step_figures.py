"""What `rezero-steps` measures and draws."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from wbmpc import lie
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.result import Metric, Plot, Series
from wbmpc.studies.minniti2019.metrics import count_wheels, estimated_end_effector, estimated_end_effector_rotation
from wbmpc.studies.minniti2019.step_goals import STEADY, STEPS

if TYPE_CHECKING:
    from wbmpc.studies.minniti2019.steps import RezeroStepsSettings, Schedule

EULER = ("yaw", "pitch", "roll")
#: Goal of the steady orientation [rad], and why it is missed where the robot's masses are not those of its model.
TURN_GOAL = float(np.deg2rad(0.5))
ROLL = (
    "the roll about the forearm is part of it, which an arm with yaw and two pitch joints cannot turn: a robot whose center of "
    "mass is beside its plane leans to balance; '_arm_' is without it"
)


def progress_of(step: int, log: Log, schedule: Schedule, use: np.ndarray) -> np.ndarray:
    """How much of a step is done: 0 before, 1 after it; from where the end effector was asked to be before."""
    i = step + 1
    previous, after = schedule.positions[i - 1], schedule.positions[i]
    if np.linalg.norm(after - previous) > 1e-6:
        way = after - previous
        return (log.array("hand")[use] - previous) @ way / (way @ way)
    rotations = [
        lie.quaternion_multiply(lie.quaternion_conjugate(schedule.quaternions[i - 1]), q)
        for q in log.array("hand_quaternion")[use]
    ]
    whole = lie.quaternion_log(
        lie.quaternion_multiply(lie.quaternion_conjugate(schedule.quaternions[i - 1]), schedule.quaternions[i])
    )
    return np.array([lie.quaternion_log(q) for q in rotations]) @ whole / (whole @ whole)


def _orientation_error(turns: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Mean rotation vector (3) [rad], end effector axes, from a wanted quaternion (4) to those of the end effector (n, 4)."""
    inverse = lie.quaternion_conjugate(target)
    errors = [lie.quaternion_log(lie.quaternion_multiply(inverse, q)) for q in turns]
    return np.asarray(np.mean(errors, axis=0))


def rise_time(t: np.ndarray, done: np.ndarray) -> float:
    """Time from 10 to 90 % [s]; infinite if it never gets there."""
    low, high = np.flatnonzero(done > 0.1), np.flatnonzero(done > 0.9)
    return float(t[high[0]] - t[low[0]]) if low.size and high.size else float("inf")


def metrics(log: Log, schedule: Schedule, settings: RezeroStepsSettings, fell: bool) -> dict[str, Metric]:
    t, end_effector, torque = log.times("hand"), log.array("hand"), log.array("torque")
    wheels = count_wheels(log.array("state"), torque)
    felt, true_turn, felt_turn = (
        estimated_end_effector(log),
        log.array("hand_quaternion"),
        estimated_end_effector_rotation(log),
    )
    rises, steady, world, turned, turned_world = [], [], [], [], []
    norm = lambda vector: float(np.linalg.norm(vector))
    lead = settings.lead
    for k in range(len(STEPS)):
        start, end = schedule.times[k + 1], schedule.times[k + 1] + settings.hold_time
        if t[-1] < end - 0.1:
            continue
        window = (t >= start - lead) & (t < end)
        rises.append(rise_time(t[window], progress_of(k, log, schedule, window)))
        # an end effector that leaves for the next pose before it is asked to, as with a preview, is early
        last = (t >= end - STEADY) & (t < end)
        steady.append(float(np.linalg.norm(felt[last] - schedule.positions[k + 1], axis=1).mean()))
        world.append(float(np.linalg.norm(end_effector[last] - schedule.positions[k + 1], axis=1).mean()))
        turned.append(_orientation_error(felt_turn[last], schedule.quaternions[k + 1]))
        turned_world.append(_orientation_error(true_turn[last], schedule.quaternions[k + 1]))
    start = schedule.times[len(STEPS) + 1]
    roll = (t >= start + settings.hold_time - STEADY) & (t < start + settings.hold_time)
    impossible = schedule.quaternions[len(STEPS) + 1]
    unreachable = norm(_orientation_error(true_turn[roll], impossible)) if roll.any() else float("inf")
    worst = lambda values: max(values) if values else float("inf")
    return {
        "rise_time_max": Metric(worst(rises), "s", goal=1.0),
        "steady_position_error_max": Metric(worst(steady), "m"),
        "steady_position_error_world_max": Metric(worst(world), "m", goal=0.005),
        "steady_orientation_error_max": Metric(worst([norm(v) for v in turned]), "rad", goal=TURN_GOAL, goal_note=ROLL),
        "steady_orientation_error_arm_max": Metric(worst([norm(v[:2]) for v in turned]), "rad", goal=TURN_GOAL),
        "steady_orientation_error_world_max": Metric(worst([norm(v) for v in turned_world]), "rad"),
        "unreachable_rotation_error": Metric(unreachable, "rad"),
        "tilt_max": Metric(float(log.array("tilt").max()), "rad"),
        "wheel_torque_max": Metric(float(np.abs(torque[:, :wheels]).max()), "N m"),
        "fell": Metric(float(fell), "1", goal=0.0),
    }


def _turns(log: Log, schedule: Schedule) -> Plot:
    """The end effector's rotation vector against home, in world axes (Euler angles, as the paper has them, are singular there)."""
    thin = slice(None, None, 8)
    t, home = log.times("hand_quaternion")[thin], lie.quaternion_conjugate(schedule.quaternions[0])
    vector = lambda q: np.rad2deg(lie.quaternion_log(lie.quaternion_multiply(q, home)))
    is_ = np.array([vector(q) for q in log.array("hand_quaternion")[thin]])
    target = np.array([vector(q) for q in schedule.quaternions])[[schedule.at(v) for v in t]]
    lines = [Series(f"about {n}", t, is_[:, i]) for i, n in enumerate("xyz")]
    goals = [Series(f"about {n}, reference", t, target[:, i], dashed=True) for i, n in enumerate("xyz")]
    return Plot(
        "End effector orientation against home and its reference (Fig. 4)", "time [s]", "angle [°]", [*lines, *goals]
    )


def plots(log: Log, schedule: Schedule, robot: RobotModel) -> list[Plot]:
    t, end_effector, state, torque = log.times("hand"), log.array("hand"), log.array("state"), log.array("torque")
    target = schedule.positions[[schedule.at(v) for v in t]]
    limit = robot.limits.input_upper[: torque.shape[1]]
    lines = [Series(n, t, end_effector[:, i]) for i, n in enumerate("xyz")]
    goals = [Series(f"{n}, reference", t, target[:, i], dashed=True) for i, n in enumerate("xyz")]
    velocity = robot.state["arm_velocity"]
    ratio = np.abs(state[:, velocity]) / robot.limits.state_upper[velocity]
    degrees = np.rad2deg(state[:, 2:5])
    return [
        Plot("End effector position and its reference (Fig. 4)", "time [s]", "position [m]", [*lines, *goals]),
        _turns(log, schedule),
        Plot("End effector position error", "time [s]", "error [mm]", [Series("error", t, 1e3 * np.linalg.norm(end_effector - target, axis=1))]),
        Plot("Ball path", "x [m]", "y [m]", [Series("ball", state[:, 0], state[:, 1])], equal_axes=True),
        Plot("Base orientation", "time [s]", "angle [°]", [Series(n, t, degrees[:, i]) for i, n in enumerate(EULER)]),
        Plot("Torques over their limits", "time [s]", "|torque| / limit [%]", [
            Series(n, t, 100 * np.abs(torque[:, i]) / limit[i]) for i, n in enumerate(robot.input.names[: torque.shape[1]])
        ]),
        Plot("Arm speeds over their limits", "time [s]", "|speed| / limit [%]", [
            Series(n, t, 100 * ratio[:, i]) for i, n in enumerate(robot.state.groups["arm_velocity"])
        ]),
        Plot("Estimated disturbance", "time [s]", "generalized force [N, N m]", [
            Series(n, t, log.array("disturbance")[:, i]) for i, n in enumerate(robot.parameters.groups["disturbance"])
        ]),
    ]  # fmt: skip

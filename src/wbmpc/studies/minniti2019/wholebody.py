"""`rezero-wholebody`: the end effector goes around a square with a load while the ball stays (Minniti et al. 2019, Fig. 6 and 7)."""

from __future__ import annotations

import itertools

import numpy as np
from pydantic import Field

from wbmpc.bases.ball.model import ball_base
from wbmpc.experiment import Experiment, Scenario
from wbmpc.log import Log
from wbmpc.ocp import Reference
from wbmpc.result import Metric, Plot, Series
from wbmpc.simulation.lockstep import Ending
from wbmpc.studies.minniti2019.controller_settings import Regulator
from wbmpc.studies.minniti2019.definitions import DEFINITIONS
from wbmpc.studies.minniti2019.metrics import common_plots, estimated_ball, estimated_end_effector, rms
from wbmpc.studies.minniti2019.settings import AccurateSettings
from wbmpc.studies.minniti2019.task import Task, ball_robot, bent_arm, reaching, task_scenario

NAME = "rezero-wholebody"
SUMMARY = "the end effector carries 1 kg around a square while the ball stays (Minniti et al. 2019, Fig. 6)"
#: Corners [m] from home, sideways and up.
CORNERS = np.array(
    [[0.0, 0.0, 0.0], [0.0, 0.125, 0.0], [0.0, 0.125, 0.25], [0.0, -0.125, 0.25], [0.0, -0.125, 0.0], [0.0, 0.0, 0.0]]
)
#: The last second of every hold is judged as steady [s].
STEADY = 1.0
#: The share of the feedback in a torque below this [N m] is that in one of this.
MIN_TORQUE = 0.5
IDEALIZATIONS = ["the load is unknown to the controller"]


class RezeroWholebodySettings(AccurateSettings):
    """``move_time`` [s]: time from corner to corner; ``hold_time`` [s]: time at a corner; ``settle_time`` [s]: time at home before the task."""

    payload: float = Field(1.0, ge=0, le=5.0)
    move_time: float = Field(1.5, gt=0, le=60.0)
    hold_time: float = Field(3.5, ge=STEADY, le=60.0)
    settle_time: float = Field(8.0, ge=0.5, le=60.0)


def end_effector_path(settings: RezeroWholebodySettings, home: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Times (n,) [s] and positions (n, 3) [m] of the end effector: straight lines at constant speed, and holds."""
    times, places, t = [0.0], [home], settings.settle_time
    for previous, after in itertools.pairwise(CORNERS):
        times += [t, t + settings.move_time]
        places += [home + previous, home + after]
        t += settings.move_time + settings.hold_time
    return np.array(times), np.array(places)


def build(settings: RezeroWholebodySettings, seed: int) -> Scenario:
    """One run."""
    robot = ball_robot(settings)
    arm, wheels = bent_arm(settings, robot), len(robot.input.groups["wheel"])
    second = wheels + min(1, arm.size - 1)  # of the arm's joints, if it has two
    home = ball_base(robot).numeric.equilibrium(arm)[0]
    position, quaternion = robot.pose(home)
    times, places = end_effector_path(settings, position)
    ends = settings.settle_time + (settings.move_time + settings.hold_time) * np.arange(len(CORNERS))

    def target(t: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(t, times, places[:, i]) for i in range(3)], axis=1)

    def metrics(log: Log, ending: Ending) -> dict[str, Metric]:
        t, torque = log.times("state"), log.array("torque")
        use, end_effector = t >= settings.settle_time, estimated_end_effector(log) - target(t)
        away = np.linalg.norm(log.array("hand") - target(t), axis=1)
        steady = [(t >= end - STEADY) & (t < end) & (t[-1] > end - 0.1) for end in ends]
        mean = lambda values: max(float(np.linalg.norm(values[w].mean(axis=0))) if w.any() else np.inf for w in steady)
        share = (
            np.sqrt(np.mean(log.array("feedback")[use, second] ** 2) / np.mean(torque[use, second] ** 2))
            if use.any()
            else np.inf
        )
        return {
            # the whole run, in which the load is weighed
            "ball_error_rms_world": Metric(rms(log.array("state")[:, :2]), "m", goal=0.010),
            "ball_error_rms_wholebody": Metric(rms(estimated_ball(log)), "m"),
            "hand_error_max_world": Metric(float(away.max()), "m", goal=0.020),
            "hand_error_rms": Metric(rms(end_effector), "m"),
            "steady_hand_error_max": Metric(mean(end_effector), "m", goal=0.005),
            "steady_hand_error_world_max": Metric(mean(log.array("hand") - target(t)), "m"),
            "steady_ball_offset_max": Metric(mean(estimated_ball(log)), "m", goal=0.010),
            "feedback_share": Metric(float(share), "1", goal=0.15),
            "tilt_max": Metric(float(log.array("tilt").max()), "rad"),
            "fell": Metric(float(ending.fell), "1", goal=0.0),
        }

    def plots(log: Log) -> list[Plot]:
        t, torque, feedback = log.times("state"), log.array("torque"), log.array("feedback")
        joint = Plot("Torque of the second arm joint (Fig. 7, above)", "time [s]", "torque [N m]", [
            Series("whole", t, torque[:, second]), Series("feedforward", t, torque[:, second] - feedback[:, second]),
            Series("feedback", t, feedback[:, second]),
        ])  # fmt: skip
        share = 100.0 * np.abs(feedback[:, second]) / np.maximum(np.abs(torque[:, second]), MIN_TORQUE)
        ratio = Plot(
            "Feedback over the whole torque (Fig. 7, below)", "time [s]", "share [%]", [Series("share", t, share)]
        )
        return [*common_plots(log, target(t), np.zeros(2)), joint, ratio]

    references = {"end_effector": Reference.poses(times, places, quaternion)}
    if isinstance(settings.controller, Regulator):
        grid = np.arange(0.0, float(ends[-1]), 0.05)
        references["body"] = reaching(robot, grid, np.zeros((grid.size, 2)), target(grid), home)
    task = Task(arm, float(ends[-1]), references)
    return task_scenario(settings, seed, task, metrics, plots, IDEALIZATIONS)


EXPERIMENT = Experiment.of(NAME, SUMMARY, RezeroWholebodySettings, build, DEFINITIONS[NAME])

"""`rezero-circle`: the ball drives a circle while the end effector stays where it is (Minniti et al. 2019, video)."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from wbmpc.bases.ball.model import ball_base
from wbmpc.experiment import Experiment, Scenario
from wbmpc.log import Log
from wbmpc.ocp import Reference
from wbmpc.result import Metric, Plot
from wbmpc.simulation.lockstep import Ending
from wbmpc.studies.minniti2019.controller_settings import Regulator
from wbmpc.studies.minniti2019.definitions import DEFINITIONS
from wbmpc.studies.minniti2019.metrics import common_plots, estimated_ball, estimated_end_effector, rms
from wbmpc.studies.minniti2019.settings import AccurateSettings
from wbmpc.studies.minniti2019.task import Task, ball_robot, bent_arm, reaching, task_scenario

NAME = "rezero-circle"
SUMMARY = "the ball drives a circle while the end effector stays still (Minniti et al. 2019, video)"
IDEALIZATIONS = ["the end effector's orientation is free but for a small weight: three joints hold its position"]


class RezeroCircleSettings(AccurateSettings):
    """``radius`` [m]: radius of the circle; ``lap_time`` [s]: duration of a round; ``rounds``: number of rounds, the first of which
    starts from rest; ``settle_time`` [s]: at rest before it. With ``controller.cost.body.yaw=0`` the heading of the base is free."""

    radius: float = Field(0.15, gt=0, le=1.0)
    lap_time: float = Field(6.0, ge=1.0, le=60.0)
    rounds: int = Field(3, ge=1, le=50)
    settle_time: float = Field(3.0, ge=0.5, le=60.0)


def ball_path(settings: RezeroCircleSettings, times: np.ndarray) -> np.ndarray:
    """Ball positions (n, 2) [m] round a center on its left: it starts and ends at rest, a second each of constant angular
    acceleration, in between at constant speed."""
    rate, total = 2.0 * np.pi / settings.lap_time, 2.0 * np.pi * settings.rounds
    end = settings.settle_time + total / rate + 1.0
    t = np.clip(times, settings.settle_time, end) - settings.settle_time
    last = end - settings.settle_time
    angle = np.where(t < 1.0, 0.5 * rate * t**2, rate * (t - 0.5))
    angle = np.where(t > last - 1.0, total - 0.5 * rate * (last - t) ** 2, angle)
    return settings.radius * np.stack([np.sin(angle), 1.0 - np.cos(angle)], axis=1)


def build(settings: RezeroCircleSettings, seed: int) -> Scenario:
    """One run."""
    robot = ball_robot(settings)
    arm = bent_arm(settings, robot)
    home = ball_base(robot).numeric.equilibrium(arm)[0]
    duration = settings.settle_time + settings.rounds * settings.lap_time + 3.0
    grid = np.arange(0.0, duration + settings.controller.ahead, 0.01)
    body = np.tile(home, (grid.size, 1))
    body[:, :2] = ball_path(settings, grid)
    velocity = robot.state["base_velocity"].start
    body[:, velocity : velocity + 2] = np.gradient(body[:, :2], grid, axis=0)
    end_effector = robot.pose(home)[0]

    def metrics(log: Log, ending: Ending) -> dict[str, Metric]:
        t = log.times("state")
        use = t >= settings.settle_time
        target = ball_path(settings, t)
        return {
            "hand_error_rms_world": Metric(rms((log.array("hand") - end_effector)[use]), "m", goal=0.005),
            "hand_error_rms": Metric(rms((estimated_end_effector(log) - end_effector)[use]), "m"),
            "ball_error_rms_world": Metric(rms((log.array("state")[:, :2] - target)[use]), "m"),
            "ball_error_rms": Metric(rms((estimated_ball(log) - target)[use]), "m"),
            "tilt_max": Metric(float(log.array("tilt").max()), "rad"),
            "fell": Metric(float(ending.fell), "1", goal=0.0),
        }

    def plots(log: Log) -> list[Plot]:
        return common_plots(log, end_effector, ball_path(settings, log.times("state")))

    reference = Reference(grid, body)
    if isinstance(settings.controller, Regulator):
        times = np.arange(0.0, grid[-1], 0.05)
        places = ball_path(settings, times)
        reference = reaching(robot, times, places, np.tile(end_effector, (times.size, 1)), home)
    task = Task(arm, duration, {"body": reference})
    return task_scenario(settings, seed, task, metrics, plots, IDEALIZATIONS)


EXPERIMENT = Experiment.of(NAME, SUMMARY, RezeroCircleSettings, build, DEFINITIONS[NAME])

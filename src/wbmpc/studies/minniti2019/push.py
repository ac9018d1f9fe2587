"""`rezero-push-ball` and `rezero-push-hand`: pushes while ball or end effector are held (Minniti et al. 2019, Fig. 5)."""

from __future__ import annotations

import numpy as np

from wbmpc.experiment import Experiment, Scenario
from wbmpc.log import Log
from wbmpc.result import Metric, Plot, Series
from wbmpc.simulation.lockstep import Ending
from wbmpc.studies.minniti2019.definitions import DEFINITIONS
from wbmpc.studies.minniti2019.metrics import common_plots, estimated_end_effector, rms
from wbmpc.studies.minniti2019.push_settings import RECOVERY, RezeroPushBallSettings, RezeroPushHandSettings
from wbmpc.studies.minniti2019.recovery import rest
from wbmpc.studies.minniti2019.task import Push, Task, ball_robot, task_scenario

BALL, HAND = "rezero-push-ball", "rezero-push-hand"
SUMMARY = "the ball robot is pushed while it holds its {} (Minniti et al. 2019, Fig. 5)"
IDEALIZATIONS = ["pushes are exact forces at the base's center of mass"]


def _task(settings: RezeroPushHandSettings, arm: np.ndarray) -> Task:
    pushes, t = [], settings.settle_time
    gap = settings.pause if settings.gap is None else settings.gap
    for force in settings.forces:
        for direction in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)):
            pushes.append(Push(t, settings.push_duration, tuple(force * np.array(direction))))
            t += gap if direction[0] else settings.pause
    return Task(arm, t, pushes=tuple(pushes))


def build(settings: RezeroPushHandSettings, seed: int) -> Scenario:
    """Pushes while ball or end effector are to stay in their place."""
    held = settings.held
    robot = ball_robot(settings)
    task = _task(settings, robot.home[robot.state["arm"]])
    end_effector, ball = robot.pose(robot.home)[0], robot.home[:2]

    def metrics(log: Log, ending: Ending) -> dict[str, Metric]:
        next_push = [*(p.start for p in task.pushes[1:]), task.duration]
        ends = [end for p, end in zip(task.pushes, next_push, strict=True) if end - p.start >= RECOVERY - 1e-9]
        rests = [rest(log, held, end_effector if held == "hand" else ball, end) for end in ends]
        back = [r.recovered for r in rests]
        travel = np.linalg.norm(log.array("state")[:, :2] - ball, axis=1)
        return {
            "not_recovered": Metric(float(len(back) - sum(back)), "1", goal=0.0),
            "recovered": Metric(float(all(back)), "1"),
            "rest_error_max": Metric(max(r.felt for r in rests), "m"),
            "rest_error_world_max": Metric(max(r.world for r in rests), "m"),
            "tilt_max": Metric(float(log.array("tilt").max()), "rad"),
            "ball_travel_max": Metric(float(travel.max()), "m"),
            "hand_error_max": Metric(float(np.linalg.norm(log.array("hand") - end_effector, axis=1).max()), "m"),
            "hand_error_rms": Metric(rms(estimated_end_effector(log) - end_effector), "m"),
            "fell": Metric(float(ending.fell), "1", goal=0.0),
        }

    def plots(log: Log) -> list[Plot]:
        t = log.times("state")
        force = np.sum([np.outer((t >= p.start) & (t < p.start + p.length), p.force) for p in task.pushes], axis=0)
        pushes = Plot("Pushes (Fig. 5, its gray areas)", "time [s]", "force [N]", [
            Series(n, t, force[:, i]) for i, n in enumerate("xy")
        ])  # fmt: skip
        return [*common_plots(log, end_effector, ball), pushes]

    return task_scenario(settings, seed, task, metrics, plots, IDEALIZATIONS)


BALL_EXPERIMENT = Experiment.of(BALL, SUMMARY.format("ball"), RezeroPushBallSettings, build, DEFINITIONS[BALL])
HAND_EXPERIMENT = Experiment.of(HAND, SUMMARY.format("end effector"), RezeroPushHandSettings, build, DEFINITIONS[HAND])

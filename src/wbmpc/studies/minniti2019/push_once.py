"""One push of a ball robot, and what came of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wbmpc.experiment import run_scenario
from wbmpc.log import Log
from wbmpc.result import Metric
from wbmpc.simulation.lockstep import Ending
from wbmpc.studies.minniti2019.push import IDEALIZATIONS
from wbmpc.studies.minniti2019.push_settings import PushSettings
from wbmpc.studies.minniti2019.recovery import rest
from wbmpc.studies.minniti2019.task import Push, Task, ball_robot, task_scenario


@dataclass(frozen=True)
class Outcome:
    """What came of one push: whether the robot ``stands`` at the end, whether it ``recovers`` (:data:`NEAR`), how far the ball was
    from its place at most (``travel`` [m], while it stood)."""

    stands: bool
    recovers: bool
    travel: float


def push_once(settings: PushSettings, seed: int, force: float, direction: float, length: float) -> Outcome:
    """One push of ``force`` [N] along ``direction`` [rad] for ``length`` [s], watched for ``settings.pause`` from its begin on, as
    the experiments do."""
    robot, held = ball_robot(settings), settings.held
    push = Push(1.0, length, tuple(force * np.array([np.cos(direction), np.sin(direction), 0.0])))
    end = push.start + settings.pause
    task = Task(robot.home[robot.state["arm"]], end, pushes=(push,))
    place = robot.pose(robot.home)[0] if held == "hand" else robot.home[:2]

    def figures(log: Log, ending: Ending) -> dict[str, Metric]:
        travel = np.linalg.norm(log.array("state")[:, :2] - robot.home[:2], axis=1)
        recovered = not ending.reason and rest(log, held, place, end).recovered
        return {"recovered": Metric(float(recovered), "1"), "travel": Metric(float(travel.max()), "m")}

    build = lambda s, k: task_scenario(s, k, task, figures, lambda log: [], IDEALIZATIONS)
    result = run_scenario("rezero-push", build, settings, seed)
    if not result.metrics:
        return Outcome(False, False, float("inf"))
    found = result.metrics
    return Outcome(result.completed, result.completed and found["recovered"].value > 0.0, found["travel"].value)

"""`goals`: the end effector of any robot goes to random goals that it can reach, one after the other."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from wbmpc.arrays import Array
from wbmpc.errors import InputError
from wbmpc.experiment import Experiment, Scenario
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.obstacles.floor import floor_boxes, heights
from wbmpc.ocp import Reference
from wbmpc.result import Metric
from wbmpc.settings import Positive
from wbmpc.tasks.arm_reach import own_rows
from wbmpc.tasks.definitions import DEFINITIONS
from wbmpc.tasks.loop import Hooks, closed_loop
from wbmpc.tasks.path_settings import follow
from wbmpc.tasks.settings import TaskSettings

#: Postures that are drawn for a goal until one keeps the pairs of ``collision.self.pairs`` apart.
DRAWS = 1000
Way = Annotated[float, Field(ge=0, le=1000)]


class GoalsSettings(TaskSettings):
    """``count``: number of goals; ``time_per_goal`` [s]: time from one goal to the next; ``distance`` [m]: least and largest from one
    goal to the next, of a base that moves; ``posture``: how far arm joints are from home, as a share of the way to their stops;
    ``tolerance`` [m]: within which a goal is reached."""

    count: int = Field(4, ge=1, le=1000)
    time_per_goal: float = Field(10.0, gt=0, le=600)
    distance: tuple[Way, Way] = (1.0, 2.0)
    posture: float = Field(0.2, ge=0, le=0.9)
    tolerance: Positive = 0.005


def random_states(robot: RobotModel, settings: GoalsSettings, seed: int) -> Array:
    """States (count, nx): the base further by a random way, the arm about its home, where it is clear of the robot and
    of the floor."""
    rng, arm = np.random.default_rng([seed, 20]), robot.state["arm"]
    pairs = own_rows(robot)
    boxes = list(floor_boxes(robot))
    kept = np.array([box.margin for box in boxes])
    low, high = robot.limits.state_lower[arm], robot.limits.state_upper[arm]
    home = robot.home[arm]
    low, high = np.where(np.isfinite(low), low, home - np.pi), np.where(np.isfinite(high), high, home + np.pi)
    low, high = np.maximum(low, home - np.pi), np.minimum(high, home + np.pi)
    states, at = np.tile(robot.home, (settings.count, 1)), np.zeros(2)
    for row in states:
        for _ in range(DRAWS):
            share = settings.posture * rng.uniform(-1.0, 1.0, home.size)
            row[arm] = home + np.where(share > 0.0, share * (high - home), share * (home - low))
            apart = pairs is None or (pairs.measure(row[None]) >= pairs.margins).all()
            if apart and (not boxes or (heights(robot, boxes, row[None])[0] >= kept).all()):
                break
        else:
            raise InputError(
                f"goals: none of {DRAWS} postures keeps the arm clear of the robot and the floor; valid: a smaller posture"
            )
        if "base" in robot.state:
            heading, way = rng.uniform(-np.pi, np.pi), rng.uniform(min(settings.distance), max(settings.distance))
            at = at + way * np.array([np.cos(heading), np.sin(heading)])
            start = robot.state["base"].start
            row[start : start + 2] += at
            row[start + 2] += rng.uniform(-1.0, 1.0)
    return states


def build(settings: GoalsSettings, seed: int) -> Scenario:
    """One run: a goal is reached if the error, by the estimate, is within the tolerance for the last half second of its time."""
    robot, mpc = settings.prepare()
    goals = robot.poses(random_states(robot, settings, seed))
    times = settings.settle_time + settings.time_per_goal * np.arange(float(settings.count))
    waiting = list(zip(times, goals, strict=True))

    def tick(t: float) -> None:
        """A goal that comes now: plans do not see it before."""
        if waiting and t >= waiting[0][0] - 1e-9:
            pose = waiting.pop(0)[1]
            follow(robot, mpc, Reference.poses([t], pose[:3], pose[3:], hold=True))

    end = settings.settle_time + settings.count * settings.time_per_goal

    def metrics(log: Log) -> dict[str, Metric]:
        errors = final_errors(log, times, settings.time_per_goal)
        reached = float(np.sum(errors <= settings.tolerance))
        return {
            "goals_reached": Metric(reached, "1", least=float(settings.count)),
            "goal_error_max": Metric(float(errors.max()), "m", goal=settings.tolerance),
        }

    return closed_loop(
        robot, mpc, end, seed, settings, since=settings.settle_time, hooks=Hooks(tick=tick, metrics=metrics), reshape=True
    )  # fmt: skip


def final_errors(log: Log, times: Array, length: float) -> Array:
    """Largest error [m] in the last half second of each goal; infinite for goals that the run did not come to."""
    t = log.times("end_effector")
    error = np.linalg.norm(log.array("end_effector_estimated") - log.array("end_effector_reference"), axis=1)
    parts = [error[(t >= start + length - 0.5) & (t < start + length)] for start in times]
    return np.array([part.max() if part.size else np.inf for part in parts])


EXPERIMENT = Experiment.of(
    "goals", "the end effector of any robot goes to random goals that it can reach", GoalsSettings, build, DEFINITIONS
)

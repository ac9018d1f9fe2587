"""`rezero-push-ball` and `rezero-push-hand`: pushes while ball or hand are held (Minniti et al. 2019, Fig. 5)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from wbmpc.bases.ball.defaults import RezeroCost
from wbmpc.bases.ball.settings import STEPS_AND_PUSHES
from wbmpc.checks import whole
from wbmpc.experiments import Experiment
from wbmpc.log import Log
from wbmpc.result import Metric, Plot, RunResult, Series
from wbmpc.simulation.lockstep import Ending, Progress
from wbmpc.studies.minniti2019.task import (
    Push,
    RezeroSettings,
    Task,
    ball_felt,
    ball_robot,
    common_plots,
    hand_felt,
    rms,
    run_task,
)

BALL, HAND = "rezero-push-ball", "rezero-push-hand"
SUMMARY = "the ball robot is pushed while it holds its {} (Minniti et al. 2019, Fig. 5)"
IDEALISATIONS = ["pushes are exact forces at the base's centre of mass"]
#: Recovered: in the last half second before the next push ball or hand are nearer than this [m] to their place as the robot knows
#: it, and do not move farther than this in the world. (Wheels that slipped moved the robot's world; one that runs away, or swings
#: its arm about, has not recovered, wherever it believes to be.)
NEAR, LAST = 0.05, 0.5


class RezeroPushSettings(RezeroSettings):
    """``forces`` [N], each along x and then along y, for ``length`` [s], whole controller periods; ``pause`` [s] from one push to
    the next."""

    forces: tuple[Annotated[float, Field(ge=0, le=5000.0)], ...] = Field((50.0, 100.0, 200.0), min_length=1)
    length: float = Field(0.2, gt=0, le=5.0)
    pause: float = Field(7.0, ge=2.0, le=60.0)
    settle: float = Field(3.0, ge=0.5, le=60.0)

    @model_validator(mode="after")
    def _whole_periods(self) -> Self:
        whole("length", self.length, 1.0 / self.control.rate, "controller periods")
        return self

    @model_validator(mode="after")
    def _one_after_the_other(self) -> Self:
        if self.pause < self.length + LAST:
            raise ValueError(
                f"pause: {self.pause:g} s from one push to the next, which are {self.length:g} s long and judged by the last "
                f"{LAST:g} s; at least {self.length + LAST:g} s are needed"
            )
        return self


class RezeroPushBallSettings(RezeroPushSettings):
    """The ball is held and, of the hand, only its orientation (the paper's first task); otherwise the same weights."""

    cost: RezeroCost = STEPS_AND_PUSHES.model_copy(
        update={
            "hand": STEPS_AND_PUSHES.hand.model_copy(update={"weight": 0.0}),
            "body": STEPS_AND_PUSHES.body.model_copy(update={"ball": 10.0}),
        }
    )


class RezeroPushHandSettings(RezeroPushSettings):
    """The hand is held: the weights of the steps."""


@dataclass(frozen=True)
class Rest:
    """How ball or hand are for the last :data:`LAST` [s] before some time: farthest from their place as the robot knows it
    (``felt``) and in the ``world``, and how far they move in the world (``moves``) [m]; infinite if the run had ended by then."""

    felt: float = np.inf
    world: float = np.inf
    moves: float = np.inf

    @property
    def recovered(self) -> bool:
        """Back in its place and at rest, see :data:`NEAR`."""
        return max(self.felt, self.moves) < NEAR


def rest(log: Log, held: str, place: np.ndarray, end: float) -> Rest:
    """Before ``end`` [s]: of the ball, with ``place`` (2) [m], or of the hand, with ``place`` (3)."""
    t = log.times("state")
    window = (t >= end - LAST) & (t < end)
    if not window.any() or t[-1] < end - 0.1:
        return Rest()
    felt = (hand_felt(log) if held == "hand" else ball_felt(log))[window]
    world = (log.array("hand") if held == "hand" else log.array("state")[:, :2])[window]
    most = lambda away: float(np.linalg.norm(away, axis=1).max())
    return Rest(most(felt - place), most(world - place), most(world - world[-1]))


def _task(settings: RezeroPushSettings, arm: np.ndarray) -> Task:
    pushes, t = [], settings.settle
    for force in settings.forces:
        for direction in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)):
            pushes.append(Push(t, settings.length, tuple(force * np.array(direction))))
            t += settings.pause
    return Task(arm, t, pushes=tuple(pushes))


def _run(name: str, held: str, settings: RezeroPushSettings, seed: int, progress: Progress | None) -> RunResult:
    robot = ball_robot(settings)
    task = _task(settings, robot.home[robot.state["arm"]])
    hand, ball = robot.pose(robot.home)[0], robot.home[:2]

    def metrics(log: Log, ending: Ending) -> dict[str, Metric]:
        rests = [rest(log, held, hand if held == "hand" else ball, p.start + settings.pause) for p in task.pushes]
        back = [r.recovered for r in rests]
        travel = np.linalg.norm(log.array("state")[:, :2] - ball, axis=1)
        return {
            "not_recovered": Metric(float(len(back) - sum(back)), "1", goal=0.0),
            "recovered": Metric(float(all(back)), "1"),
            "rest_error_max": Metric(max(r.felt for r in rests), "m"),
            "rest_error_world_max": Metric(max(r.world for r in rests), "m"),
            "tilt_max": Metric(float(log.array("tilt").max()), "rad"),
            "ball_travel_max": Metric(float(travel.max()), "m"),
            "hand_error_max": Metric(float(np.linalg.norm(log.array("hand") - hand, axis=1).max()), "m"),
            "hand_error_rms": Metric(rms(hand_felt(log) - hand), "m"),
            "fell": Metric(float(ending.fell), "1", goal=0.0),
        }

    def plots(log: Log) -> list[Plot]:
        t = log.times("state")
        force = np.sum([np.outer((t >= p.start) & (t < p.start + p.length), p.force) for p in task.pushes], axis=0)
        pushes = Plot("Pushes (Fig. 5, its grey areas)", "time [s]", "force [N]", [
            Series(n, t, force[:, i]) for i, n in enumerate("xy")
        ])  # fmt: skip
        return [*common_plots(log, hand, ball), pushes]

    return run_task(name, settings, seed, task, metrics, plots, IDEALISATIONS, progress)


def run_ball(settings: RezeroPushBallSettings, seed: int, progress: Progress | None = None) -> RunResult:
    """Pushes while the ball is held."""
    return _run(BALL, "ball", settings, seed, progress)


def run_hand(settings: RezeroPushHandSettings, seed: int, progress: Progress | None = None) -> RunResult:
    """Pushes while the hand is held."""
    return _run(HAND, "hand", settings, seed, progress)


@dataclass(frozen=True)
class Outcome:
    """What came of one push: whether the robot ``stands`` at the end, whether it ``recovers`` (:data:`NEAR`), how far the ball was
    from its place at most (``travel`` [m], while it stood)."""

    stands: bool
    recovers: bool
    travel: float


def push_once(settings: RezeroPushSettings, seed: int, force: float, direction: float, length: float) -> Outcome:
    """One push of ``force`` [N] along ``direction`` [rad] for ``length`` [s], watched for ``settings.pause`` from its begin on, as
    the experiments do."""
    robot, held = ball_robot(settings), "ball" if isinstance(settings, RezeroPushBallSettings) else "hand"
    push = Push(1.0, length, tuple(force * np.array([np.cos(direction), np.sin(direction), 0.0])))
    end = push.start + settings.pause
    task = Task(robot.home[robot.state["arm"]], end, pushes=(push,))
    place = robot.pose(robot.home)[0] if held == "hand" else robot.home[:2]

    def figures(log: Log, ending: Ending) -> dict[str, Metric]:
        travel = np.linalg.norm(log.array("state")[:, :2] - robot.home[:2], axis=1)
        recovered = not ending.reason and rest(log, held, place, end).recovered
        return {"recovered": Metric(float(recovered), "1"), "travel": Metric(float(travel.max()), "m")}

    result = run_task("rezero-push", settings, seed, task, figures, lambda log: [], IDEALISATIONS)
    if not result.metrics:
        return Outcome(False, False, float("inf"))
    found = result.metrics
    return Outcome(result.completed, result.completed and found["recovered"].value > 0.0, found["travel"].value)


BALL_EXPERIMENT = Experiment(BALL, SUMMARY.format("ball"), RezeroPushBallSettings, run_ball)
HAND_EXPERIMENT = Experiment(HAND, SUMMARY.format("hand"), RezeroPushHandSettings, run_hand)

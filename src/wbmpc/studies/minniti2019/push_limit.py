"""`rezero-push-limit-ball` and `-hand`: the impulse from which the ball robot still recovers, or after which it still stands, in one
direction. A push map is a study of it over directions, lengths and controllers.

To stand is no recovery: a robot that rolls away forever, or swings its arm between the stops, stands. It recovers if it is back in
its place, and rests there, when the push experiments would push it again (:data:`wbmpc.studies.minniti2019.recovery.NEAR`).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from wbmpc.experiment import Experiment, defined
from wbmpc.log import Log
from wbmpc.result import Metric, Plot, RunResult, Series
from wbmpc.simulation.lockstep import Progress
from wbmpc.studies.minniti2019.controller_settings import HELD_MPC, HeldController
from wbmpc.studies.minniti2019.definitions import DEFINITIONS
from wbmpc.studies.minniti2019.push import IDEALIZATIONS
from wbmpc.studies.minniti2019.push_once import Outcome, push_once
from wbmpc.studies.minniti2019.push_settings import PushSettings

#: Largest impulse [N s] that is tried.
MAXIMUM = 320.0
SUMMARY = "the impulse from which the ball robot recovers while it holds its {}, in one direction"


class HandLimitSettings(PushSettings):
    """The end effector is held.

    ``direction`` [deg]: of the pushes, which come after 1 s; ``push_duration`` [s]: of each; ``criterion``: what is asked of the
    robot; ``resolution`` [N s]: the bisection ends at it."""

    direction: float = Field(0.0, ge=-360, le=360)
    criterion: Literal["recovers", "stands"] = "recovers"
    resolution: float = Field(5.0, gt=0, ge=0.1, le=MAXIMUM)


class BallLimitSettings(HandLimitSettings):
    """The ball is held: the weights of `rezero-push-ball`."""

    held: ClassVar[str] = "ball"
    controller: HeldController = HELD_MPC


def largest(passes: Callable[[float], bool], resolution: float) -> float:
    """The largest impulse [N s] that passes, of those that are tried, below the smallest that fails: a bisection to ``resolution``;
    what passes beyond a failure does not count. :data:`MAXIMUM` where that passes."""
    low, high = 0.0, MAXIMUM
    if passes(MAXIMUM):
        return MAXIMUM
    while high - low > resolution:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if passes(middle) else (low, middle)
    return low


def run(name: str, settings: HandLimitSettings, seed: int, progress: Progress | None = None) -> RunResult:
    """All pushes of a bisection."""
    tried: list[Outcome] = []
    impulses: list[float] = []
    passed: list[bool] = []
    maximum = np.log2(MAXIMUM / settings.resolution) + 2.0
    force = lambda impulse: impulse / settings.push_duration

    def passes(impulse: float) -> bool:
        angle = float(np.deg2rad(settings.direction))
        tried.append(push_once(settings, seed, force(impulse), angle, settings.push_duration))
        if progress is not None:
            progress(min(len(tried) / maximum, 1.0), f"{impulse:.0f} N s")
        impulses.append(impulse)
        passed.append(bool(getattr(tried[-1], settings.criterion)))
        return passed[-1]

    impulse = largest(passes, settings.resolution)
    travel = max((o.travel for o in tried if o.recovers), default=0.0)
    metrics = {
        "impulse_max": Metric(impulse, "N s"), "ball_travel_max": Metric(travel, "m"), "pushes": Metric(float(len(tried)), "1"),
    }  # fmt: skip
    found = defined(name, metrics, DEFINITIONS[name])
    plots = [_plot(np.array(impulses), np.array(passed), settings.criterion)]
    plain = settings.model_dump(mode="json")
    return RunResult(name, seed, True, "", found, None, Log(), plots, idealizations=IDEALIZATIONS, settings=plain)


def _plot(impulses: np.ndarray, passed: np.ndarray, criterion: str) -> Plot:
    """The impulses [N s] tried, one after the other, and what the bisection knew after each."""
    number = np.arange(1.0, len(impulses) + 1.0)
    largest_passed = np.maximum.accumulate(np.where(passed, impulses, 0.0))
    smallest_failed = np.minimum.accumulate(np.where(passed, np.inf, impulses))
    lines = {"tried": impulses, f"robot {criterion}": largest_passed, "robot does not": smallest_failed}
    return Plot("Impulses tried", "push", "impulse [N s]", [Series(n, number, y) for n, y in lines.items()])


def _experiment(kind: type[HandLimitSettings]) -> Experiment:
    name = f"rezero-push-limit-{kind.held}"
    return Experiment(
        name,
        SUMMARY.format("ball" if kind.held == "ball" else "end effector"),
        kind,
        partial(run, name),
        DEFINITIONS[name],
    )


BALL_EXPERIMENT, HAND_EXPERIMENT = _experiment(BallLimitSettings), _experiment(HandLimitSettings)

"""A small experiment without physics, for the tests of the command line and the report."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator

from wbmpc.errors import RunAborted
from wbmpc.experiment import Experiment
from wbmpc.log import Log
from wbmpc.result import Metric, MpcStatistics, Plot, RunResult, Series


class Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Mpc(Section):
    rate: float = Field(50.0, gt=0)
    intervals: int = Field(20, ge=1)


class Hand(Section):
    weight: float = Field(250.0, ge=0)


class CostTerms(Section):
    end_effector: Hand = Hand()


class Plant(Section):
    friction: tuple[float, float] = (0.6, 0.9)

    @field_validator("friction")
    @classmethod
    def _in_order(cls, value: tuple[float, float]) -> tuple[float, float]:
        if value[0] > value[1]:
            raise ValueError("needs lower ≤ upper")
        return value


class FakeSettings(Section):
    mpc: Mpc = Mpc()
    cost: CostTerms = CostTerms()
    plant: Plant = Plant()
    duration: float = Field(4.0, gt=0)
    fall_at: float | None = None
    abort: bool = False
    interrupt: bool = False
    failures: int = 0


def run(settings: FakeSettings, seed: int, progress: Callable[[float, str], None] | None = None) -> RunResult:
    """A noisy sine; it 'falls' at ``fall_at`` [s]."""
    if settings.abort:
        raise RunAborted("the solver gave up at 0.10 s")
    rng, log = np.random.default_rng(seed), Log()
    fell = settings.fall_at is not None and settings.fall_at < settings.duration
    times = np.arange(0.0, settings.fall_at if fell and settings.fall_at else settings.duration, 0.0025)
    for t in times:
        log.add("hand", t, [4.0 * t, np.sin(2 * t) + 1e-3 * rng.normal(), 1.0])
        log.add("error", t, abs(2e-3 * rng.normal()))
    if progress is not None:
        progress(1.0, "done")
    end_effector, error = log.array("hand"), log.array("error")
    metrics = {
        "hand_error_mean_odometry": Metric(float(error.mean()), "m", paper=0.0167, goal=0.003),
        "hand_error_max_odometry": Metric(
            float(error.max()), "m", goal=0.001, goal_note="the goal is for the mean of many"
        ),
        "path_length": Metric(20.53, "m", paper=20.53),
        "rise_time_max": Metric(float("inf") if fell else 0.9, "s"),
        "fell": Metric(float(fell), "1", goal=0.0),
    }
    plots = [
        Plot("End effector path and its reference", "x [m]", "y [m]", [
            Series("hand", end_effector[:, 0], end_effector[:, 1]),
            Series("reference", end_effector[:, 0], np.sin(end_effector[:, 0] / 2), dashed=True),
        ], equal_axes=True),
        Plot("End effector error", "time [s]", "error [mm]", [Series("estimated frame", times, 1e3 * error)]),
        Plot("Joint speeds over their limits", "time [s]", "|speed| / limit", [
            Series(n, times, np.abs(np.sin(times + k))) for k, n in enumerate(("shoulder_pan", "elbow", "wrist_1"))
        ]),
        Plot("Empty <plot>", "time [s]", "nothing", [Series("none & nothing", np.zeros(0), np.zeros(0))]),
    ]  # fmt: skip
    result = RunResult(
        "fake", seed, not fell, f"the robot fell at {settings.fall_at:.2f} s" if fell else "", metrics,
        MpcStatistics.of(settings.mpc.rate, [0.001, 0.002, 0.030], 100, settings.failures, 1), log, plots,
        ["there is no physics <at all>", "the clock is perfect"], settings.model_dump(mode="json"),
    )  # fmt: skip
    if settings.interrupt:
        result.completed, result.reason, result.interrupted = False, "interrupted at 0.10 s", True
    return result


FAKE = Experiment("fake", "a sine without physics", FakeSettings, run)
REGISTRY = {"fake": FAKE}

"""An experiment of the tests that takes no time: its error is known for every setting and seed."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable

from pydantic import BaseModel, ConfigDict, Field

from wbmpc.errors import InputError, RunAborted
from wbmpc.experiment import Experiment
from wbmpc.log import Log
from wbmpc.result import Metric, MpcStatistics, OutcomeName, RunResult

#: Where the error is least.
BEST = 3.0


class Inner(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)
    gain: float = Field(1.0, gt=0)


class ValleySettings(BaseModel):
    """``goal`` [m]: of the error; ``shift`` [m] adds to it; ``fall_from``: seeds from this on fall, or
    end as ``failure`` says; ``die_at``: the process of this seed is
    killed; ``raise_at``: this one has an error."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    control: Inner = Inner()
    offset: float = 0.0
    shift: float = 0.0
    goal: float = 0.5
    robot: str = "one"
    fall_from: int = 10**9
    failure: OutcomeName = "fell"
    die_at: int = -1
    raise_at: int = -1


def error(gain: float, offset: float, seed: int) -> float:
    """What the experiment measures [m]."""
    return (gain - BEST) ** 2 + offset + 0.01 * (seed % 10)


def run(s: ValleySettings, seed: int, progress: Callable[[float, str], None] | None = None) -> RunResult:
    if seed == s.die_at:
        os.kill(os.getpid(), signal.SIGKILL)
    if seed == s.raise_at:
        raise ZeroDivisionError("of this seed")
    if s.robot == "lost":
        raise RunAborted("this robot does not move")
    if s.robot == "unknown":
        raise InputError("there is no such robot")
    fell = seed >= s.fall_from
    # a run that fell measured little before its end
    metrics = {
        "error": Metric(1e-6 if fell else s.shift + error(s.control.gain, s.offset, seed), "m", paper=1.0, goal=s.goal),
        "effort": Metric(s.control.gain, "1"),
        "threads": Metric(float(os.environ.get("OMP_NUM_THREADS", "0")), "1"),
    }
    mpc = MpcStatistics.of(50.0, [0.001, 0.003], 10)
    return RunResult("valley", seed, not fell, "it fell" if fell else "", metrics, mpc, Log(), failure=s.failure,
                     settings=s.model_dump(mode="json"))  # fmt: skip


EXPERIMENT = Experiment("valley", "an error with one minimum", ValleySettings, run)

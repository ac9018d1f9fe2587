"""`touch`: the ball robot touches a door or a wall with a hard or a soft tip, whose place it knows to ± 10 mm, and pushes.

How hard a hard tip hits is decided by its speed, before anything can be measured: the plan limits it as the panel comes near
(:class:`wbmpc.studies.minniti2019.door_residuals.ApproachSpeed`), and believes the panel to be as near as it may be until it is touched.
Beside it the same approaches without that limit.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from wbmpc.experiment import Experiment, Outcome, Scenario
from wbmpc.log import Log
from wbmpc.simulation.lockstep import Progress
from wbmpc.studies.minniti2019.definitions import DEFINITIONS
from wbmpc.studies.minniti2019.door_problem import DoorEquation, DoorScheme, FreeApproach, LimitedApproach
from wbmpc.studies.minniti2019.press import PressSettings, log_steps, press, pushes
from wbmpc.studies.minniti2019.touch_figures import Touch, metrics, plots

NAME = "touch"


class TouchSettings(PressSettings):
    """``speeds`` [m/s] that are commanded, one approach each; ``compare``: where the speed of the approach is limited
    (``scheme.contact.approach``), also without that limit. The others are those of
    :class:`wbmpc.studies.minniti2019.press.PressSettings`."""

    tip: Literal["hard", "soft"] = "hard"
    surface: Literal["door", "wall"] = "wall"
    speeds: tuple[Annotated[float, Field(ge=0.01, le=1.0)], ...] = Field(
        (0.05, 0.1, 0.2, 0.3), min_length=1, max_length=8
    )
    compare: bool = True
    scheme: DoorScheme = DoorScheme(contact=DoorEquation(approach=LimitedApproach()))
    timeout: float = Field(7.0, ge=1.0, le=120.0)


def approach(
    settings: TouchSettings, speed: float, limited: bool, seed: int, progress: Progress | None
) -> tuple[Touch, Outcome]:
    """One approach with a commanded ``speed`` [m/s]."""
    free = settings.scheme.contact.model_copy(update={"approach": FreeApproach()})
    scheme = settings.scheme if limited else settings.scheme.model_copy(update={"contact": free})
    trial, steps, end = press(settings.model_copy(update={"scheme": scheme}), speed, seed, progress)
    touch = Touch(speed, settings.force, settings.settle_time, end, steps, trial.ending)
    return touch, Outcome(trial.ending, trial.faults, None, trial.mpc)


def build(settings: TouchSettings, seed: int) -> Scenario:
    """An approach for each speed, with the limit and without."""
    log = Log()
    runs: dict[bool, list[Touch]] = {True: [], False: []}
    given = isinstance(settings.scheme.approach, LimitedApproach)

    def run(speed: float, limited: bool, progress: Progress | None) -> Outcome:
        touch, outcome = approach(settings, speed, limited, seed, progress)
        runs[limited].append(touch)
        log_steps(log, f"touch_{speed:g}" + ("" if limited == given else "_plain"), touch.steps, settings.settle_time)
        return outcome

    return pushes(log, run, settings.speeds, "{:g} m/s", (given, settings.compare), runs, metrics, plots)


EXPERIMENT = Experiment.of(
    NAME, "the ball robot touches a door or a wall with a hard or a soft tip", TouchSettings, build, DEFINITIONS[NAME]
)

"""`slip`: the ball robot pushes a door or a wall whose friction it does not know, and is not to slide on it.

What the surface bears is known when the tip has slid. So the plan trusts little friction at first, more where the tip has borne more
without sliding, and less as soon as it slides (:class:`wbmpc.studies.minniti2019.grip.GripEstimator`). Beside it the same pushes with a cone
of one size.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from wbmpc.experiment import Experiment, Outcome, Scenario
from wbmpc.log import Log
from wbmpc.simulation.lockstep import Progress
from wbmpc.studies.minniti2019.definitions import DEFINITIONS
from wbmpc.studies.minniti2019.door_problem import DoorEquation, DoorScheme, EstimatedCone, LimitedApproach, PushCone
from wbmpc.studies.minniti2019.press import PressSettings, log_steps, press, pushes
from wbmpc.studies.minniti2019.slip_figures import Press, metrics, plots

NAME = "slip"
#: Time constant [s] with which friction stops a tip that slides: in that of a soft contact it would creep by millimeters as the door turns.
FRICTION_TIME = 0.002


class SlipSettings(PressSettings):
    """``speed`` [m/s]: speed of the approach at its start; ``grips``: friction coefficients of the surface, one push each, which the robot
    does not know; ``compare``: an estimated cone also with one of one size (:class:`PushCone`). The others are those of
    :class:`wbmpc.studies.minniti2019.press.PressSettings`."""

    grips: tuple[Annotated[float, Field(ge=0.02, le=2.0)], ...] = Field(
        (0.1, 0.2, 0.4, 0.8), min_length=1, max_length=8
    )
    compare: bool = True
    speed: float = Field(0.1, gt=0, le=1.0)
    scheme: DoorScheme = DoorScheme(contact=DoorEquation(approach=LimitedApproach(leans=True)), cone=EstimatedCone())
    timeout: float = Field(10.0, ge=1.0, le=120.0)


def build(settings: SlipSettings, seed: int) -> Scenario:
    """A push for each grip, with the estimated cone and with one of one size."""
    log = Log()
    runs: dict[bool, list[Press]] = {True: [], False: []}
    given = isinstance(settings.scheme.cone, EstimatedCone)

    def run(grip: float, learns: bool, progress: Progress | None) -> Outcome:
        name = f"grip_{grip:g}" + ("" if learns == given else "_plain")
        scheme = settings.scheme if learns == given else settings.scheme.model_copy(update={"cone": PushCone()})
        trial, steps, end = press(
            settings.model_copy(update={"scheme": scheme}),
            settings.speed,
            seed,
            progress,
            grip=grip,
            friction_time=FRICTION_TIME,
        )
        trusted = [c for c in ("grip",) if c in trial.log.channels]  # none without a cone
        bound = trial.log.array("grip") if trusted else np.array([np.inf])
        runs[learns].append(Press(grip, settings.force, settings.rise_time, end, steps, bound, trial.ending))
        log_steps(log, f"steps_{name}", steps, settings.settle_time)
        log.extend(trial.log, f"_{name}", [*trusted, "sliding", "force_planned"])
        return Outcome(trial.ending, trial.faults, None, trial.mpc)

    return pushes(log, run, settings.grips, "grip {:g}", (given, settings.compare), runs, metrics, plots)


EXPERIMENT = Experiment.of(
    NAME, "the ball robot pushes a door or a wall of unknown friction", SlipSettings, build, DEFINITIONS[NAME]
)

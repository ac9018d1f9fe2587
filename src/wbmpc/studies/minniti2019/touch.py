"""`touch`: the ball robot touches a door or a wall with a hard or a soft tip, whose place it knows to ± 10 mm, and pushes.

How hard a hard tip hits is decided by its speed, before anything can be measured: the plan limits it as the panel comes near
(:class:`wbmpc.studies.minniti2019.door_residuals.ApproachSpeed`), and believes the panel to be as near as it may be until it is touched.
Beside it the same approaches without that limit.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from wbmpc.configuration import OnlyWith, Rules, unused
from wbmpc.experiment import Experiment, Outcome, Part, Scenario
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.simulation.lockstep import Progress
from wbmpc.studies.minniti2019.definitions import DEFINITIONS
from wbmpc.studies.minniti2019.door import HERE, believed, drawn_door, push_door
from wbmpc.studies.minniti2019.door_control import RELAX
from wbmpc.studies.minniti2019.door_plant import SOFT
from wbmpc.studies.minniti2019.door_problem import DoorScheme, FreeApproach, LimitedApproach
from wbmpc.studies.minniti2019.door_settings import RezeroDoorSettings
from wbmpc.studies.minniti2019.task import IDEALIZATIONS
from wbmpc.studies.minniti2019.touch_figures import Touch, metrics, plots
from wbmpc.studies.minniti2019.touch_plant import TouchPlant

NAME = "touch"
#: Time constant [s] and damping ratio of the tips' contact.
TIPS = {"soft": SOFT, "hard": (0.004, 0.3)}
#: Of so many physics steps one is kept in the log; figures are of all.
THINNED = 5


class TouchSettings(RezeroDoorSettings):
    """``tip``: hard (its contact lasts milliseconds and is hardly damped) or soft, of rubber; ``surface``: a door that is free, or a wall;
    ``speeds`` [m/s] that are commanded, one approach each; ``force`` [N] to push with; ``compare``: also without the limit of the approach's speed
    (``scheme.approach``); ``timeout`` [s]: from the start of the approach to the end of the push. The others are those of `rezero-door`."""

    tip: Literal["hard", "soft"] = "hard"
    surface: Literal["door", "wall"] = "wall"
    speeds: tuple[Annotated[float, Field(ge=0.01, le=1.0)], ...] = Field(
        (0.05, 0.1, 0.2, 0.3), min_length=1, max_length=8
    )
    force: float = Field(16.0, gt=0, le=200.0)
    compare: Annotated[bool, OnlyWith({"scheme.approach.kind": "limited"})] = True
    scheme: DoorScheme = DoorScheme(approach=LimitedApproach())
    settle_time: float = Field(1.5, ge=0.5, le=60.0)
    rise_time: float = Field(0.3, ge=0, le=10.0)
    timeout: float = Field(7.0, ge=1.0, le=120.0)
    final_hold_time: float = Field(0.2, ge=0.1, le=60.0)

    only_with: ClassVar[Rules] = {**RezeroDoorSettings.only_with, **unused("forces", "speed", "door")}


def make_plant(
    plants: list[TouchPlant],
    settings: TouchSettings,
    robot: RobotModel,
    home: np.ndarray,
    torque: np.ndarray,
    seed: int,
) -> TouchPlant:
    """The robot before a door or wall with the chosen tip, which is appended to ``plants``."""
    door = drawn_door(settings, believed(robot.pose(home)[0]).hinge, seed)
    door = replace(door, locked=settings.surface == "wall", contact=TIPS[settings.tip])
    plants.append(
        TouchPlant(robot.description, door, home, torque, settings.plant, seed=seed, payload=settings.payload)
    )
    return plants[-1]


def approach(
    settings: TouchSettings, speed: float, limited: bool, seed: int, progress: Progress | None
) -> tuple[Touch, Outcome]:
    """One approach with a commanded ``speed`` [m/s]."""
    scheme = settings.scheme if limited else settings.scheme.model_copy(update={"approach": FreeApproach()})
    here = settings.model_copy(update={"speed": speed, "scheme": scheme})
    plants: list[TouchPlant] = []
    trial = push_door(here, settings.force, seed, progress, partial(make_plant, plants))
    pushing = trial.log.times("pushing")[trial.log.array("pushing") > 0.0]
    limit = settings.settle_time + settings.timeout - RELAX
    end = min(float(pushing[-1]) if pushing.size else limit, limit)
    touch = Touch(speed, settings.force, settings.settle_time, end, plants[0].record(), trial.ending)
    return touch, Outcome(trial.ending, trial.faults, None, trial.mpc)


def build(settings: TouchSettings, seed: int) -> Scenario:
    """An approach for each speed, with the limit and without."""
    log = Log()
    runs: dict[bool, list[Touch]] = {True: [], False: []}
    given = isinstance(settings.scheme.approach, LimitedApproach)

    def run(speed: float, limited: bool, progress: Progress | None) -> Outcome:
        touch, outcome = approach(settings, speed, limited, seed, progress)
        runs[limited].append(touch)
        rows = touch.steps[touch.steps[:, 0] >= settings.settle_time]
        for row in rows[::THINNED]:
            log.add(f"touch_{speed:g}" + ("" if limited == given else "_plain"), row[0], row[1:])
        return outcome

    kinds = (given, False) if given and settings.compare else (given,)
    parts = [
        Part(
            f"{speed:g} m/s" + ("" if limited == given else ", plain"),
            partial(run, speed, limited),
            baseline=limited != given,
        )
        for limited in kinds
        for speed in sorted(settings.speeds)
    ]
    own, plain = runs[given], runs[False] if given else []
    return Scenario(
        log,
        parts,
        lambda run: metrics(own, plain),
        lambda run: plots(own, plain),
        [*HERE, *IDEALIZATIONS],
        compared=True,
    )


EXPERIMENT = Experiment.of(
    NAME, "the ball robot touches a door or a wall with a hard or a soft tip", TouchSettings, build, DEFINITIONS[NAME]
)

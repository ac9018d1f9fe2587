"""The ball robot presses its tip against a door or a wall whose place it knows to ± 10 mm: what `touch` and `slip` have in common."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Literal, TypeVar

from pydantic import Field

from wbmpc.arrays import Array
from wbmpc.experiment import Outcome, Part, Scenario
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.result import Drawing, Metric, Plot
from wbmpc.simulation.lockstep import Progress
from wbmpc.studies.force_tip import SOFT
from wbmpc.studies.minniti2019.door import HERE
from wbmpc.studies.minniti2019.door_figures import Trial
from wbmpc.studies.minniti2019.door_problem import DoorEquation, DoorScheme, LimitedApproach
from wbmpc.studies.minniti2019.door_settings import DoorSettings
from wbmpc.studies.minniti2019.door_tracker import RELAX
from wbmpc.studies.minniti2019.door_trial import believed, drawn_door, push_door
from wbmpc.studies.minniti2019.task import IDEALIZATIONS
from wbmpc.studies.minniti2019.touch_plant import STEP_NAMES, STEP_UNITS, TouchPlant

T = TypeVar("T")
#: Time constant [s] and damping ratio of the tips' contact.
TIPS = {"soft": SOFT, "hard": (0.004, 0.3)}
#: Of so many physics steps one is kept in the log; figures are of all.
THINNED = 5


class PressSettings(DoorSettings):
    """``tip``: hard (its contact lasts milliseconds and is hardly damped) or soft, of rubber; ``surface``: a door that is free, or a wall;
    ``force`` [N] to push with; ``timeout`` [s]: from the start of the approach to the end of the push. The others are those of
    `rezero-door`."""

    tip: Literal["hard", "soft"] = "soft"
    surface: Literal["door", "wall"] = "door"
    force: float = Field(16.0, gt=0, le=200.0)
    scheme: DoorScheme = DoorScheme(contact=DoorEquation(approach=LimitedApproach(leans=True)))
    settle_time: float = Field(1.5, ge=0.5, le=60.0)
    rise_time: float = Field(0.3, ge=0, le=10.0)
    final_hold_time: float = Field(0.2, ge=0.1, le=60.0)


def press(
    settings: PressSettings, speed: float, seed: int, progress: Progress | None, **surface: Any
) -> tuple[Trial, Array, float]:
    """One approach at ``speed`` [m/s] at its start, and push on a ``surface`` with these numbers of a
    :class:`wbmpc.studies.minniti2019.door_plant.Door`: how it went, the physics steps (n, 6) as of
    :class:`wbmpc.studies.minniti2019.touch_plant.TouchPlant`, and when [s] the push ends."""
    plants: list[TouchPlant] = []

    def made(_: DoorSettings, robot: RobotModel, home: Array, torque: Array, seed: int) -> TouchPlant:
        door = drawn_door(settings, believed(robot.pose(home)[0]).hinge, seed)
        door = replace(door, locked=settings.surface == "wall", contact=TIPS[settings.tip], **surface)
        plants.append(
            TouchPlant(
                robot.description, door, home, torque, settings.perturbation, seed=seed, payload=settings.payload
            )
        )
        return plants[-1]

    trial = push_door(settings, settings.force, speed, seed, progress, made)
    pushing = trial.log.times("pushing")[trial.log.array("pushing") > 0.0]
    limit = settings.settle_time + settings.timeout - RELAX
    return trial, plants[0].record(), min(float(pushing[-1]) if pushing.size else limit, limit)


def log_steps(log: Log, channel: str, steps: Array, start: float) -> None:
    """Record the physics ``steps`` (n, 6) of a push from the time ``start`` [s] on, one of :data:`THINNED`."""
    log.label(channel, STEP_NAMES, STEP_UNITS)
    for row in steps[steps[:, 0] >= start][::THINNED]:
        log.add(channel, row[0], row[1:])


def pushes(
    log: Log, run: Callable[[float, bool, Progress | None], Outcome], values: Sequence[float], title: str,
    kinds: tuple[bool, bool], runs: dict[bool, list[T]], metrics: Callable[[list[T], list[T]], dict[str, Metric]],
    plots: Callable[[list[T], list[T]], Sequence[Plot | Drawing]],
) -> Scenario:  # fmt: skip
    """A part for each of the ``values``, named by the format ``title``, and the same ones plain. ``kinds``: whether the settings are those of
    the experiment, and whether plain parts are asked for beside them; ``run`` adds to ``runs`` by whether a part is plain (False)."""
    given, compare = kinds
    parts = [
        Part(title.format(v) + ("" if kind == given else ", plain"), partial(run, v, kind), baseline=kind != given)
        for kind in ((True, False) if given and compare else (given,))
        for v in sorted(values)
    ]
    own, plain = runs[given], runs[False] if given else []
    ideal = [*HERE, *IDEALIZATIONS]
    return Scenario(log, parts, lambda _: metrics(own, plain), lambda _: plots(own, plain), ideal, compared=True)

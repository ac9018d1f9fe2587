"""`swerve-fast`: as fast as the floor carries it, with 10 kg at full reach: 2 m sideways, along an S-curve, or in a slalom.

The order is a goal, or a path: no plan sees it before, and nothing but the plan says how fast to go. Plans by speeds
(``stability=nothing``) know nothing of what a change of speed does to the loads of the wheels.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from pydantic import Field

from wbmpc.configuration import OneOf
from wbmpc.experiment import Experiment, Scenario
from wbmpc.log import Log
from wbmpc.model.robot import load_robot
from wbmpc.mpc.route import base_part
from wbmpc.result import Metric, Plot, Series
from wbmpc.settings import Positive, Robot, Stability, WheelLoadSettings
from wbmpc.studies.pankert2022.definitions import DEFINITIONS
from wbmpc.studies.pankert2022.fast_courses import SCurve, Sideways, Slalom
from wbmpc.tasks.loop import Hooks, Surroundings, closed_loop
from wbmpc.tasks.settings import MujocoPlant, TaskMpcSettings, TaskSettings
from wbmpc.tasks.tip_over import LIFTED, LoadWatch, reaching
from wbmpc.types import Truth

NAME = "swerve-fast"


class SwerveFastSettings(TaskSettings):
    """``course``: sideways (:class:`Sideways`), an s-curve (:class:`SCurve`) or a slalom (:class:`Slalom`); ``after`` [s]: how long the robot
    is watched from the order on (left out: as the course needs); ``legs``: configuration of hinged legs. ``weights`` are factors on top of
    the course's own. Odometry of wheels that are not calibrated is farther off than the plan is from its path. Wheels are of one size: a
    stiff body on four stiff wheels that differ by 0.2 mm stands on three of them, whatever is planned."""

    robot: Robot = "swerve-ur10"
    plant: MujocoPlant = MujocoPlant(payload=10.0, wheel_radius_each=0.0, calibration="drive")
    mpc: TaskMpcSettings = TaskMpcSettings(horizon=2.0)
    stability: Stability = WheelLoadSettings(min_load=0.1, payload=10.0)
    weights: dict[str, Positive] = Field(default={})
    settle_time: float = Field(2.0, ge=0, le=60)
    course: OneOf[Sideways | SCurve | Slalom] = Sideways()
    after: float | None = Field(None, ge=0.5, le=600)
    legs: Literal["home", "H", "X", "A"] = "H"

    @property
    def weighted(self) -> SwerveFastSettings:
        """The same with the factors of the course."""
        own = self.course.WEIGHTS
        return self.model_copy(update={"weights": {**own, **{k: own.get(k, 1.0) * v for k, v in self.weights.items()}}})


class WheelWatch(LoadWatch):
    """Beside what wheels carry: their slip (n) [m/s]."""

    def __init__(self, since: float) -> None:
        super().__init__(since)
        self.slip: list[float] = []

    def see(self, t: float, truth: Truth) -> None:
        """At a controller period."""
        super().see(t, truth)
        if t >= self._since:
            self.slip.append(float(truth.slip.max()))

    def metrics(self) -> dict[str, Metric]:
        """What the wheels did."""
        off = (np.array(self.loads) < LIFTED).any(axis=1)
        return {
            "tilt_max": Metric(max(self.tilt), "rad"),
            "time_unloaded": Metric(float(off.mean() * (self.times[-1] - self.times[0])), "s"),
            "wheel_slip_max": Metric(max(self.slip), "m/s"),
        }

    def plots(self, names: list[str]) -> list[Plot]:
        """Loads and tilt over time."""
        tilt = Series("tilt", np.array(self.times), np.degrees(self.tilt))
        return [*super().plots(names), Plot("Tilt of the base", "time [s]", "angle [°]", [tilt])]


def build(settings: SwerveFastSettings, seed: int) -> Scenario:
    """One run."""
    robot = load_robot(settings.robot)
    base_part(robot, NAME)
    course, ordered = settings.course, settings.settle_time
    robot = reaching(course.equipped(robot), np.pi / 2, settings.legs, course.ROLLING)
    scene = course.scene(robot, seed)
    robot, mpc = settings.weighted.prepare(scene is not None, robot, course.FOLLOWS)
    watch, waiting = WheelWatch(ordered), [ordered]

    def tick(t: float) -> None:
        """The order: no plan sees it before."""
        if waiting and t >= waiting[0] - 1e-9:
            waiting.pop()
            course.order(t, robot, mpc)

    def metrics(log: Log) -> dict[str, Metric]:
        found = {**course.metrics(log, ordered, robot), **watch.metrics()}
        return {name: replace(metric, goal=course.GOALS.get(name)) for name, metric in found.items()}

    wheels = robot.description.base.wheel_joints() or list(robot.state.groups.get("wheel", ()))
    scenario = closed_loop(
        robot, mpc, ordered + (settings.after or course.AFTER), seed, settings, since=ordered, around=Surroundings(scene),
        hooks=Hooks(tick=tick, metrics=metrics, plots=lambda log: watch.plots(wheels), truth=watch.see),
    )  # fmt: skip
    return replace(scenario, idealizations=[*scenario.idealizations, *course.idealizations])


EXPERIMENT = Experiment.of(
    NAME,
    "2 m sideways, an s-curve or a slalom, with a load at full reach, as fast as all wheels stay on the ground",
    SwerveFastSettings,
    build,
    DEFINITIONS[NAME],
)

"""`swerve-fast`: as fast as the floor carries it. The end effector goes 2 m sideways with 10 kg at full reach.

The order is a goal: no plan sees it before, and nothing but the plan says how fast to go. Plans by speeds (``mpc.model=kinematic``) know
nothing of what a change of speed does to the loads of the wheels.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from wbmpc.errors import InputError
from wbmpc.experiment import Experiment, Scenario
from wbmpc.log import Log
from wbmpc.model.robot import load_robot
from wbmpc.ocp import Reference
from wbmpc.result import Metric, Plot, Series
from wbmpc.settings import Positive, Robot, Stability, WheelLoadSettings
from wbmpc.simulation.perturbation import Perturbation
from wbmpc.studies.pankert2022.definitions import DEFINITIONS
from wbmpc.tasks.loop import closed_loop
from wbmpc.tasks.path_settings import follow
from wbmpc.tasks.settings import TaskMpcSettings, TaskSettings, moving_base
from wbmpc.tasks.tip_over import LIFTED, reaching
from wbmpc.types import Truth

Array = np.ndarray
NAME = "swerve-fast"
#: The end effector is at its goal [m]; goals of the metrics: [s], [rad], [s].
AT_GOAL = 0.010
TIME_GOAL, TILT_GOAL, UNLOADED_GOAL = 2.7, float(np.deg2rad(0.05)), 0.1


class SwerveFastSettings(TaskSettings):
    """``length`` [m] of the way sideways; ``after`` [s]: how long the robot is watched from the order on; ``legs``: configuration of
    hinged legs. Speeds weigh more and the end effector less than by default: what is only pulled by its distance from the goal comes to
    it too fast to stop there. Wheels are of one size: a stiff body on four stiff wheels that differ by 0.2 mm stands on three of them,
    whatever is planned."""

    robot: Robot = "swerve-ur10"
    plant: Perturbation = Perturbation(payload=10.0, wheel_radius_each=0.0)
    mpc: TaskMpcSettings = TaskMpcSettings(model="dynamic", horizon=2.0)
    stability: Stability = WheelLoadSettings(min_load=0.1, payload=10.0)
    weights: dict[str, Positive] = Field(default={"end_effector": 0.2, "input": 12.0})
    settle_time: float = Field(2.0, ge=0, le=60)
    length: float = Field(2.0, ge=0.1, le=100)
    after: float = Field(5.0, ge=0.5, le=600)
    legs: Literal["home", "H", "X", "A"] = "H"


class WheelWatch:
    """Loads (n) [N] and slip (n) [m/s] of the wheels and tilt [rad] of the base, at every controller period from ``since`` [s] on."""

    def __init__(self, since: float) -> None:
        self._since = since
        self.times: list[float] = []
        self.loads: list[Array] = []
        self.slip: list[float] = []
        self.tilt: list[float] = []

    def see(self, t: float, truth: Truth) -> None:
        """At a controller period."""
        if t >= self._since:
            self.times.append(t)
            self.loads.append(truth.wheel_force)
            self.slip.append(float(truth.slip.max()))
            self.tilt.append(truth.tilt)

    def metrics(self) -> dict[str, Metric]:
        """What the wheels did."""
        off = (np.array(self.loads) < LIFTED).any(axis=1)
        return {
            "tilt_max": Metric(max(self.tilt), "rad", goal=TILT_GOAL),
            "time_unloaded": Metric(float(off.mean() * (self.times[-1] - self.times[0])), "s", goal=UNLOADED_GOAL),
            "wheel_slip_max": Metric(max(self.slip), "m/s"),
        }

    def plots(self, names: list[str]) -> list[Plot]:
        """Loads and tilt over time."""
        t, loads = np.array(self.times), np.array(self.loads)
        return [
            Plot("Wheel loads", "time [s]", "force [N]", [Series(n, t, loads[:, i]) for i, n in enumerate(names)]),
            Plot("Tilt of the base", "time [s]", "angle [rad]", [Series("tilt", t, np.array(self.tilt))]),
        ]


def time_to_goal(times: Array, positions: Array, goal: Array, ordered: float) -> float:
    """Time [s] from the order at ``ordered`` [s] until positions (n, 3) [m] at ``times`` (n) [s] stay within :data:`AT_GOAL` of the
    ``goal`` (3); no number if they do not."""
    away = np.flatnonzero(np.linalg.norm(positions - goal, axis=1) > AT_GOAL)
    first = int(away[-1]) + 1 if away.size else 0
    return float(times[first] - ordered) if first < len(times) else float("nan")


def path_error(positions: Array, start: Array, goal: Array) -> float:
    """Largest distance [m] of positions (n, 3) from the straight way from ``start`` to ``goal`` (3 each)."""
    way = goal - start
    share = np.clip((positions - start) @ way / (way @ way), 0.0, 1.0)
    return float(np.linalg.norm(positions - start - share[:, None] * way, axis=1).max())


def build(settings: SwerveFastSettings, seed: int) -> Scenario:
    """One run."""
    if settings.physics != "mujoco":
        raise InputError(f"{NAME}: physics: kinematic robots do not tip; valid: mujoco")
    robot = load_robot(settings.robot)
    moving_base(robot, NAME)
    direction, ordered = np.pi / 2, settings.settle_time
    robot, mpc = settings.prepare(robot=reaching(robot, direction, settings.legs))
    pose = mpc.reference["end_effector"].at(0.0)
    start, way = pose[:3], np.array([0.0, settings.length, 0.0])
    goal = start + way
    watch, waiting = WheelWatch(ordered), [ordered]

    def tick(t: float) -> None:
        """The order: no plan sees it before."""
        if waiting and t >= waiting[0] - 1e-9:
            waiting.pop()
            follow(robot, mpc, Reference.poses([t], [goal], pose[3:], hold=True))

    def metrics(log: Log) -> dict[str, Metric]:
        times, tool = log.times("end_effector"), log.array("end_effector")
        late = times >= ordered
        times, tool = times[late], tool[late]
        return {
            "time_to_goal": Metric(time_to_goal(times, tool, goal, ordered), "s", goal=TIME_GOAL),
            **watch.metrics(),
            "path_error_max": Metric(path_error(tool, start, goal), "m"),
        }

    wheels = robot.description.base.wheel_joints() or list(robot.state.groups.get("wheel", ()))
    return closed_loop(
        robot, mpc, ordered + settings.after, seed, settings, since=ordered, tick=tick, metrics=metrics,
        plots=lambda log: watch.plots(wheels), truth=watch.see,
    )  # fmt: skip


EXPERIMENT = Experiment.of(
    NAME,
    "2 m sideways with a load at full reach, as fast as all wheels stay on the ground",
    SwerveFastSettings,
    build,
    DEFINITIONS[NAME],
)

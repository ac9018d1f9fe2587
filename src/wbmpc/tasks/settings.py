"""Settings that general experiments share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from wbmpc.bases import base_type
from wbmpc.configuration import OneOf
from wbmpc.errors import unknown_name
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.mpc.mpc import MPC
from wbmpc.obstacles.world import Obstacles
from wbmpc.ocp import Cost
from wbmpc.robots.examples import EXAMPLES
from wbmpc.settings import (
    COMPUTATION_DELAY,
    NoStability,
    Positive,
    ReadBy,
    Robot,
    Settings,
    Stability,
    StabilitySettings,
)
from wbmpc.simulation.any_perturbation import AnyPerturbation
from wbmpc.simulation.obstacles import load_scene
from wbmpc.stability import standing


class MujocoPlant(AnyPerturbation):
    """A perturbed robot in MuJoCo, with noise and lag. ``calibration``: what is known of its wheels and arm, "none", or before the run: of
    the wheels what a reference "drive" with global poses shows, of the zeros of the arm's encoders what an end effector does that is
    tracked."""

    kind: Literal["mujoco"] = "mujoco"
    calibration: Literal["none", "drive"] = "none"

    @property
    def perturbation(self) -> AnyPerturbation:
        """How it differs from the planner's model."""
        return AnyPerturbation.model_construct(**{n: getattr(self, n) for n in AnyPerturbation.model_fields})


class KinematicPlant(Settings):
    """The planner's own model, exact and fast."""

    kind: Literal["kinematic"] = "kinematic"


class SimulationSettings(Settings):
    """``plant``: mujoco (:class:`MujocoPlant`) or kinematic (:class:`KinematicPlant`); ``computation_delay`` [s]: modeled time of a solve;
    ``settle_time`` [s]: before the task begins, at rest; ``obstacles``: a YAML file of what stands and moves in the simulated world
    (docs/how-to/obstacles.md)."""

    plant: OneOf[MujocoPlant | KinematicPlant] = MujocoPlant()
    computation_delay: float = Field(COMPUTATION_DELAY, ge=0, le=1.0)
    settle_time: float = Field(1.0, ge=0, le=60)
    obstacles: Annotated[Path | None, ReadBy(load_scene)] = None


class TaskMpcSettings(Settings):
    """Of the MPC; left out (none): as the robot's base type has them. ``rate`` [Hz]: update rate of the MPC; ``horizon`` [s]: length of
    the horizon; ``intervals``: number of intervals of the horizon; ``first_interval`` [s]: of a geometric grid, 0: a uniform one;
    ``iterations``: solver iterations per update; ``limits``: whether they are kept as hard constraints."""

    rate: float | None = Field(None, ge=1e-3, le=10_000)
    horizon: float | None = Field(None, gt=0, le=1000)
    intervals: int | None = Field(None, ge=1, le=1000)
    first_interval: float | None = Field(None, ge=0, le=1000)
    iterations: int | None = Field(None, ge=1, le=50)
    limits: Literal["hard", "soft"] | None = None


class TaskSettings(SimulationSettings):
    """``robot``: a name (see 'wbmpc list') or a file; ``mpc``: what differs from the robot's default problem;
    ``weights``: factors of costs by name, as the sliders of a view set them, and of parts of them ("contour.orientation"); ``avoid``:
    "nothing" for plans that know of no obstacles, to compare with; ``stability``: what keeps a robot from tipping over that stops fast
    with a load; where it keeps something, plans are by accelerations. The others (``plant``, ``computation_delay``, ``settle_time``,
    ``obstacles``): :class:`SimulationSettings`."""

    robot: Robot = EXAMPLES["any"]
    mpc: TaskMpcSettings = TaskMpcSettings()
    weights: dict[str, Positive] = Field(default={})
    avoid: Literal["obstacles", "nothing"] = "obstacles"
    stability: Stability = NoStability()

    @property
    def upright(self) -> StabilitySettings | None:
        """What plans keep."""
        return self.stability if isinstance(self.stability, StabilitySettings) else None

    def prepare(
        self,
        obstacles: bool = False,
        robot: RobotModel | None = None,
        progress: Literal["end_effector", "base"] | None = None,
    ) -> tuple[RobotModel, MPC]:
        """The robot (or another one of it, with a home of its own) with its default MPC at home, which keeps clear of ``obstacles`` where
        there are any; ``progress``: which frame of the robot follows a path at its own speed (none: references have a clock). Raises
        :class:`InputError` for a weight of no cost."""
        robot = robot or load_robot(self.robot)
        changes: dict[str, Any] = {name: value for name, value in self.mpc.model_dump().items() if value is not None}
        if self.avoid == "obstacles" and (obstacles or self.obstacles is not None):
            changes["obstacles"] = Obstacles()
        if self.upright is not None:
            standing(robot)
            changes["stability"] = self.upright
        if progress:
            changes["progress"] = robot.tool if progress == "end_effector" else robot.description.base.body
        mpc = base_type(robot.description.base.type).mpc(robot, **changes)
        scale_weights(mpc, self.weights)
        return robot, mpc


def scale_weights(mpc: MPC, factors: dict[str, float]) -> None:
    """Multiply the weights of costs by ``factors``, by the names of costs, or of a cost and one of its residual's groups
    ("contour.orientation"). Raises :class:`InputError` for a name that no cost has."""
    costs: dict[str, Any] = {t.name: t for t in mpc.ocp.terms.values() if isinstance(t, Cost)}
    scales: dict[str, np.ndarray] = {}
    for name, factor in factors.items():
        whole, _, group = name.partition(".")
        if whole not in costs:
            raise unknown_name("cost (setting 'weights')", whole, costs)
        groups = costs[whole].residual.groups
        if group and group not in groups:
            raise unknown_name(f"part of the cost '{whole}' (setting 'weights')", group, groups)
        scale = scales.setdefault(whole, np.ones(len(costs[whole].expand(costs[whole].weight))))
        scale[groups[group] if group else slice(None)] *= factor
    for name, scale in scales.items():
        cost = costs[name]
        end = cost.weight if cost.terminal_weight is None else cost.terminal_weight
        places: tuple[tuple[Literal["path", "terminal"], Any], ...] = (("path", cost.weight), ("terminal", end))
        for place, weight in places:
            if cost.at in (place, "path+terminal"):
                mpc.solver.set_weight(name, list(scale * cost.expand(weight)), place)

"""`rezero-door`: the ball robot pushes a door open with a wanted force (Minniti et al. 2019, section IV-D, Fig. 8 and 9)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from pydantic import Field

from wbmpc.control.door import DoorAgent, Push
from wbmpc.estimation import RezeroEstimator
from wbmpc.experiments.rezero_door_problem import DoorScheme, PushCost, door_problem
from wbmpc.experiments.rezero_problem import BodyCost, HandCost, RezeroCost, TorqueCost
from wbmpc.experiments.rezero_task import (
    IDEALISATIONS,
    RezeroSettings,
    estimator_metrics,
    mpc_settings,
    record_rezero,
    set_home_references,
)
from wbmpc.experiments.settings import finished
from wbmpc.log import Log
from wbmpc.loop import Ending, Progress, Timing, run_lockstep
from wbmpc.model import DoorGeometry, RobotModel, load_robot
from wbmpc.mpc import MPC
from wbmpc.ocp import Reference
from wbmpc.plant import Door, DoorPlant
from wbmpc.plant.door import HALF_THICKNESS, TIP_MASS, TIP_RADIUS
from wbmpc.result import Metric, Plot, RunResult, Series

NAME = "rezero-door"
SUMMARY = "the ball robot pushes a door open with a wanted force (Minniti et al. 2019, Fig. 8 and 9)"
DOORS: dict[str, dict[str, Any]] = {
    "free": {},
    "heavy": {"mass": 36.0, "damping": 20.0},
    "sticking": {"breakaway": 3.2},
    "light": {"mass": 6.0, "friction": 0.5, "closer": 0.5, "damping": 3.0},
    "locked": {"locked": True},
}
#: Where the hand touches the panel, from the hinge; the gap before it [m].
LEVER, GAP = 0.7, 0.10
#: What the controller believes of a door it has not opened: inertia [kg m²], damping [N m s/rad], resistance [N m].
NOMINAL = (2.56, 12.0, 3.5)


class RezeroDoorSettings(RezeroSettings):
    """``force`` [N] along the normal, reached ``rise`` [s] after the touch; ``door``: its kind; ``settle`` [s] before the hand
    starts, with ``speed`` [m/s]; it lets go at ``open`` [rad], or ``patience`` [s] after it started; the run ends ``rest`` [s]
    after that. ``scheme``: what of the door the problem knows; ``misplaced`` [m]: the door's place is not known better."""

    cost: RezeroCost = RezeroCost(
        hand=HandCost(weight=300.0, orientation=30.0, limit=0.05, twist=1.0, angular=0.05),
        body=BodyCost(ball_speed=1.0, tilt_rate=5.0),
        torque=TorqueCost(wheel=0.2),
    )
    push: PushCost = PushCost()
    scheme: DoorScheme = DoorScheme()
    door: Literal["free", "heavy", "sticking", "light", "locked"] = "free"
    force: float = Field(8.0, gt=0, le=60.0)
    rise: float = Field(0.3, ge=0, le=10.0)
    settle: float = Field(3.0, ge=0.5, le=60.0)
    speed: float = Field(0.1, gt=0, le=1.0)
    open: float = Field(float(np.deg2rad(60.0)), gt=0, le=2.0)
    patience: float = Field(9.0, ge=1.0, le=120.0)
    rest: float = Field(2.0, ge=0.1, le=60.0)
    misplaced: float = Field(0.01, ge=0, le=0.05)


def make_plant(settings: RezeroDoorSettings, robot: RobotModel, home: np.ndarray, torque: np.ndarray, seed: int) -> DoorPlant:
    """The robot before a door that stands up to ``misplaced`` away from where it is believed to be."""
    error = np.random.default_rng([seed, 23]).uniform(-settings.misplaced, settings.misplaced, 2)
    hinge = np.array(believed(robot.pose(home)[0]).hinge) + error
    door = Door((float(hinge[0]), float(hinge[1])), **DOORS[settings.door])
    return DoorPlant(robot.description, door, home, torque, settings.plant, seed=seed, payload=settings.payload)


def believed(hand: np.ndarray) -> DoorGeometry:
    """The door as the controller believes it to stand before the hand (3) [m] at the start."""
    offset = TIP_RADIUS + HALF_THICKNESS
    return DoorGeometry((float(hand[0] + GAP + offset), float(hand[1] + LEVER)), -np.pi / 2, 1.0, offset)


@dataclass(frozen=True)
class Trial:
    """One door pushed with one force [N]: what was recorded, how it ended."""

    force: float
    log: Log
    ending: Ending
    mpc: MPC


def push_door(settings: RezeroDoorSettings, force: float, seed: int, progress: Progress | None = None) -> Trial:
    """One run with the reference ``force`` [N]."""
    robot = load_robot("rezero", contact="force")
    home, torque = robot.equilibrium(robot.home[robot.state["arm"]])
    geometry = believed(robot.pose(home)[0])
    mpc = MPC(
        door_problem(robot, settings.mpc, settings.cost, settings.push, settings.scheme, geometry.opening),
        settings.mpc.solver(), settings.mpc.rate,
    )  # fmt: skip
    plant = make_plant(settings, robot, home, torque, seed)
    timing = Timing.of(plant.timestep, settings.control.rate, settings.mpc.rate, settings.mpc.delay)
    agent = make_agent(settings, force, robot, mpc, home, torque, timing.period, geometry)
    log = Log()

    def record(t: float, command: Any, plans: Any) -> None:
        record_rezero(log, t, plant, agent, command.torque)
        record_door(log, t, plant, agent, plans)

    duration = settings.settle + settings.patience + settings.rest
    ending = run_lockstep(plant, agent, mpc, timing, duration, record, progress)
    return Trial(force, log, ending, mpc)


def make_agent(
    settings: RezeroDoorSettings, force: float, robot: RobotModel, mpc: MPC, home: np.ndarray, torque: np.ndarray, period: float,
    geometry: DoorGeometry,
) -> DoorAgent:  # fmt: skip
    """The agent at home, with its references and what it is to do."""
    hand, quaternion = robot.pose(home)
    wanted = lambda t: force * float(np.clip(t / max(settings.rise, 1e-9), 0.0, 1.0))
    push = Push(
        wanted, hand, quaternion, settings.settle, settings.speed, settings.open, settings.settle + settings.patience,
        back=0.15, reach=GAP + 0.05, tip_weight=TIP_MASS * 9.81,
    )  # fmt: skip
    for body in ("body", "push_body"):
        mpc.reference[body] = Reference.constant(home)
    for twist in ("twist", "push_twist"):
        mpc.reference[twist] = Reference.constant(np.zeros(6))
    mpc.reference["torque"] = Reference.constant(torque)
    for pose in ("hand", "turn"):
        mpc.reference[pose] = Reference.poses([0.0], hand, quaternion)
    estimator = RezeroEstimator(robot, home) if settings.estimator == "filter" else None
    agent = DoorAgent(
        robot, mpc, push, geometry, np.array(NOMINAL), settings.scheme.identify, torque, period, settings.drive_lag, settings.observer, estimator
    )
    mpc.solver.set_parameters(agent.parameters())
    start = np.concatenate([home, agent.door]) if agent.with_door else home
    mpc.reset(start, np.concatenate([torque, np.zeros(3)]))
    return agent


def record_door(log: Log, t: float, plant: DoorPlant, agent: DoorAgent, plans: Any) -> None:
    """Forces, door and phases."""
    log.add("force", t, plant.contact_force())
    log.add("normal", t, plant.normal)
    log.add("door", t, np.array([plant.angle, plant.rate]))
    log.add("door_estimated", t, agent.door)
    log.add("force_measured", t, -agent.force)
    log.add("force_planned", t, -plans.current.feedforward(t)[-3:])
    log.add("pushing", t, float(agent.phase == "push"))
    log.add("touching", t, float(agent.contact.touching))
    log.add("impedance", t, agent.impedance)


def normal_force(log: Log) -> np.ndarray:
    """The true force (n,) [N] of the hand on the panel along its normal."""
    return np.sum(log.array("force") * log.array("normal"), axis=1)

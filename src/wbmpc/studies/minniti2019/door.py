"""`rezero-door`: the ball robot pushes a door open with a wanted force (Minniti et al. 2019, section IV-D, Fig. 8 and 9)."""

from __future__ import annotations

import logging
from functools import partial
from typing import Any

import numpy as np

from wbmpc.bases.ball.balance import Balance
from wbmpc.bases.ball.estimator import BallEstimator
from wbmpc.bases.ball.fall_detection import FallPredictor
from wbmpc.bases.ball.sent_torques import DriveSettings
from wbmpc.experiment import Experiment, Loop, Outcome, Part, Scenario
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Reference
from wbmpc.simulation.lockstep import Progress, Timing
from wbmpc.studies.minniti2019.door_control import DoorAgent, Push
from wbmpc.studies.minniti2019.door_figures import Trial, door_plots, metrics, worst_estimates
from wbmpc.studies.minniti2019.door_model import DoorGeometry
from wbmpc.studies.minniti2019.door_plant import HALF_THICKNESS, TIP_MASS, TIP_RADIUS, Door, DoorPlant
from wbmpc.studies.minniti2019.door_problem import door_problem, suited
from wbmpc.studies.minniti2019.door_settings import DOORS, RezeroDoorSettings
from wbmpc.studies.minniti2019.task import IDEALISATIONS, ball_robot, record_rezero

_LOG = logging.getLogger("wbmpc")
NAME = "rezero-door"
SUMMARY = "the ball robot pushes a door open with a wanted force (Minniti et al. 2019, Fig. 8 and 9)"
LABELS = ("low", "high")
#: Where the hand touches the panel, from the hinge; the gap before it [m].
LEVER, GAP = 0.7, 0.10
HERE = [
    "the door's hinge is where it is believed to be within misplaced; the closed panel's place is learnt from the touch",
    "only the rubber tip of the hand touches the door, and only its panel; the robot's body does not",
    "the force sensor has noise of 0.1 N and a bias of 0.1 N for each axis; it stands between hand and tip",
    "the closer's torque is constant, dry friction is Coulomb's",
]
#: What the controller believes of a door it has not opened: inertia [kg m²], damping [N m s/rad], resistance [N m].
NOMINAL = (2.56, 12.0, 3.5)


def make_plant(
    settings: RezeroDoorSettings, robot: RobotModel, home: np.ndarray, torque: np.ndarray, seed: int
) -> DoorPlant:
    """The robot before a door that stands up to ``misplaced`` away from where it is believed to be."""
    error = np.random.default_rng([seed, 23]).uniform(-settings.misplaced, settings.misplaced, 2)
    hinge = np.array(believed(robot.pose(home)[0]).hinge) + error
    door = Door((float(hinge[0]), float(hinge[1])), **DOORS[settings.door])
    return DoorPlant(robot.description, door, home, torque, settings.plant, seed=seed, payload=settings.payload)


def believed(hand: np.ndarray) -> DoorGeometry:
    """The door as the controller believes it to stand before the hand (3) [m] at the start."""
    offset = TIP_RADIUS + HALF_THICKNESS
    return DoorGeometry((float(hand[0] + GAP + offset), float(hand[1] + LEVER)), -np.pi / 2, 1.0, offset)


def held(settings: RezeroDoorSettings, robot: RobotModel) -> float:
    """The steady force [N] on the hand that the limit of the lean holds at home; infinite without that limit.

    A door that gives way takes the force from a robot that leans for it: what the lean then needs to be stopped is left over by
    ``hold``. (Rezero: 35 N. Pushed with 30 N it ran after doors and fell, tuning seeds 1 and 6.)"""
    if settings.cost.lean == 0.0:
        return np.inf
    balance = Balance.of(robot, robot.home[robot.state["arm"]])
    return settings.cost.lean * float(balance.reach.min()) / balance.answer


def bounded(settings: RezeroDoorSettings, robot: RobotModel, force: float) -> tuple[float, str]:
    """The force [N] to push with where ``force`` is asked for, and a sentence (a warning too) if it is less."""
    most = settings.hold * held(settings, robot)
    if force <= most:
        return force, ""
    told = f"pushed with {most:.1f} N only: of what the lean can hold, the rest is for doors that give way (hold)"
    _LOG.warning("%s, at %g N", told, force)
    return most, told


def push_door(settings: RezeroDoorSettings, force: float, seed: int, progress: Progress | None = None) -> Trial:
    """One run with the reference ``force`` [N]."""
    robot = ball_robot(settings, settings.weigh and settings.observer, contact="force")
    home, torque = robot.base.numeric.equilibrium(robot.home[robot.state["arm"]])
    geometry = believed(robot.pose(home)[0])
    push = settings.push or suited(settings.scheme)
    mpc = MPC(
        door_problem(robot, settings.mpc, settings.cost, push, settings.scheme, geometry.opening),
        settings.mpc.solver(), settings.mpc.rate,
        plan_only_limits=True,  # the friction cone, whose axes are the door's
    )  # fmt: skip
    plant = make_plant(settings, robot, home, torque, seed)
    timing = Timing.of(plant.timestep, settings.control.rate, settings.mpc.rate, settings.mpc.delay)
    possible, told = bounded(settings, robot, force)
    agent = make_agent(settings, possible, robot, mpc, home, torque, timing.period, geometry)
    log = Log()

    def record(t: float, command: Any, plans: Any) -> None:
        record_rezero(log, t, plant, agent, command.torque)
        record_door(log, t, plant, agent, plans)

    duration = settings.settle + settings.patience + settings.rest
    outcome = Loop(plant, agent, mpc, timing, duration, record).run(progress)
    return Trial(force, log, outcome.ending, mpc, (*filter(None, [told]), *outcome.faults))


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
    estimator = BallEstimator(robot, home) if settings.estimator == "filter" else None
    agent = DoorAgent(
        robot,
        mpc,
        push,
        geometry,
        np.array(NOMINAL),
        settings.scheme.identify,
        torque,
        period,
        DriveSettings(settings.drive_lag, settings.drive_dead_time),
        settings.observer,
        estimator,
        FallPredictor(robot, robot.home[robot.state["arm"]]),
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
    log.add("force_sensorless", t, -agent.sensorless.force)
    log.add("force_planned", t, -plans.current.feedforward(t)[-3:])
    log.add("pushing", t, float(agent.phase == "push"))
    log.add("touching", t, float(agent.contact.touching))
    log.add("impedance", t, agent.impedance)
    log.add("hand_wanted", t, agent.mpc.reference["hand"].at(t)[:3])


def build(settings: RezeroDoorSettings, seed: int) -> Scenario:
    """A run for each force, weakest first; a fall ends it."""
    trials: list[Trial] = []

    def push(force: float, progress: Progress | None) -> Outcome:
        trials.append(push_door(settings, force, seed, progress))
        log.extend(trials[-1].log, f"_{names[len(trials) - 1]}")
        return Outcome(trials[-1].ending, trials[-1].faults, None, trials[-1].mpc)

    names, log = LABELS[-len(settings.forces) :], Log()
    return Scenario(
        log, [Part(f"{force:g} N", partial(push, force)) for force in sorted(settings.forces)],
        lambda run: {**metrics(trials, names, settings.rise), **worst_estimates(trials)},
        lambda run: [plot for name, t in zip(names, trials, strict=False) for plot in door_plots(name, t, settings)],
        [*HERE, *IDEALISATIONS],
    )  # fmt: skip


EXPERIMENT = Experiment.of(NAME, SUMMARY, RezeroDoorSettings, build)

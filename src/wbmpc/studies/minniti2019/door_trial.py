"""One push of a ball robot against a door: the door that is drawn, the controller, the run and its record."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from wbmpc.bases.ball.balance import Balance
from wbmpc.bases.ball.fall_detection import FallPredictor
from wbmpc.bases.ball.model import ball_base
from wbmpc.bases.ball.sent_torques import DriveSettings
from wbmpc.constants import GRAVITY
from wbmpc.experiment import Loop
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Reference
from wbmpc.simulation.lockstep import Progress
from wbmpc.studies.force_tip import TIP_MASS, TIP_RADIUS
from wbmpc.studies.minniti2019.door_control import FAR, DoorController, PossibleForce
from wbmpc.studies.minniti2019.door_figures import Trial
from wbmpc.studies.minniti2019.door_model import DoorGeometry
from wbmpc.studies.minniti2019.door_plant import HALF_THICKNESS, Door, DoorPlant
from wbmpc.studies.minniti2019.door_problem import EstimatedCone, FreeApproach, default_push_cost, door_problem
from wbmpc.studies.minniti2019.door_settings import DOORS, DoorSettings, RezeroDoorSettings
from wbmpc.studies.minniti2019.door_tracker import Push
from wbmpc.studies.minniti2019.task import RezeroRecord, ball_robot, estimator_of
from wbmpc.types import Timing

_LOG = logging.getLogger("wbmpc")
#: Where the end effector touches the panel, from the hinge; the gap before it [m].
LEVER, GAP = 0.7, 0.10
#: A panel reaches at least so far [m] beyond where it is pushed; what of a door is drawn.
EDGE, DRAWN = 0.08, ("width", "mass", "friction", "closer", "damping", "breakaway")
#: What the controller believes of a door it has not opened: inertia [kg m²], damping [N m s/rad], resistance [N m].
NOMINAL = (2.56, 12.0, 3.5)


def make_plant(settings: DoorSettings, robot: RobotModel, home: np.ndarray, torque: np.ndarray, seed: int) -> DoorPlant:
    """The robot before a door of the chosen kind, drawn (:func:`drawn_door`)."""
    door = drawn_door(settings, believed(robot.pose(home)[0]).hinge, seed)
    return DoorPlant(robot.description, door, home, torque, settings.perturbation, seed=seed, payload=settings.payload)


def drawn_door(settings: DoorSettings, hinge: tuple[float, float], seed: int) -> Door:
    """A door that stands up to ``door_position_error`` away from a ``hinge`` (2) [m], and whose numbers, and the hinge's distance from
    where it is pushed, differ by up to ``door_spread`` from those of its kind. It reaches beyond the end effector in any case."""
    rng = np.random.default_rng([seed, 23])
    x, y = np.array(hinge) + rng.uniform(-settings.door_position_error, settings.door_position_error, 2)
    chosen = DOORS[settings.door] if isinstance(settings, RezeroDoorSettings) else {}
    kind = {**{n: getattr(Door, n) for n in DRAWN}, **chosen}
    numbers = {n: kind[n] * (1.0 + settings.door_spread * rng.uniform(-1.0, 1.0)) for n in DRAWN}
    shift = LEVER * settings.door_spread * float(rng.uniform(-1.0, 1.0))
    numbers["width"] = max(numbers["width"], LEVER + shift + EDGE)
    return Door((float(x), float(y) + shift), **{**kind, **numbers})


def believed(end_effector: np.ndarray) -> DoorGeometry:
    """The door as the controller believes it to stand before the end effector (3) [m] at the start."""
    offset = TIP_RADIUS + HALF_THICKNESS
    return DoorGeometry(
        (float(end_effector[0] + GAP + offset), float(end_effector[1] + LEVER)), -np.pi / 2, 1.0, offset
    )


def held(settings: DoorSettings, robot: RobotModel) -> float:
    """The steady force [N] on the end effector that the limit of the lean holds at home; infinite without that limit.

    A door that gives way takes the force from a robot that leans for it: what the lean then needs to be stopped is left over by
    ``lean_share``. (Rezero: 35 N. Pushed with 30 N it ran after doors and fell, tuning seeds 1 and 6.)"""
    if settings.controller.cost.lean == 0.0:
        return np.inf
    balance = Balance.of(robot, robot.home[robot.state["arm"]])
    return settings.controller.cost.lean * float(balance.reach.min()) / balance.answer


def bounded(settings: DoorSettings, robot: RobotModel, force: float) -> tuple[float, str]:
    """The force [N] to push with where ``force`` is asked for, and a message (a warning too) if it is less."""
    maximum = settings.lean_share * held(settings, robot)
    if force <= maximum:
        return force, ""
    fault = (
        f"pushed with {maximum:.1f} N only: of what the lean can hold, the rest is for doors that give way (lean_share)"
    )
    _LOG.warning("%s, at %g N", fault, force)
    return maximum, fault


#: Of settings, robot, state and torques at the start, and seed.
PlantOf = Callable[[DoorSettings, RobotModel, np.ndarray, np.ndarray, int], DoorPlant]


def push_door(
    settings: DoorSettings, force: float, speed: float, seed: int, progress: Progress | None = None,
    made: PlantOf = make_plant,
) -> Trial:  # fmt: skip
    """One run with the reference ``force`` [N], before a door that is ``made``; ``speed`` [m/s] of the approach at its start."""
    chosen = settings.controller
    robot, planning = ball_robot(settings, chosen.payload, contact="force"), chosen.planning(settings.mpc)
    home, torque = ball_base(robot).numeric.equilibrium(robot.home[robot.state["arm"]])
    geometry = believed(robot.pose(home)[0]).moved(-settings.scheme.nearer)
    push = settings.push or default_push_cost(settings.scheme)
    mpc = MPC(
        door_problem(robot, planning, chosen.cost, chosen.speed_slack, push, settings.scheme, geometry.opening),
        planning.solver(), planning.rate,
        guess=PossibleForce(getattr(settings.scheme.cone, "min_push", None)), plan_only_limits=True,  # the friction cone, whose axes are the door's
    )  # fmt: skip
    plant = made(settings, robot, home, torque, seed)
    timing = Timing.of(plant.timestep, settings.control.rate, settings.mpc.rate, settings.mpc.computation_delay)
    possible, fault = bounded(settings, robot, force)
    controller = make_controller(settings, possible, speed, robot, mpc, home, torque, timing.period, geometry)
    log = Log()
    rows = RezeroRecord(log, plant, controller)

    def record(t: float, command: Any, plans: Any) -> None:
        rows.add(t, command.torque)
        record_door(log, t, plant, controller, plans)

    duration = settings.settle_time + settings.timeout + settings.final_hold_time
    outcome = Loop(plant, controller, mpc, timing, duration, record).run(progress)
    return Trial(force, log, outcome.ending, mpc, (*filter(None, [fault]), *outcome.faults))


def make_controller(
    settings: DoorSettings, force: float, speed: float, robot: RobotModel, mpc: MPC, home: np.ndarray, torque: np.ndarray,
    period: float, geometry: DoorGeometry,
) -> DoorController:  # fmt: skip
    """The controller at home, with its references and what it is to do."""
    end_effector, quaternion = robot.pose(home)
    approach = settings.scheme.approach
    target = lambda t: force * float(np.clip(t / max(settings.rise_time, 1e-9), 0.0, 1.0))
    push = Push(
        target, end_effector, quaternion, settings.settle_time, speed, settings.opening_angle, settings.settle_time + settings.timeout,
        back=0.15, reach=GAP + 0.05, tip_weight=TIP_MASS * GRAVITY,
        fastest=None if isinstance(approach, FreeApproach) else approach.fastest, lead=settings.scheme.lead,
        friction=settings.scheme.friction, learns=isinstance(settings.scheme.cone, EstimatedCone),
    )  # fmt: skip
    for body in ("body", "push_body"):
        mpc.reference[body] = Reference.constant(home)
    for twist in ("twist", "push_twist"):
        mpc.reference[twist] = Reference.constant(np.zeros(6))
    mpc.reference["torque"] = Reference.constant(torque)
    if "approach" in mpc.ocp.terms:
        mpc.reference["approach"] = Reference.constant(np.full(1, FAR))
    if "panel" in mpc.ocp.terms:
        mpc.reference["panel"] = Reference.constant(np.full(1, FAR))
    for pose in ("end_effector", "turn"):
        mpc.reference[pose] = Reference.poses([0.0], end_effector, quaternion)
    controller = DoorController(
        robot, mpc, push, geometry, np.array(NOMINAL), settings.scheme.identify, torque, period,
        DriveSettings(settings.actuator_time_constant, settings.controller.actuator_dead_time), settings.controller.learns,
        estimator_of(settings.controller, robot, home), FallPredictor(robot, robot.home[robot.state["arm"]]),
    )  # fmt: skip
    mpc.solver.set_parameters(controller.parameters())
    start = np.concatenate([home, controller.door]) if controller.with_door else home
    mpc.reset(start, np.concatenate([torque, np.zeros(3)]))
    return controller


#: Names and units of the components of what :func:`record_door` records.
_CHANNELS: tuple[tuple[str, Sequence[str], str | Sequence[str]], ...] = (
    *((channel, "xyz", "N") for channel in ("force", "force_measured", "force_sensorless", "force_planned")), ("normal", "xyz", "1"),
    *((channel, ("angle", "rate"), ("rad", "rad/s")) for channel in ("door", "door_estimated")), ("grip", ("coefficient",), "1"),
    ("sliding", ("along the panel", "up"), "m/s"), ("hand_wanted", "xyz", "m"),
    ("impedance", ("inertia", "damping", "resistance"), ("kg m²", "N m s/rad", "N m")),
)  # fmt: skip


def record_door(log: Log, t: float, plant: DoorPlant, controller: DoorController, plans: Any) -> None:
    """Forces, door and phases."""
    for channel, names, units in _CHANNELS:
        log.label(channel, names, units)
    log.add("force", t, plant.contact_force())
    log.add("normal", t, plant.normal)
    log.add("door", t, np.array([plant.angle, plant.rate]))
    log.add("door_estimated", t, controller.door)
    log.add("force_measured", t, -controller.force)
    log.add("force_sensorless", t, -controller.sensorless.force)
    log.add("force_planned", t, -plans.current.feedforward(t)[-3:])
    log.add("sliding", t, controller.sliding)
    if np.isfinite(controller.friction):
        log.add("grip", t, controller.friction)
    log.add("pushing", t, float(controller.phase == "push"))
    log.add("penetration", t, plant.penetration)
    log.add("touching", t, float(controller.contact.touching))
    log.add("impedance", t, controller.impedance)
    log.add("hand_wanted", t, controller.mpc.reference["end_effector"].at(t)[:3])

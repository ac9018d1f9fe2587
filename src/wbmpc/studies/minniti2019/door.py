"""`rezero-door`: the ball robot pushes a door open with a wanted force (Minniti et al. 2019, section IV-D, Fig. 8 and 9)."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from wbmpc import lie
from wbmpc.bases.ball.balance import Balance
from wbmpc.bases.ball.defaults import BodyCost, HandCost, RezeroCost, TorqueCost
from wbmpc.bases.ball.estimator import BallEstimator
from wbmpc.bases.ball.fall_detection import FallPredictor
from wbmpc.experiments import Experiment
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Reference
from wbmpc.result import Metric, Plot, RunResult, Series
from wbmpc.settings import finished
from wbmpc.simulation.lockstep import Ending, Progress, Timing, part, run_lockstep
from wbmpc.studies.minniti2019.door_control import DoorAgent, Push
from wbmpc.studies.minniti2019.door_model import DoorGeometry
from wbmpc.studies.minniti2019.door_plant import HALF_THICKNESS, TIP_MASS, TIP_RADIUS, Door, DoorPlant
from wbmpc.studies.minniti2019.door_problem import DoorScheme, PushCost, door_problem, suited
from wbmpc.studies.minniti2019.task import (
    IDEALISATIONS,
    RezeroSettings,
    ball_robot,
    estimator_metrics,
    hand_felt,
    record_rezero,
    rms,
)

_LOG = logging.getLogger("wbmpc")
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
#: The peak of the touch is looked for in this time after it [s]; how the hand rests, in this time before the end.
TOUCH, REST = 0.1, 1.0
LABELS = ("low", "high")
HERE = [
    "the door's hinge is where it is believed to be within misplaced; the closed panel's place is learnt from the touch",
    "only the rubber tip of the hand touches the door, and only its panel; the robot's body does not",
    "the force sensor has noise of 0.1 N and a bias of 0.1 N for each axis; it stands between hand and tip",
    "the closer's torque is constant, dry friction is Coulomb's",
]
#: What the controller believes of a door it has not opened: inertia [kg m²], damping [N m s/rad], resistance [N m].
NOMINAL = (2.56, 12.0, 3.5)


class RezeroDoorSettings(RezeroSettings):
    """``forces`` [N] along the normal, a run each, reached ``rise`` [s] after the touch; ``door``: its kind; ``settle`` [s] before
    the hand starts, with ``speed`` [m/s]; it lets go at ``open`` [rad], or ``patience`` [s] after it started; the run ends
    ``rest`` [s] after the latest of that. ``scheme``: what of the door the problem knows; ``push``: weights while it pushes
    (what is left out: as suits the scheme); ``misplaced`` [m]: the door's place is not known better; ``hold``: a force beyond this
    share of what the lean's limit holds at home (:func:`held`) is not pushed with; this share is, and it is told."""

    cost: RezeroCost = RezeroCost(
        hand=HandCost(weight=300.0, orientation=30.0, limit=0.05, twist=1.0, angular=0.05),
        body=BodyCost(ball_speed=1.0, tilt_rate=5.0, arm=1.0),
        torque=TorqueCost(wheel=0.2, arm=0.3),
        lean=0.6,
        speed_slack=20.0,
    )
    scheme: DoorScheme = DoorScheme()
    push: PushCost | None = None
    door: Literal["free", "heavy", "sticking", "light", "locked"] = "free"
    forces: tuple[Annotated[float, Field(gt=0, le=200.0)], ...] = Field((8.0, 16.0), min_length=1, max_length=2)
    rise: float = Field(0.3, ge=0, le=10.0)
    settle: float = Field(3.0, ge=0.5, le=60.0)
    speed: float = Field(0.1, gt=0, le=1.0)
    open: float = Field(float(np.deg2rad(60.0)), gt=0, le=2.0)
    patience: float = Field(9.0, ge=1.0, le=120.0)
    rest: float = Field(2.0, ge=0.1, le=60.0)
    misplaced: float = Field(0.01, ge=0, le=0.05)
    hold: float = Field(0.6, gt=0, le=10.0)

    unused: ClassVar[tuple[str, ...]] = (
        *RezeroSettings.unused, "controller", "rival", "tracking", "brace", "pushed_speed", "cost.hand.turn_limit",
    )  # fmt: skip

    def idle(self) -> dict[str, str]:
        scheme, out = self.scheme, super().idle()
        if not scheme.row:
            out |= dict.fromkeys(("scheme.door_rate", "scheme.baumgarte"), "scheme.row=false")
        if not scheme.cone:
            out |= dict.fromkeys(("scheme.friction", "scheme.least"), "scheme.cone=false")
        if self.cost.lean == 0.0:
            out["hold"] = "cost.lean=0"
        return out

    @field_validator("push", mode="before")
    @classmethod
    def _suit_the_scheme(cls, push: Any, info: ValidationInfo) -> Any:
        """Some weights as a mapping: the others are those of the scheme."""
        scheme = info.data.get("scheme")  # missing where it is wrong itself
        return {**suited(scheme).model_dump(), **push} if isinstance(push, Mapping) and scheme else push


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


@dataclass(frozen=True)
class Trial:
    """One door pushed with one force [N]: what was recorded, how it ended, what was found out about the robot."""

    force: float
    log: Log
    ending: Ending
    mpc: MPC
    faults: tuple[str, ...] = ()


def push_door(settings: RezeroDoorSettings, force: float, seed: int, progress: Progress | None = None) -> Trial:
    """One run with the reference ``force`` [N]."""
    robot = ball_robot(settings, settings.weigh and settings.observer, contact="force")
    home, torque = robot.equilibrium(robot.home[robot.state["arm"]])
    geometry = believed(robot.pose(home)[0])
    push = settings.push or suited(settings.scheme)
    mpc = MPC(
        door_problem(robot, settings.mpc, settings.cost, push, settings.scheme, geometry.opening),
        settings.mpc.solver(), settings.mpc.rate,
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
    ending = run_lockstep(plant, agent, mpc, timing, duration, record, progress)
    return Trial(force, log, ending, mpc, (*filter(None, [told]), *agent.faults))


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
        settings.drive_lag,
        settings.observer,
        estimator,
        FallPredictor(robot, robot.home[robot.state["arm"]]),
        settings.drive_dead_time,
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


# ---------------------------------------------------------------------- figures
def normal_force(log: Log) -> np.ndarray:
    """The true force (n,) [N] of the hand on the panel along its normal."""
    force: np.ndarray = np.sum(log.array("force") * log.array("normal"), axis=1)
    return force


def lean(log: Log) -> np.ndarray:
    """How far (n,) [rad] the base leans towards the panel, against how it stands at the start."""
    up = np.array([lie.euler_zyx_to_rotation(*x[2:5])[:, 2] for x in log.array("state")])
    angle: np.ndarray = np.arcsin(np.sum((up - up[0]) * log.array("normal"), axis=1))
    return angle


def pushed(log: Log, rise: float) -> tuple[float, np.ndarray]:
    """The time [s] of the first touch (infinite: none) and which samples (n,) count: from ``rise`` [s] after it to the
    release."""
    t, force = log.times("force"), normal_force(log)
    hit = np.flatnonzero(force > 0.0)
    touch = float(t[hit[0]]) if hit.size else np.inf
    return touch, (t >= touch + rise) & (log.array("pushing") > 0.0)


def trial_metrics(trial: Trial, rise: float) -> dict[str, float]:
    """Figures of one run: force error over the reference (lost contact counts in full), peak of the touch [N], share of
    the time in contact, mean lean [rad], largest angle of the door [rad], rms error of the force estimated without the
    sensor [N], how far the hand swings at rest and is from where it is wanted [m], whether it fell."""
    log, wanted = trial.log, trial.force
    touch, use = pushed(log, rise)
    force, t = normal_force(log), log.times("force")
    counted = force[use]
    without_sensor = np.sum(log.array("force_sensorless") * log.array("normal"), axis=1)[use] - counted
    return {
        "force_error_ratio": float(np.sqrt(np.mean((counted - wanted) ** 2)) / wanted) if counted.size else np.inf,
        "touch_peak": float(force[(t >= touch) & (t < touch + TOUCH)].max(initial=0.0)),
        "contact_share": float(np.mean(counted > 0.0)) if counted.size else 0.0,
        "lean_mean": float(lean(log)[use].mean()) if counted.size else 0.0,
        "door_angle_max": float(log.array("door")[:, 0].max()),
        "force_estimate_error_rms": float(np.sqrt(np.mean(without_sensor**2))) if counted.size else np.inf,
        **rest(trial),
        "fell": float(trial.ending.fell),
    }


def rest(trial: Trial) -> dict[str, float]:
    """The hand in the last :data:`REST` after the release: its largest swing, peak to peak along an axis (true), and the rms of its
    distance from where it is wanted, as the controller sees it [m]; infinite for a run that did not get there."""
    log = trial.log
    t, pushing = log.times("hand"), np.flatnonzero(log.array("pushing") > 0.0)
    use = t > t[-1] - REST
    if trial.ending.reason or not pushing.size or use[pushing[-1]]:
        return {"rest_hand_swing": np.inf, "rest_hand_error": np.inf}
    return {
        "rest_hand_swing": float(np.ptp(log.array("hand")[use], axis=0).max()),
        "rest_hand_error": rms((hand_felt(log) - log.array("hand_wanted"))[use]),
    }


def run(settings: RezeroDoorSettings, seed: int, progress: Progress | None = None) -> RunResult:
    """A run for each force, weakest first; a fall ends it."""
    trials: list[Trial] = []
    for k, force in enumerate(sorted(settings.forces)):
        trials.append(push_door(settings, force, seed, part(progress, k, len(settings.forces), f"{force:g} N")))
        if trials[-1].ending.reason:
            break
    names = LABELS[-len(settings.forces) :]
    log, figures = merged(trials, names), {}
    for name, trial in zip(names, trials, strict=False):
        figures[name] = trial_metrics(trial, settings.rise)
    result = finished(
        NAME, seed, settings, trials[-1].ending, trials[-1].mpc, log,
        metrics=lambda: {**metrics(figures, names), **worst_estimates(trials)},
        plots=lambda: [plot for name, t in zip(names, trials, strict=False) for plot in door_plots(name, t, settings)],
        idealisations=[*HERE, *IDEALISATIONS],
    )  # fmt: skip
    result.faults = [f"{fault}, at {trial.force:g} N" for trial in trials for fault in trial.faults]
    return result


def merged(trials: list[Trial], names: Sequence[str]) -> Log:
    """One log with the channels CHANNEL_NAME of every run."""
    log = Log()
    for name, trial in zip(names, trials, strict=False):
        for channel in trial.log.channels:
            for t, row in zip(trial.log.times(channel), trial.log.array(channel), strict=True):
                log.add(f"{channel}_{name}", t, row)
    return log


def metrics(figures: dict[str, dict[str, float]], names: Sequence[str]) -> dict[str, Metric]:
    """The figures by name, those of all runs last; a run that did not happen is infinitely bad."""
    out: dict[str, Metric] = {}
    for name in names:
        f = figures.get(name, {"force_error_ratio": np.inf, "contact_share": 0.0, "lean_mean": np.inf})
        out[f"force_error_ratio_{name}"] = Metric(f["force_error_ratio"], "1", goal=0.10)
        out[f"contact_share_{name}"] = Metric(f["contact_share"], "1")
        out[f"lean_mean_{name}"] = Metric(f["lean_mean"], "rad")
    most = lambda key: max(f[key] for f in figures.values())
    out["touch_peak"] = Metric(most("touch_peak"), "N")
    out["force_estimate_error_rms"] = Metric(most("force_estimate_error_rms"), "N")
    out["door_angle_max"] = Metric(most("door_angle_max"), "rad")
    out["rest_hand_swing"] = Metric(most("rest_hand_swing"), "m")
    out["rest_hand_error"] = Metric(most("rest_hand_error"), "m")
    out["fell"] = Metric(most("fell"), "1", goal=0.0)
    return out


def worst_estimates(trials: list[Trial]) -> dict[str, Metric]:
    """The estimator's figures, the worst of all runs."""
    found = [estimator_metrics(trial.log) for trial in trials]
    return {k: Metric(max(f[k].value for f in found), m.unit) for k, m in found[0].items()}


def door_plots(name: str, trial: Trial, settings: RezeroDoorSettings) -> list[Plot]:
    """The paper's Fig. 9 for one force, with what was planned; door, impedance and torques."""
    log, wanted = trial.log, trial.force
    t, normal, state = log.times("force"), log.array("normal"), log.array("state")
    touch, _ = pushed(log, settings.rise)
    along = lambda channel: np.sum(log.array(channel) * normal, axis=1)
    tangential = np.linalg.norm(log.array("force") - normal_force(log)[:, None] * normal, axis=1)
    reference = wanted * np.clip((t - touch) / max(settings.rise, 1e-9), 0.0, 1.0) * log.array("pushing")
    label = f"{wanted:g} N"
    door, believed_door = np.rad2deg(log.array("door")), np.rad2deg(log.array("door_estimated"))
    impedance, first = log.array("impedance"), np.maximum(np.abs(log.array("impedance")[0]), 1e-9)
    parts = zip(("inertia", "damping", "resistance"), (impedance / first).T, strict=True)
    return [
        Plot(f"Force at the hand, reference {label} (Fig. 9, above)", "time [s]", "force [N]", [
            Series("along the normal, true", t, normal_force(log)), Series("measured, in contact", t, along("force_measured")),
            Series("estimated without the sensor", t, along("force_sensorless")),
            Series("planned", t, along("force_planned")), Series("reference", t, reference, dashed=True),
            Series("tangential", t, tangential),
        ]),
        Plot(f"Base, reference {label} (Fig. 9, below)", "time [s]", "angle [deg]", [
            Series("pitch", t, np.rad2deg(state[:, 3])), Series("roll", t, np.rad2deg(state[:, 4])),
            Series("lean into the door", t, np.rad2deg(lean(log))),
            Series("in contact (times 10)", t, 10.0 * (normal_force(log) > 0.0), dashed=True),
        ]),
        Plot(f"Door, reference {label}", "time [s]", "angle [deg], rate [deg/s]", [
            Series("angle", t, door[:, 0]), Series("angle, believed", t, believed_door[:, 0], dashed=True),
            Series("rate", t, door[:, 1]), Series("rate, believed", t, believed_door[:, 1], dashed=True),
        ]),
        Plot(f"Believed impedance over the first guess, reference {label}", "time [s]", "ratio", [
            Series(part, t, values) for part, values in parts
        ]),
        Plot(f"From above, reference {label}", "x [m]", "y [m]", [
            Series("hand", *log.array("hand")[:, :2].T), Series("ball", *state[:, :2].T),
        ], equal_axes=True),
    ]  # fmt: skip


EXPERIMENT = Experiment(NAME, SUMMARY, RezeroDoorSettings, run)

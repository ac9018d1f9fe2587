"""Scenarios that press against hard limits, for both robots, all in MuJoCo with the protocol's perturbations.

Each builds a :class:`Rig`: plant, controller, MPC, and what happens to them at which time. All draws come from the seed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from wbmpc.bases.ball.controller import BallController
from wbmpc.bases.ball.defaults import RezeroCost, rezero_problem, set_home_references
from wbmpc.bases.ball.estimator import BallEstimator
from wbmpc.bases.ball.lean_control import LeanControl
from wbmpc.bases.ball.plant import BallPlant
from wbmpc.bases.ball.sent_torques import DriveSettings
from wbmpc.bases.ball.settings import PUSHED_SPEED, STEPS_AND_PUSHES, mpc_settings
from wbmpc.bases.swerve.controller import SwerveController
from wbmpc.bases.swerve.defaults import StateCost, SwerveCost, swerve_problem
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.bases.swerve.tracking import TrackingSettings
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Mode, ModeSchedule, Reference
from wbmpc.settings import MpcSettings
from wbmpc.solver import SQP
from wbmpc.studies.minniti2019.steps import RezeroStepsSettings
from wbmpc.studies.paths import SinePath
from wbmpc.types import Timing

Array = np.ndarray
Event = tuple[float, Callable[[], None]]


@dataclass(frozen=True)
class Variant:
    """How the limits are treated; ``reset``: whether every solve starts from slacks at the iterate."""

    limits: str = "hard"
    iterations: int = 1
    reset: bool = True
    changes: dict[str, Any] = field(default_factory=dict)

    def mpc(self, make: Callable[[MpcSettings], Any], settings: MpcSettings) -> MPC:
        """The MPC of a problem under this variant."""
        settings = settings.model_copy(update={"limits": self.limits, "iterations": self.iterations})
        solver: SQP = settings.solver()
        interior = replace(solver.interior_point, reset=self.reset, **({"max_extra_iterations": MORE} | self.changes))
        return MPC(make(settings), replace(solver, interior_point=interior), settings.rate)


#: Further iterations of a solve at most, while its step is cut: where goals jump, three do not always do.
MORE = 10
VARIANTS = {
    "hard": Variant(),
    "soft": Variant("soft"),
    "hard, 10 iterations": Variant(iterations=10),
    "hard, slacks kept": Variant(reset=False),
    "hard, never more": Variant(changes={"max_extra_iterations": 0}),
}
#: μ of both robots' limits, hard and relaxed. The ball robot's is larger: it leaves the feedback on noisy speeds a reserve.
BALL_MU, SWERVE_MU = 0.5, 3e-3
#: The ball robot's plans per second, as many as ticks: at 80 Hz feedback carries a push for 12.5 ms, and with wheels near their
#: limit 1.4 % (worst of four runs 2.2 %) of the ticks of ``rezero-push`` ask for more than there is.
BALL_RATE = 400.0
#: Weights of the experiments, but with a penalty of arm speeds that is stiff enough to be exact.
BALL_COST = STEPS_AND_PUSHES.model_copy(update={"speed_slack": 1e3})


@dataclass
class Rig:
    """One run before it starts. ``goal(t)``: where the end effector is to be [m]; ``events``: (time [s], action), in order."""

    robot: RobotModel
    mpc: MPC
    plant: Any
    controller: Any
    timing: Timing
    duration: float
    goal: Callable[[float], Array] = lambda t: np.zeros(3)
    events: list[Event] = field(default_factory=list)


def narrowed(robot: RobotModel, **limits: Any) -> RobotModel:
    """The same robot with other limits (mappings replace the named joints' entries)."""
    d = robot.description
    merged = {k: {**getattr(d.limits, k), **v} if isinstance(v, dict) else v for k, v in limits.items()}
    return RobotModel(d.model_copy(update={"limits": d.limits.model_copy(update=merged)}))


def direction(rng: np.random.Generator, size: int = 2) -> Array:
    """A random unit vector in the plane or in space, as (3)."""
    v = rng.normal(size=size)
    return np.concatenate([v / np.linalg.norm(v), np.zeros(3 - size)])


# ---------------------------------------------------------------------- ball robot
def _rezero(robot: RobotModel, variant: Variant, seed: int, duration: float, cost: RezeroCost = BALL_COST) -> Rig:
    settings = RezeroStepsSettings()
    planner = mpc_settings(BALL_MU).model_copy(update={"rate": BALL_RATE})
    home, torque = robot.base.numeric.equilibrium(robot.home[robot.state["arm"]])
    mpc = variant.mpc(lambda s: rezero_problem(robot, s, cost), planner)
    set_home_references(mpc, robot, torque)
    plant = BallPlant(robot.description, home, torque, settings.perturbation, seed)
    timing = Timing.of(plant.timestep, settings.control.rate, planner.rate, planner.computation_delay)
    estimator = BallEstimator(robot, home)
    controller = BallController(
        robot, mpc, torque, timing.period, DriveSettings(settings.actuator_time_constant), estimator=estimator
    )
    controller.learned.lean_control = LeanControl(robot, robot.home[robot.state["arm"]], cost.lean, PUSHED_SPEED)
    mpc.reset(home, torque)
    rig = Rig(robot, mpc, plant, controller, timing, duration)
    _hold_goals(rig, [(0.0, np.zeros(3))])
    return rig


def _hold_goals(rig: Rig, goals: list[tuple[float, Array]]) -> None:
    """Sudden goals of the end effector: (time [s], shift from home [m]); the MPC does not see them before they come."""
    position, quaternion = rig.robot.pose(rig.robot.home)
    rig.goal = lambda t: position + next(shift for start, shift in reversed(goals) if start <= t)

    def ask(shift: Array) -> Callable[[], None]:
        def act() -> None:
            rig.mpc.reference["end_effector"] = Reference.poses([0.0], [position + shift], quaternion)

        return act

    ask(goals[0][1])()
    rig.events += [(start, ask(shift)) for start, shift in goals if start > 0.0]


def _push(rig: Rig, start: float, force: Array, body: str | None = None) -> list[Event]:
    return [
        (start, lambda: rig.plant.push(force, body=body)),
        (start + 0.2, lambda: rig.plant.push(0.0 * force, body=body)),
    ]


def rezero_push(variant: Variant, seed: int) -> Rig:
    """Two pushes of the base, 0.2 s, 100 to 150 N, any horizontal direction, while the end effector holds its position."""
    rng = np.random.default_rng([seed, 1])
    rig = _rezero(load_robot("rezero"), variant, seed, 5.0)
    for start in (0.5, 2.75):
        rig.events += _push(rig, start, rng.uniform(100.0, 150.0) * direction(rng))
    return rig


def rezero_step(variant: Variant, seed: int) -> Rig:
    """The end effector's goal jumps by 0.3 to 0.4 m in a horizontal direction, unseen, and back: wheel torques saturate.

    (With weights that pull harder the farther the goal is, and not those of the experiments, which spare the wheels.)
    """
    rng = np.random.default_rng([seed, 2])
    rig = _rezero(load_robot("rezero"), variant, seed, 5.0, RezeroCost())
    shift = rng.uniform(0.3, 0.4) * direction(rng)
    _hold_goals(rig, [(0.0, np.zeros(3)), (0.5, shift), (2.75, np.zeros(3))])
    return rig


def rezero_arm(variant: Variant, seed: int) -> Rig:
    """An arm of 7 N m, 1.2 rad/s and ±0.35 rad about home (yaw ±0.15): unseen goals up, down and sideways, and a push."""
    rng = np.random.default_rng([seed, 3])
    robot = load_robot("rezero")
    joints = robot.description.arm.joints
    home = {n: robot.description.home.get(n, 0.0) for n in joints}
    width = {n: 0.15 if n == "arm_yaw" else 0.35 for n in joints}
    position = {n: (home[n] - width[n], home[n] + width[n]) for n in joints}
    speed, effort = {n: 1.2 for n in joints}, {n: 7.0 for n in joints}
    rig = _rezero(narrowed(robot, velocity=speed, effort=effort, position=position), variant, seed, 5.0)
    up = rng.choice([-1.0, 1.0])
    first = np.array([*rng.uniform(-0.1, 0.1, 2), up * rng.uniform(0.1, 0.2)])
    second = np.array([*rng.uniform(-0.1, 0.1, 2), -up * rng.uniform(0.1, 0.2)])
    _hold_goals(rig, [(0.0, np.zeros(3)), (0.5, first), (2.0, second), (3.5, np.zeros(3))])
    rig.events += _push(rig, 2.5, rng.uniform(30.0, 60.0) * direction(rng))
    return rig


# ---------------------------------------------------------------------- swerve base
def _swerve(
    robot: RobotModel, variant: Variant, seed: int, duration: float, schedule: ModeSchedule | None = None,
    leg_weight: float = 1.0,
) -> Rig:  # fmt: skip
    settings, cost = MpcSettings(barrier_mu=SWERVE_MU), SwerveCost(state=StateCost(leg=leg_weight))
    mpc = variant.mpc(lambda s: swerve_problem(robot, s, cost, accelerations=True), settings)
    plant = SwervePlant(robot.description, robot.state.split(robot.home), None, seed)
    timing = Timing.of(plant.timestep, 400.0, settings.rate, settings.computation_delay)
    brakes = None
    if schedule is not None:
        mpc.set_schedule(schedule)
        brakes = lambda t: np.array(schedule.modes[schedule.index(t)].values["brake"])
    controller = SwerveController(
        robot, plant.truth().pose, timing.period, brakes, tracking=TrackingSettings(lag=0.020)
    )
    mpc.reset(robot.home)
    return Rig(robot, mpc, plant, controller, timing, duration)


def _follow(rig: Rig, t: Array, end_effector: Array, base: Array, leg: Array | None = None) -> None:
    """The end effector goes along ``end_effector`` (n, 3) from home [m], the base along ``base`` (n, 2), the legs along ``leg`` (n, 4)."""
    robot = rig.robot
    position, quaternion = robot.pose(robot.home)
    rig.mpc.reference["end_effector"] = Reference.poses(t, position + end_effector, quaternion)
    states = np.tile(robot.home, (t.size, 1))
    states[:, :2] += base
    if leg is not None:
        states[:, robot.state["leg"]] += leg
    inputs = np.zeros((t.size, robot.input.size))
    inputs[:, :2] = np.gradient(base, t, axis=0)
    rig.mpc.reference["state"], rig.mpc.reference["input"] = Reference(t, states), Reference(t, inputs)
    rig.goal = lambda now: position + np.array([np.interp(now, t, end_effector[:, i]) for i in range(3)])


def _sine(
    speed: float, amplitude: float, length: float, duration: float, periods: float = 1.0
) -> tuple[Array, Array, Array]:
    """Times, end effector and base of a sine beside the base's line; the speed rises within 1 s."""
    path = SinePath(amplitude, length * periods, periods, speed, start=0.3, ramp=1.0)
    t = np.arange(0.0, duration + 12.0, 0.02)
    along, across = path.point(t)
    return t, np.stack([along, across, 0.0 * t], axis=1), np.stack([along, 0.0 * t], axis=1)


def swerve_fast(variant: Variant, seed: int) -> Rig:
    """A sine of 0.2 to 0.35 m, run at 1.5 to 1.9 m/s: faster than base, wheels and arm may move."""
    rng = np.random.default_rng([seed, 4])
    rig = _swerve(load_robot("swerve-ur10"), variant, seed, 5.0)
    _follow(
        rig,
        *_sine(rng.uniform(1.5, 1.9), rng.choice([-1, 1]) * rng.uniform(0.2, 0.35), rng.uniform(1.8, 2.6), 5.0, 2.0),
    )
    return rig


def swerve_jump(variant: Variant, seed: int) -> Rig:
    """Corrections of the estimated pose by 0.15 to 0.3 m and 0.1 to 0.2 rad while the end effector follows a sine."""
    rng = np.random.default_rng([seed, 5])
    rig = _swerve(load_robot("swerve-ur10"), variant, seed, 5.0)
    _follow(rig, *_sine(0.255, 0.3, 2.66, 5.0))

    def jump(by: Array) -> Callable[[], None]:
        def act() -> None:
            rig.controller.estimator.odometry.place(rig.controller.estimator.odometry.pose + by)

        return act

    for start in (1.0, 2.7):
        by = rng.uniform(0.15, 0.3) * direction(rng)
        by[2] = rng.choice([-1.0, 1.0]) * rng.uniform(0.1, 0.2)
        rig.events.append((start, jump(by)))
    return rig


def swerve_push(variant: Variant, seed: int) -> Rig:
    """Two pushes of the base, 0.2 s, 300 to 500 N, any horizontal direction, while the end effector follows a sine."""
    rng = np.random.default_rng([seed, 8])
    rig = _swerve(load_robot("swerve-ur10"), variant, seed, 5.0)
    _follow(rig, *_sine(0.255, 0.3, 2.66, 5.0))
    for start in (1.0, 2.7):
        rig.events += _push(rig, start, rng.uniform(300.0, 500.0) * direction(rng))
    return rig


def swerve_brakes(variant: Variant, seed: int) -> Rig:
    """Two legs, then the other two, are opened for 1.6 to 2 s and asked to turn at 0.48 rad/s (limit 0.4) while driving."""
    rng = np.random.default_rng([seed, 6])
    pairs = [((0, 1), (2, 3)), ((0, 2), (1, 3)), ((0, 3), (1, 2))][rng.integers(3)]
    windows = []
    for k, start in enumerate((0.6, 3.1)):
        begin = start + rng.uniform(0.0, 0.3)
        windows.append((begin, begin + rng.uniform(1.6, 2.0), pairs[k]))
    modes, events = [Mode("0", {"brake": [0.0] * 4})], []
    for k, (begin, end, legs) in enumerate(windows):
        events += [begin, end]
        modes += [Mode(f"open{k}", {"brake": [float(i in legs) for i in range(4)]}), Mode(f"{k}", {"brake": [0.0] * 4})]
    rig = _swerve(
        load_robot("swerve-ur10"), variant, seed, 6.0, ModeSchedule(tuple(modes), tuple(events)), leg_weight=100.0
    )
    t, end_effector, base = _sine(0.2, 0.1, 2.66, 6.0)
    leg, home = np.zeros((t.size, 4)), rig.robot.home[rig.robot.state["leg"]]
    for begin, end, legs in windows:
        for i in legs:
            leg[:, i] += -np.sign(home[i]) * 0.48 * np.clip(t - begin, 0.0, end - begin)
    _follow(rig, t, end_effector, base, leg)
    return rig


def swerve_reach(variant: Variant, seed: int) -> Rig:
    """Arm joints held to ±0.35 rad about home; the end effector's goal jumps by 0.3 to 0.5 m in any direction, unseen, and back."""
    rng = np.random.default_rng([seed, 7])
    robot = load_robot("swerve-ur10")
    home = {n: robot.description.home.get(n, 0.0) for n in robot.description.arm.joints}
    robot = narrowed(robot, position={n: (q - 0.35, q + 0.35) for n, q in home.items()})
    rig = _swerve(robot, variant, seed, 5.0)
    t = np.array([0.0, 20.0])
    _follow(rig, t, np.zeros((2, 3)), np.zeros((2, 2)))
    shifts = [rng.uniform(0.3, 0.5) * direction(rng, 3) for _ in range(2)]
    _hold_goals(rig, [(0.0, np.zeros(3)), (0.5, shifts[0]), (2.0, shifts[1]), (3.5, np.zeros(3))])
    return rig


SCENARIOS: dict[str, Callable[[Variant, int], Rig]] = {
    "rezero-push": rezero_push,
    "rezero-step": rezero_step,
    "rezero-arm": rezero_arm,
    "swerve-fast": swerve_fast,
    "swerve-jump": swerve_jump,
    "swerve-push": swerve_push,
    "swerve-brakes": swerve_brakes,
    "swerve-reach": swerve_reach,
}

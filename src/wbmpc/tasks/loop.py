"""A closed loop of a robot, its simulated plant and an MPC, as a scenario: what is recorded of it, measured and drawn."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import or_
from typing import Any

import casadi as ca
import numpy as np

from wbmpc import checks, lie
from wbmpc.bases import base_type
from wbmpc.bases.base import System
from wbmpc.control.direct import DirectController
from wbmpc.errors import InputError
from wbmpc.experiment import Loop, Run, Scenario
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.alternatives import Alternatives
from wbmpc.mpc.mpc import MPC
from wbmpc.mpc.reference_pacing import PacedReferences
from wbmpc.obstacles.scene import SceneObstacle
from wbmpc.recording.observer import end_effector_goal
from wbmpc.result import Metric, Plot
from wbmpc.simulation.arm import ArmPlant
from wbmpc.simulation.lockstep import LONGEST_RUN
from wbmpc.simulation.model_plant import ModelPlant
from wbmpc.simulation.obstacles import SimulatedObstacles, load_scene
from wbmpc.tasks.estimates import estimate_watches
from wbmpc.tasks.figures import general_metrics, general_plots
from wbmpc.tasks.joint_figures import JointRecord
from wbmpc.tasks.perception import Perception, PerceptionSettings
from wbmpc.tasks.reference_drive import arm_zeros, calibration
from wbmpc.tasks.scene import SceneWatch, believed
from wbmpc.tasks.settings import KinematicPlant, SimulationSettings
from wbmpc.types import Edit, Timing, Truth

#: Rates of the controller without physics [Hz], of which the first counts that the MPC's rate is a whole part of; interval of what is
#: recorded [s].
MODEL_RATES, RECORDED = (200.0, 400.0), 0.01
#: End effectors of the MPC's model and of the simulated robot are at most this [m] from each other: a calibrated model is a little off.
SAME = 0.05
#: How much longer [s] than it was given a run takes at most whose robot goes other ways.
DETOURS = 60.0

IDEALIZATIONS = {
    "mujoco": ["tires are soft contacts, not a tire model", "the computation takes a constant time"],
    "kinematic": ["there is no physics: the planner's own model is simulated, and its state is known exactly"],
}
#: The same where the arm was calibrated.
TRACKED = ["the tracker of the arm's calibration knows the axes of the base exactly"]


def make_system(
    robot: RobotModel, mpc: MPC, settings: SimulationSettings, seed: int, edit: Edit | None = None
) -> System:
    """Plant and controller for an MPC on the robot's own dynamics; ``edit`` adds to MuJoCo's scene. Raises :class:`InputError` for another
    MPC's."""
    chosen = settings.plant
    if isinstance(chosen, KinematicPlant):
        whole = [rate for rate in MODEL_RATES if (rate / mpc.rate).is_integer()]
        rate = (whole or MODEL_RATES)[0]
        plant = ModelPlant(robot, mpc, mpc.solver.trajectory(0.0).x[0, : mpc.dynamics.state.size], 1.0 / rate, edit)
        timing = Timing.of(plant.timestep, rate, mpc.rate, settings.computation_delay)
        return System(plant, DirectController(robot, mpc, timing.period, feedback=True), mpc, timing)
    own = mpc.dynamics
    if (own.state.names, own.input.names) != (robot.state.names, robot.input.names):
        raise InputError(
            "plant: MuJoCo needs an MPC on the robot's own dynamics (robot.dynamics()); valid with others: kinematic"
        )
    more: dict[str, Any] = {} if edit is None else {"edit": edit}
    if chosen.calibration == "drive":
        known = calibration(robot, chosen.perturbation, seed)
        more |= {} if known is None else {"calibration": known}
    made = base_type(robot.description.base.type).system(robot, seed, chosen.perturbation, mpc, **more)
    if chosen.calibration == "drive" and isinstance(made.plant, ArmPlant):
        made.plant.set_zeros(arm_zeros(robot, made.plant, seed))
    steps = made.timing
    timing = Timing.of(made.plant.timestep, 1.0 / steps.period, mpc.rate, settings.computation_delay)
    return System(made.plant, made.controller, mpc, timing)


@dataclass(frozen=True)
class Surroundings:
    """What a closed loop's robot is among: ``scene``, obstacles in the simulated world, those of ``settings.obstacles`` where it is left
    out; plans keep clear of them if the MPC has obstacles. ``perception``: of the scene plans know what simulated sensors see; left out:
    what it is. ``paced``: in a scene references wait for a robot that evades something
    (:class:`wbmpc.mpc.reference_pacing.PacedReferences`), and a robot that is stuck ends the run; with ``alternatives`` it tries other plans
    before (:class:`wbmpc.mpc.alternatives.Alternatives`), where its base moves and it does not balance, and has as much more time as
    another way takes."""

    scene: Sequence[SceneObstacle] | None = None
    perception: PerceptionSettings | None = None
    paced: bool = False
    alternatives: bool = False


@dataclass(frozen=True)
class Hooks:
    """What a task adds to a closed loop. At every controller period: ``tick(t)``, which may change references: what plans must not
    foresee; ``truth(t, truth)``, which sees the simulated robot; ``done()``: whether the task is done before its time. ``metrics`` and
    ``plots`` of the log come beside the general ones."""

    tick: Callable[[float], None] | None = None
    truth: Callable[[float, Truth], None] | None = None
    done: Callable[[], bool] | None = None
    metrics: Callable[[Log], dict[str, Metric]] | None = None
    plots: Callable[[Log], Sequence[Plot]] | None = None


def closed_loop(
    robot: RobotModel, mpc: MPC, duration: float, seed: int = 0, settings: SimulationSettings | None = None, *,
    since: float = 0.0, hooks: Hooks = Hooks(), around: Surroundings = Surroundings(), reshape: bool = False,
) -> Scenario:  # fmt: skip
    """Run ``mpc`` on ``robot`` for ``duration`` [s], from home; ``seed`` of all random numbers.

    Recorded every 10 ms: the end effector, its reference (of the cost "end_effector", where there is one) and its error, the base and its
    estimate, joints, inputs. ``since`` [s]: from then on errors count. ``hooks``: what a task adds. ``around``: what the robot is among.
    ``reshape``: legs stand wider where the arm pulls, of a base whose legs move and an ``mpc`` with the constraints "stability"; among
    obstacles a base changes its shape where references are paced. The references of ``mpc`` are the task; times begin with the loop. Raises
    :class:`InputError` for bad settings.
    """
    settings = SimulationSettings() if settings is None else settings
    check_loop(robot, mpc, duration, seed, since, settings)
    _start_at_home(robot, mpc)
    obstacles = _obstacles(robot, settings, around.scene)
    system, log = make_system(robot, mpc, settings, seed, obstacles.edit if obstacles else None), Log()
    joints, every = JointRecord(log, robot, system), max(1, round(RECORDED / system.timing.period))
    seen = around.perception
    perceive = None if seen is None else lambda: Perception(seen, robot, system, log, seed)
    pace = PacedReferences(mpc) if around.paced and obstacles and not mpc.path.active else None
    kind = base_type(robot.description.base.type)
    reshaping = kind.reshaping(robot, mpc, system.controller) if pace or (reshape and not obstacles) else None
    detours = around.alternatives and _may_detour(robot, mpc)
    others = Alternatives(mpc, robot, pace, reshaping) if pace and detours else None
    watch = SceneWatch(obstacles, system, log, since, robot, pace, perceive, others, reshaping) if obstacles else None
    over = _Over(duration if others else np.inf, 1.5 * system.timing.period, pace, hooks.done)

    estimates = estimate_watches(settings, robot, system, log)
    watches: list[Any] = [*([watch] if watch else []), *estimates]

    def record(t: float, command: Any, plans: Any) -> None:
        over.now = t
        if hooks.tick is not None:
            hooks.tick(t)
        if reshaping is not None and watch is None and round(t / system.timing.period) % system.timing.mpc_every == 0:
            reshaping.update(t)
        if hooks.truth is not None:
            hooks.truth(t, system.plant.truth())
        for each in watches:
            each.tick(t, plans)
        if round(t / system.timing.period) % every == 0:
            _record(log, t, system, plans, joints)

    def measured(run: Run) -> dict[str, Metric]:
        found = general_metrics(log, robot, since, run.ending.fell)
        return reduce(or_, [each.metrics() for each in watches], found) | (hooks.metrics(log) if hooks.metrics else {})

    def drawn(run: Run) -> list[Plot]:
        own = [plot for each in watches for plot in each.plots()]
        return [*general_plots(log), *joints.plots(), *own, *(hooks.plots(log) if hooks.plots else [])]

    longest = min(duration + DETOURS, LONGEST_RUN) if others else duration
    loop = Loop(system.plant, system.controller, mpc, system.timing, longest, record, over)
    tracked = TRACKED if getattr(settings.plant, "calibration", "none") == "drive" else []
    return Scenario.single(log, loop.run, measured, drawn, IDEALIZATIONS[settings.plant.kind] + tracked)


def _obstacles(
    robot: RobotModel, settings: SimulationSettings, scene: Sequence[SceneObstacle] | None
) -> SimulatedObstacles | None:
    """What stands and moves around the robot: ``scene``, or that of the settings."""
    if scene is None and settings.obstacles is not None:
        scene = load_scene(settings.obstacles)
    return None if scene is None else SimulatedObstacles(scene, robot.description.base.ground)


@dataclass
class _Over:
    """Whether a run is over before its longest time: after ``duration`` [s] and what detours take, less a ``tolerance`` [s], or ``done``."""

    duration: float
    tolerance: float
    pace: PacedReferences | None
    done: Callable[[], bool] | None
    now: float = 0.0

    def __call__(self) -> bool:
        detoured = 0.0 if self.pace is None else self.pace.detoured
        late = self.now > self.duration + detoured - self.tolerance
        return late or (self.done is not None and self.done())


def _may_detour(robot: RobotModel, mpc: MPC) -> bool:
    """Whether another way can be searched: a base that drives and does not balance, among obstacles."""
    return "base" in robot.state and not robot.base.balances and mpc.obstacles is not None


def check_loop(
    robot: RobotModel, mpc: MPC, duration: float, seed: int, since: float, settings: SimulationSettings
) -> None:
    """Raise :class:`InputError` for arguments of :func:`closed_loop` that cannot be meant."""
    for name, value, kind in (
        ("robot", robot, RobotModel),
        ("mpc", mpc, MPC),
        ("settings", settings, SimulationSettings),
    ):
        if not isinstance(value, kind):
            raise InputError(f"closed loop: '{name}': {kind.__name__} is needed, got {type(value).__name__}")
    _check_same_robot(robot, mpc)
    checks.whole_number("closed loop: 'seed'", seed, 0)
    for name, time in (("duration", duration), ("since", since)):
        checks.real_number(f"closed loop: '{name}'", time, LONGEST_RUN)
    checks.positive("closed loop", duration=duration)
    checks.not_negative("closed loop", since=since)


def _check_same_robot(robot: RobotModel, mpc: MPC) -> None:
    """Raise :class:`InputError` for an MPC that plans for another robot: with other states, or whose end effector is elsewhere. Of
    dynamics that are not the library's own only the states are known."""
    dynamics: Any = mpc.ocp.dynamics
    for group, names in robot.state.groups.items():
        planned = dynamics.state.groups.get(group, ())
        if tuple(planned) != tuple(names):
            raise InputError(
                f"closed loop: 'mpc': it is not for the robot '{robot.description.name}': its state '{group}' is "
                f"({', '.join(planned)}), the robot's is ({', '.join(names)})"
            )
    while hasattr(dynamics, "dynamics"):  # of wrappers
        dynamics = dynamics.dynamics
    base = getattr(dynamics, "base", None)
    if base is None:
        return
    off = np.inf
    if robot.tool in base.tree.frames:
        x = ca.SX.sym("x", robot.state.size)
        position = base.chain(x).frame_pose(base.tree.frames[robot.tool]).position
        planned_tool = np.array(ca.Function("tool", [x], [position])(robot.home)).ravel()
        off = float(np.linalg.norm(planned_tool - robot.pose(robot.home)[0]))
    if type(base) is not type(robot.base) or not off <= SAME:
        raise InputError(
            f"closed loop: 'mpc': it is not for the robot '{robot.description.name}': the end effector of its model is elsewhere"
            + (f", by {off:.3g} m at home" if np.isfinite(off) else "")
        )


def _start_at_home(robot: RobotModel, mpc: MPC) -> None:
    """An MPC that has never been reset starts from the robot's home."""
    start = mpc.solver.trajectory(0.0, copy=False).x[0]
    if not start.any() and start.size == mpc.ocp.dynamics.state.size and mpc.dynamics.state == robot.state:
        mpc.reset(robot.home)


def _record(log: Log, t: float, system: System, plans: Any, joints: JointRecord) -> None:
    truth, mpc = system.plant.truth(), system.mpc
    estimate, tool, rotation = believed(system)
    log.add("base", t, truth.pose)
    log.add("base_estimated", t, estimate)
    log.add("end_effector", t, truth.tool)
    log.add("end_effector_estimated", t, tool)
    log.add("state", t, truth.state)
    log.add("input", t, plans.current.feedforward(t))
    joints.tick(t, truth, plans)
    goal = end_effector_goal(mpc, t, np.zeros(3))
    if goal is not None:
        log.add("end_effector_reference", t, goal[:3])
        log.add("rotation_error", t, lie.rotation_angle(rotation, lie.quaternion_to_rotation(goal[3:])))

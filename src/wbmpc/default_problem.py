"""The whole-body problem of any robot whose inputs are speeds: weights that follow from the robot's size and limits, without tuning."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.optional import HasAcceleration
from wbmpc.clearance.levers import prices
from wbmpc.errors import InputError
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.mpc.speed_commands import SpeedMPC
from wbmpc.obstacles.floor import floor_boxes
from wbmpc.obstacles.pairs import arm_pairs, draw_states, self_pairs
from wbmpc.obstacles.world import Obstacles
from wbmpc.ocp import (
    Constraint,
    Cost,
    OptimalControlProblem,
    Path,
    Reference,
    RelaxedBarrier,
    path_problem,
    residuals,
    sets,
    with_accelerations,
)
from wbmpc.ocp.base_residuals import UprightPart
from wbmpc.ocp.clearance_residuals import stopping_time
from wbmpc.ocp.scaling import scaled_weights
from wbmpc.ocp.symbols import Residual
from wbmpc.settings import (
    CONTROL_RATE,
    MpcSettings,
    Settings,
    StabilitySettings,
    SupportMarginSettings,
    Weight,
    WheelLoadSettings,
)
from wbmpc.stability import StanceOf

#: Of clearance rows [1/m, per second]: more than what costs of the end effector pull with when it is a meter from where it should be.
CLEARANCE_SLACK = 3e4
#: Among obstacles arms fold themselves at up to so much of their full speed before pairs of their parts slow them down.
EVADING = 0.25
#: Of ranges of joints [1 over the range, per second]: more than what a goal pulls with that is a meter out of reach, or joints are
#: planned beyond their stops.
RANGE_SLACK = 3e4
#: Of limits of accelerations, which give way only where a joint cannot stop before its range ends: more than any goal pulls with.
ACCELERATION_SLACK = 1e6
#: Of the accelerations, what plans use: wheels of a base are limited together, and feedback needs some.
ACCELERATION_SHARE = 0.6
#: Of the center of mass's distance to the border of the support polygon at home, what plans on speeds keep of the center of mass at rest,
#: and of the zero-moment point: masses, lag of drives, and what accelerations do in other postures are not exact.
CENTER_SHARE, ZMP_SHARE = 0.5, 0.2
#: Random states that show how near to the border an arm can bring the center of mass.
STANCES = 100
#: Of stability rows: per share of a wheel's mean load and per meter of the zero-moment point, each per second.
LOAD_SLACK, MARGIN_SLACK = 1e4, 1e5
#: Where the payload and the coefficient of friction are in the reference of these rows.
_PAYLOAD, _FRICTION = 6, 10


class DefaultCost(Settings):
    """Weights per second, in units of the robot's size and limits.

    ``end_effector`` [1/m²]: position of the end effector, and of its orientation times (reach / 4)²; ``input``: of every input over its
    limit; ``posture``: of every arm joint over half its range; ``terminal`` [s]: factor of the end effector's weights at the end.
    """

    end_effector: Weight = 4000.0
    input: Weight = 0.4
    posture: Weight = 0.5
    terminal: Weight = 0.5


def default_mpc_settings(**changes: Any) -> MpcSettings:
    """Settings of :func:`wbmpc.default_mpc`: a horizon of 4 s in 40 intervals, the first of 20 ms. ``changes``: fields of
    :class:`wbmpc.settings.MpcSettings` by name."""
    return MpcSettings(**{"horizon": 4.0, "intervals": 40, "first_interval": 0.02, **changes})


def default_problem(
    robot: RobotModel, settings: MpcSettings | None = None, cost: DefaultCost | None = None,
    stability: StabilitySettings | None = None,
) -> OptimalControlProblem:  # fmt: skip
    """Pose of the end effector ("end_effector"), posture and inputs as costs; ranges, speeds, accelerations, the wheels' rates, and
    distances of the pairs that the robot file lists (``collision.self.pairs``) as inequalities; what keeps the robot upright: see
    :func:`keep_upright`. Raises :class:`InputError` for a robot that balances: its inputs are torques."""
    if robot.base.balances:
        raise InputError(
            f"default problem: the inputs of '{robot.description.name}' are torques, and it balances; valid: robots whose inputs are speeds "
            "(for others: wbmpc.bases.base_type(robot.description.base.type).mpc(robot))"
        )
    settings, cost = settings or default_mpc_settings(), cost or DefaultCost()
    first = settings.first_interval or None
    ocp = OptimalControlProblem(robot.dynamics(), settings.horizon, settings.intervals, first_interval=first)
    limits, hard = robot.limits, settings.limits == "hard"
    weights = scaled_weights(robot, cost.end_effector, cost.input, cost.posture)
    effector = weights.end_effector
    frame = residuals.FramePose(robot, robot.tool)
    ocp.add(
        Cost("end_effector", frame, list(effector), at="path+terminal", terminal_weight=list(cost.terminal * effector))
    )
    posture = {group: list(weights.posture) if group == "arm" else 0.0 for group in robot.state.groups}
    ocp.add(Cost("state", residuals.State(robot), posture))
    ocp.add(Cost("input", residuals.Input(robot), weights.input))
    for constraint in robot.base.constraints(robot, hard=hard):
        ocp.add(constraint)
    barrier = RelaxedBarrier(settings.barrier_mu, 0.02)
    ranges = sets.Box(limits.state_lower, limits.state_upper)
    free_state = residuals.State(robot, reference=None)
    positions = Constraint(
        "positions", free_state, ranges, at="path+terminal", penalty=barrier, hard=hard, slack=RANGE_SLACK
    )
    ocp.add(positions)
    speeds = sets.Box(limits.input_lower, limits.input_upper)
    ocp.add(Constraint("speeds", residuals.Input(robot, reference=None), speeds, penalty=barrier, hard=hard))
    rates = robot.limits.input_rate
    limited = [g for g in robot.input.groups if np.isfinite(rates[robot.input[g]]).all()]
    if limited:
        ocp.add(
            Constraint(
                "accelerations", residuals.AccelerationLimit(robot, limited, ACCELERATION_SHARE), sets.NonNegative(),
                hard=True, slack=ACCELERATION_SLACK,
            )
        )  # fmt: skip
    ocp = keep_off_floor(keep_apart(ocp, robot), robot)
    return keep_standing(ocp, robot) if stability is None else keep_upright(ocp, robot, stability)


def keep_standing(ocp: OptimalControlProblem, robot: RobotModel) -> OptimalControlProblem:
    """The problem on speeds with hard rows "upright" (:class:`wbmpc.residuals.Upright`) that keep center of mass and zero-moment point
    away from the border of the support polygon, by :data:`CENTER_SHARE` and :data:`ZMP_SHARE` of the distance at home: of a base that
    stands on 3 feet or more, and that could bring them there. As it is for a robot whose masses say that it does not stand at home."""
    footprint = robot.base.footprint
    if footprint is None or footprint.size < 3:
        return ocp
    stance = StanceOf(robot)
    at_home = stance(robot.home).polygon_margin
    if not at_home > 0.0:
        return ocp
    kept: dict[UprightPart, float] = {"center": CENTER_SHARE * at_home, "zmp": ZMP_SHARE * at_home}
    least: dict[UprightPart, float] = {
        "center": min(stance(x).polygon_margin for x in draw_states(robot, STANCES)),
        "zmp": at_home - float((np.abs(residuals.Upright(robot).pushes) @ _largest_accelerations(robot)).max()),
    }
    parts = tuple(part for part in kept if not least[part] >= kept[part])
    if parts:
        rows = residuals.Upright(robot, parts=parts)
        inside = sets.Box(np.repeat([kept[part] for part in parts], rows.size // len(parts)), np.inf)
        ocp.add(Constraint("upright", rows, inside, hard=True, slack=MARGIN_SLACK))
    return ocp


def _largest_accelerations(robot: RobotModel) -> Array:
    """Of every input (nu) [its unit per second]: those of a base are its own limits or what its wheels allow. An input without a limit
    may take its whole range in one period of :data:`CONTROL_RATE`; one without a range counts as at rest."""
    limits, base = robot.limits, robot.base
    rates = limits.input_rate.copy()
    if isinstance(base, HasAcceleration):
        rates[robot.input["base"]] = np.minimum(rates[robot.input["base"]], base.acceleration(limits))
    at_once = CONTROL_RATE * np.maximum(np.abs(limits.input_lower), np.abs(limits.input_upper))
    return np.nan_to_num(np.where(np.isfinite(rates), rates, at_once), posinf=0.0)


def keep_off_floor(ocp: OptimalControlProblem, robot: RobotModel) -> OptimalControlProblem:
    """The problem with hard rows "floor" that keep the arm off the floor, unless the robot file says that there is none
    (``collision.floor``); as it is for a robot without shapes, or one that does not reach the floor."""
    if floor_boxes(robot):
        rows = residuals.FloorClearance(robot)
        ocp.add(Constraint("floor", rows, sets.NonNegative(), hard=True, slack=CLEARANCE_SLACK))
    return ocp


def keep_apart(ocp: OptimalControlProblem, robot: RobotModel) -> OptimalControlProblem:
    """The problem with hard rows that keep the pairs apart which the robot file lists (``collision.self.pairs``)."""
    if robot.description.collision.self.pairs and self_pairs(robot):
        rows, free = residuals.SelfClearance(robot), sets.NonNegative()
        slack = prices(ocp, rows, CLEARANCE_SLACK)
        ocp.add(Constraint("self_clearance", rows, free, at="path+terminal", hard=True, slack=slack))
    return ocp


def keep_upright(
    ocp: OptimalControlProblem, robot: RobotModel, stability: StabilitySettings | None
) -> OptimalControlProblem:
    """The problem on accelerations (:func:`wbmpc.ocp.with_accelerations`) with hard rows "stability" that keep the robot from tipping over,
    and, for a coefficient of friction, "grip" that keep its tires from sliding; as it is without ``stability``. Their reference
    is the world's wrench on the end effector (6), mass [kg] and center [m] of what it carries (4), and of "grip" then the coefficient: all
    may change between any two updates. Raises :class:`InputError` for a base that stands on fewer than 3 feet, or whose wheels share the
    load in an unknown way."""
    if stability is None:
        return ocp
    ocp = with_accelerations(ocp, robot)
    if isinstance(stability, WheelLoadSettings):
        rows: Residual = residuals.WheelLoads(robot, dynamics=ocp.dynamics, payload=True)
        ocp.add(Constraint("stability", rows, sets.Box(stability.min_load, np.inf), hard=True, slack=LOAD_SLACK))
        if stability.friction > 0.0:
            grip = residuals.TireFriction(robot, dynamics=ocp.dynamics, payload=True)
            ocp.add(Constraint("grip", grip, sets.NonNegative(), hard=True, slack=LOAD_SLACK))
    elif isinstance(stability, SupportMarginSettings):
        rows = residuals.SupportMargin(robot, dynamics=ocp.dynamics, payload=True)
        ocp.add(Constraint("stability", rows, sets.Box(stability.margin, np.inf), hard=True, slack=MARGIN_SLACK))
    return ocp


def make_mpc(
    ocp: OptimalControlProblem, settings: MpcSettings, stability: StabilitySettings | None = None, **options: Any
) -> MPC:
    """The MPC of a problem that :func:`keep_upright` made with the same ``stability``, with the real-time ``settings``; ``options`` of
    :class:`MPC`. Plans count with the payload of ``stability``."""
    if stability is None:
        return MPC(ocp, settings.solver(), settings.rate, **options)
    mpc = SpeedMPC(ocp, settings.solver(), settings.rate, **options)
    carried = [*[0.0] * 6, stability.payload, *stability.payload_center]
    mpc.reference["stability"] = Reference.constant(carried)
    if isinstance(stability, WheelLoadSettings) and stability.friction > 0.0:
        mpc.reference["grip"] = Reference.constant([*carried, stability.friction])
    return mpc


def carry(mpc: MPC, payload: float) -> None:
    """Plans of an MPC of :func:`make_mpc` count with the mass ``payload`` [kg] from the next update on; where it is, and what else its
    references say, stays."""
    for name in ("stability", "grip"):
        _change(mpc, name, _PAYLOAD, payload)


def grip(mpc: MPC, friction: float) -> None:
    """Plans of an MPC of :func:`make_mpc` whose stability knows friction count with another coefficient from the next update on."""
    _change(mpc, "grip", _FRICTION, friction)


def _change(mpc: MPC, name: str, column: int, value: float) -> None:
    """One number of the reference of a constraint, where the problem has it, at all times."""
    if name in mpc.ocp.terms:
        reference = mpc.reference[name]
        values = reference.values.copy()
        values[:, column] = value
        mpc.reference[name] = replace(reference, values=values)


def keep_clear(ocp: OptimalControlProblem, robot: RobotModel, obstacles: Obstacles | None) -> OptimalControlProblem:
    """The problem with hard rows that keep the whole robot clear of ``obstacles`` (None: as it is) and its arm clear of itself: who
    evades folds it, faster than where there are no obstacles, and slower only where it could not brake any more (:data:`EVADING`)."""
    if obstacles is None:
        return ocp
    free = sets.NonNegative()
    always = partial(Constraint, at="path+terminal", hard=True, slack=CLEARANCE_SLACK)
    ocp.add(always("clearance", residuals.Clearance(robot), free))
    pairs = arm_pairs(robot) if ocp.terms.pop("self_clearance", None) is None else self_pairs(robot)
    if pairs:
        own = residuals.SelfClearance(robot, pairs, approach=EVADING * stopping_time(robot))
        ocp.add(always("self_clearance", own, free))
    return ocp


def default_mpc(
    robot: RobotModel, settings: MpcSettings | None = None, cost: DefaultCost | None = None,
    obstacles: Obstacles | None = None, stability: StabilitySettings | None = None, progress: str | None = None,
) -> MPC:  # fmt: skip
    """The MPC of :func:`wbmpc.default_problem.default_problem` with its real-time ``settings`` and ``cost`` (None: the default weights), whose
    goal is the robot's home; it keeps clear of ``obstacles``, and upright by ``stability``.
    ``progress``: the frame that follows a path: see :func:`wbmpc.path_problem`."""
    settings = settings or default_mpc_settings()
    ocp = default_problem(robot, settings, cost, stability)
    ocp = keep_clear(path_problem(ocp, frame=progress) if progress else ocp, robot, obstacles)
    mpc = make_mpc(ocp, settings, stability, obstacles=obstacles)
    stay_at_home(robot, mpc)
    return mpc


def stay_at_home(robot: RobotModel, mpc: MPC) -> None:
    """Begin at home, with references of end effector, state and input that rest there."""
    hold(mpc, *robot.pose(robot.home, mpc.path.frame or None))
    mpc.reference["state"] = Reference.constant(robot.home)
    mpc.reference["input"] = Reference.constant(np.zeros(robot.input.size))
    mpc.reset(robot.home)


def hold(mpc: MPC, position: Array, orientation: Array) -> None:
    """The end effector's goal is a position (3) [m] with an orientation (4); of a problem with a path: what follows it stands at the start
    of one."""
    if mpc.path.active:
        mpc.path.follow(Path.line(position, position + [1.0, 0.0, 0.0], orientation), speed=0.0)
    else:
        mpc.reference["end_effector"] = Reference.poses([0.0], [position], orientation)

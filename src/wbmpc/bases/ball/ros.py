"""A ball robot on a bus: torques out, its state from encoders and the inertial unit; it never stops balancing if it can."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.bases.ball.controller import BallController
from wbmpc.bases.ball.defaults import RezeroCost, rezero_mpc, rezero_problem
from wbmpc.bases.ball.estimator import BallEstimator
from wbmpc.bases.ball.filter_state import BallNoise
from wbmpc.bases.ball.lean_control import LeanControl
from wbmpc.bases.ball.messages import BallCommand, BallMeasurement
from wbmpc.bases.ball.model import ball_base
from wbmpc.bases.ball.posture import resting
from wbmpc.bases.ball.push import PushEstimator
from wbmpc.bases.ball.ros_settings import BallRosSettings
from wbmpc.bases.ball.sent_torques import DriveSettings
from wbmpc.bases.ball.settings import PushedDisturbance
from wbmpc.errors import FallPredicted
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.policy import Policy
from wbmpc.mpc.policy_queue import PolicyQueue
from wbmpc.ocp import OptimalControlProblem, Reference
from wbmpc.ros2.base_adapter import BaseAdapter, Estimate, Fix, Groups, PendingChanges, obstacles_of
from wbmpc.ros2.convert import nearest_angle
from wbmpc.ros2.goals import EndEffectorTrack, Planner, Task
from wbmpc.ros2.health import FELL
from wbmpc.ros2.joints import FIRST, Inertial, JointSample, Series

#: A policy that has had no successor for so long [s] becomes a hold: it plans to be somewhere, and its gains to get there.
HOLD_AFTER = 0.3
#: Time that goes back by more than this [s] is of another clock: a simulator that was restarted, or a clock that was set.
BACK = 0.02
#: A robot that is not held turns a joint by the first [rad] within milliseconds, or its base at the second [rad/s].
TURNED, TURNING = 1e-3, 0.05
#: Postures are solved for (some 20 ms each) before and after at most so many changes of the end effector's pose; on ways with more of
#: them in so many poses.
CHANGES, POSTURES = 12, 5
#: A base that leans by more than this [rad] has fallen: no plan leans as far, and no wheel catches it.
FALLEN = 0.7


def fall(x: Array) -> str:
    """Message that a robot with the state x (x, y, yaw [rad], pitch [rad], roll [rad], …) has fallen; empty if it has not."""
    lean = math.acos(math.cos(x[3]) * math.cos(x[4])) if np.isfinite(x[3:5]).all() else math.pi
    return f"{FELL}, it leans by {math.degrees(lean):.0f} degrees" if lean > FALLEN else ""


@dataclass(frozen=True)
class BallMessage:
    """What the sensors said at ``time`` [s] of the runner's clock, whose zero is at ``origin`` [s], seen ``now``; gyro and
    accelerometer are averages since the message before; ``series`` of the encoders."""

    time: float
    now: float
    wheel: Array
    arm: Array
    gyro: Array
    accel: Array
    origin: float = 0.0
    series: Series = FIRST


class BusBallController(BallController):
    """A ball robot's controller for messages that come when they like, and for policies that have no successor."""

    #: the newest measurement, for other threads
    seen: BallMeasurement | None = None
    #: another localization, and the wrench (6) [N, N m] with which the world is to answer the end effector
    fix: Callable[[], Fix | None] | None = None
    answer = np.zeros(6)
    _sampled: float | None = None
    _at_first: Array | None = None  # wheels and arm in the first message
    _let_go = False
    _held: tuple[Policy, PolicyQueue] | None = None

    def measure(self, message: BallMessage) -> None:  # type: ignore[override]
        """A new message moves estimator and observer by its own interval; an old one is only older."""
        age = max(message.now - message.time, 0.0)
        interval = None if self._sampled is None else message.time - self._sampled
        if interval is not None and interval <= 1e-6:
            assert self.seen is not None
            self.measured = self.seen = BallMeasurement(message.now, self.seen.state, age)
            return
        state = self._estimate(message, age, self._turning(age))
        if fallen := fall(state):  # on the floor the model has no answer, and torques beat the arm about
            raise FallPredicted(f"{fallen}; motors off")
        if self._moves(message):
            self._monitor_encoders(message.time, message.arm, interval or self.period)
            self._detect_pushes(interval or self.period)
            if self.learned.observer is not None:
                assert self.measured is not None
                self.learned.learn(self.measured, interval or self.period, self.sent, self._steps)
        self.mpc.solver.set_parameters(self.parameters())

    def _estimate(self, m: BallMessage, age: float, turning: float) -> Array:
        """The state (nx) after a new message that is ``age`` [s] old, and another localization's pose; ``turning`` [N m]: see the estimator."""
        assert self.estimator is not None
        state = self.estimator.update(m.time, m.wheel, m.arm, m.gyro, m.accel, turning)
        self._sampled = m.time  # a message that was rejected has not moved the estimator
        fix = self.fix() if self.fix is not None else None
        if fix is not None:
            state = self.estimator.correct(*fix)
        self.measured = self.seen = BallMeasurement(m.now, state, age)
        return state

    def _moves(self, m: BallMessage) -> bool:
        """Whether it has moved since the first message. Drives may take the first commands late, and a person holds the robot until
        then: what the model makes of the torques is not what happens, and nothing is to be learned from the difference."""
        if not self._let_go:
            joints = np.concatenate([m.wheel, m.arm])
            self._at_first = joints if self._at_first is None else self._at_first
            turned = float(np.abs(joints - self._at_first).max())
            self._let_go = turned > TURNED or float(np.abs(m.gyro).max()) > TURNING
        return self._let_go

    def follow(self, message: BallMessage) -> None:
        """A message while the drives are not commanded updates the estimator only."""
        if self._sampled is None or message.time - self._sampled > 1e-6:
            self._estimate(message, max(message.now - message.time, 0.0), 0.0)

    def parameters(self) -> dict[str, Array]:
        """An announced moment counts as the generalized forces that it is for the robot as it stands now."""
        force, moment, disturbance = self.answer[:3], self.answer[3:], self.learned.disturbance
        if moment.any():
            assert self.measured is not None
            disturbance = disturbance + ball_base(self.robot).numeric.tool_moment(
                self.measured.state[: ball_base(self.robot).nq], moment
            )
        return {**super().parameters(), "disturbance": disturbance, "force": force}

    def command(self, t: float, plans: PolicyQueue) -> BallCommand:
        """Torques of the policy, or of the hold that it has become."""
        policy = plans.current
        assert policy is not None
        if t > float(policy.times[0]) + HOLD_AFTER:
            if self._held is None or self._held[0] is not policy:
                self._held = policy, PolicyQueue()
                self._held[1].current = held(policy, self.robot, t)
            plans = self._held[1]
        return super().command(t, plans)


def held(policy: Policy, robot: RobotModel, t: float) -> Policy:
    """Rest, forever, where a policy plans to be at t [s]: the equilibrium for its arm, with the policy's first gain, which
    looks farthest ahead (the last ones end with the horizon)."""
    planned = policy.state(t)
    rest, torque = ball_base(robot).numeric.equilibrium(planned[robot.state["arm"]])
    rest = rest.copy()
    rest[:3] = planned[:3]
    u = np.zeros(policy.u.shape[1])
    u[: torque.size] = torque
    return Policy(np.array([t, t + 1e6]), np.stack([rest, rest]), u[None], policy.gain[:1])


def bodies(task: Task, robot: RobotModel, x: Array) -> Reference:
    """The body's states (n, nx) during a task from state x (nx) on: so that a weight on the arm's posture moves no end effector.

    A carried end effector keeps the arm as it is. An end effector that is led has the arm with which the robot rests in some of its poses, and
    what lies between them; it also turns the base, unless that has a way of its own.
    """
    base, end_effector, arm = task.base, task.end_effector, robot.state["arm"]
    states = np.tile(robot.home, (base.times.size, 1))
    states[:, :3], states[:, arm] = base.poses, x[arm]
    if task.carried:
        return Reference(base.times, states)
    places = postures(end_effector.positions, end_effector.orientations)
    rest, solved = np.empty((places.size, x.size)), -1
    for row, k in enumerate(places):
        if solved >= 0 and same_pose(end_effector, k, solved):
            rest[row] = rest[row - 1]
        else:
            rest[row], solved = resting(robot, end_effector.positions[k], end_effector.orientations[k]), k
    times = end_effector.times[places]
    turns = base.poses[:, 2]
    if np.ptp(turns) > 1e-9:
        rest[:, 2] = np.interp(times, base.times, turns)
    else:
        rest[:, 2] = np.array([nearest_angle(a, x[2]) for a in rest[:, 2]])
    return Reference(times, rest)


def postures(positions: Array, orientations: Array) -> NDArray[np.int_]:
    """Numbers of the poses of a way whose postures are solved for: before and after every change, or, of a way
    with more than :data:`CHANGES` of them, :data:`POSTURES` evenly."""
    poses = np.column_stack([positions, orientations])
    changes = np.flatnonzero(np.any(np.diff(poses, axis=0) != 0.0, axis=1))
    if changes.size <= CHANGES:
        return np.unique(np.concatenate([[0], changes, changes + 1, [len(poses) - 1]]).astype(int))
    first, last = int(changes[0]), int(changes[-1]) + 1
    evenly = np.linspace(first, last, POSTURES).round().astype(int)
    return np.unique(np.concatenate([[0], evenly, [len(poses) - 1]]))


def same_pose(end_effector: EndEffectorTrack, i: int, k: int) -> bool:
    """Whether two poses of a way are equal."""
    return bool(
        np.all(end_effector.positions[i] == end_effector.positions[k])
        and np.all(end_effector.orientations[i] == end_effector.orientations[k])
    )


class BallRosAdapter(BaseAdapter):
    """See :class:`wbmpc.ros2.base_adapter.BaseAdapter`. The controller's model is an MPC of its own: a solver's memory has one owner."""

    must_keep_running = needs_imu = True
    watches = "sensors and forces"
    controller: BusBallController

    def __init__(self, robot: RobotModel, settings: BallRosSettings, period: float) -> None:
        self.robot, self.settings, self.period = robot, settings, period
        self.planner = Planner(robot, settings.speeds, settings.goals)
        self.pending = PendingChanges()
        self.obstacles = obstacles_of(settings)
        self.mpc = rezero_mpc(robot, settings.mpc, settings.cost, self.obstacles)
        self._model = rezero_mpc(robot, settings.mpc, settings.cost)
        self.mpc.guess = self.pending
        self._rest = {g: np.zeros(len(robot.input.groups[g])) for g in ("wheel", "arm")}
        self._place, self._spread = (
            np.zeros(3),
            0.0,
        )  # where the robot is put on the floor: x, y, yaw; how well that is known
        self._standing: tuple[float, Array] | None = None  # time [s] of the clock behind the runner's, state
        self._answer, self._series = np.zeros(6), Series()
        self.parameters = lambda: self._model.solver.parameters
        self._torque = ball_base(robot).numeric.equilibrium(robot.home[robot.state["arm"]])[1]
        robot.pose(robot.home)  # builds the functions: not in a tick
        ball_base(robot).numeric.mass_matrix(robot.home[: ball_base(robot).nq])
        ball_base(robot).numeric.tool_moment(robot.home[: ball_base(robot).nq], np.zeros(3))
        self._model.solver.simulate(robot.home, self._torque, period)
        resting(robot, *robot.pose(robot.home))
        self._push = (
            PushEstimator(robot, robot.home[robot.state["arm"]], settings.expected_push_time)
            if settings.expected_push_time > 0.0
            else None
        )
        home = robot.home[robot.state["arm"]]
        self._lean_control = (
            LeanControl(robot, home, settings.cost.lean, settings.disturbance.max_pushed_speed)
            if isinstance(settings.disturbance, PushedDisturbance)
            else None
        )
        self.controller = self._new_controller(robot.home)

    def _new_controller(self, x: Array) -> BusBallController:
        s = self.settings
        estimator = BallEstimator(self.robot, x, BallNoise(start=max(self._spread, BallNoise().start)))
        controller = BusBallController(
            self.robot,
            self._model,
            self._torque,
            self.period,
            DriveSettings(s.actuator_time_constant),
            isinstance(s.disturbance, PushedDisturbance),
            estimator,
        )
        controller.fix, controller.answer = self.fix, self._answer
        controller.learned.push_estimator, controller.learned.lean_control = self._push, self._lean_control
        if self._push is not None:
            self._push.reset()
        if self._lean_control is not None:
            self._lean_control.reset()
        return controller

    def fall(self, x: Array) -> str:
        """By the lean of its body."""
        return fall(x)

    def problem(self, cost: RezeroCost) -> OptimalControlProblem:
        """The controller's problem with other weights, without its limit of the lean, which takes 0.2 s to make and has no weight:
        ticks go on meanwhile."""
        return rezero_problem(self.robot, self.settings.mpc, cost.model_copy(update={"lean": 0.0}))

    # ------------------------------------------------------------------ commands
    def rest(self) -> Groups:
        """No torque."""
        return self._rest

    def groups(self, command: BallCommand) -> Groups:
        n = self._rest["wheel"].size
        return {"wheel": command.torque[:n], "arm": command.torque[n:]}

    # ------------------------------------------------------------------ states
    def measurement(
        self, now: float, at: float, sample: JointSample, imu: Inertial | None, origin: float = 0.0
    ) -> BallMessage:
        """Joint states and the inertial unit, read at ``at`` [s] of the runner's clock."""
        assert imu is not None
        return BallMessage(
            at, now, sample.groups["wheel"], sample.groups["arm"], imu.gyro, imu.accel, origin, sample.series
        )

    def stand(self, m: BallMessage) -> None:
        """Before its first run a person, or a stand, holds the robot: upright, as it would balance with its arm as it is. After a
        run the estimator goes on, wherever the robot rolls or falls, until time goes back or its encoders restart."""
        seen, known = self.controller.seen, self._series
        self._series = m.series
        if seen is not None and (m.time < seen.time - seen.age - BACK or m.series != known):
            self._reset(seen.state)
        elif seen is not None:
            self.controller.follow(m)
            return
        previous, fix = self._standing, self.fix() if self.fix is not None else None
        if fix is not None:
            self._place = np.array([*fix[1][:2], nearest_angle(fix[1][2], self._place[2])])
            self._spread = float(np.sqrt(np.diag(fix[2]).max()))
        if fix is None and previous is not None and np.abs(previous[1][self.robot.state["arm"]] - m.arm).max() < 1e-3:
            self._standing = m.time + m.origin, previous[1]
            return
        x = ball_base(self.robot).numeric.equilibrium(m.arm)[0].copy()
        x[:3] = self._place
        self._standing = m.time + m.origin, x

    def _reset(self, x: Array) -> None:
        """Nothing is known between times of two clocks: a person holds the robot again. A simulator that was restarted has put
        it where its odometry begins; who has a clock that was set is where state x (nx) says."""
        simulated = self.settings.use_sim_time or self.settings.lockstep
        self._place, self._standing = np.zeros(3) if simulated else x[:3].copy(), None
        self.controller = self._new_controller(self.robot.home)

    def snapshot(self) -> tuple[float, Array] | None:
        """Time [s] of the runner's clock and the state (nx) estimated for it; from any thread. None before the first."""
        seen = self.controller.seen
        if seen is not None:
            return seen.time - seen.age, seen.state
        return None if self._standing is None else (self.on_runners_clock(self._standing[0]), self._standing[1])

    def begin(self, x: Array) -> None:
        """A new run: the robot stands upright and at rest, where it was last."""
        last = self.snapshot()
        rest, self._torque = ball_base(self.robot).numeric.equilibrium(x[self.robot.state["arm"]])
        self._place = x[:3].copy()
        start = rest.copy()
        start[:3] = self._place
        self.controller = self._new_controller(start)
        self._standing = (0.0 if last is None else last[0]) - self.on_runners_clock(0.0), start
        self.mpc.reset(start, self._torque)

    def push(self, wrench: Array) -> None:
        """The end effector is to exert a wrench (6): the plan counts with the world's answer."""
        self._answer = self.controller.answer = -wrench

    def relocate(self) -> None:
        """While it is held, poses count as they come: see :meth:`stand`."""

    # ------------------------------------------------------------------ tasks
    def references(self, task: Task, x: Array) -> dict[str, Reference]:
        """For the end effector and for the body at rest; the ball goes where the end effector needs it. Paths of the end effector
        take at least 0.1 s."""
        end_effector = task.end_effector
        return {
            "end_effector": Reference.poses(end_effector.times, end_effector.positions, end_effector.orientations),
            "body": bodies(task, self.robot, x),
            "twist": Reference.constant(np.zeros(6)),
        }

    def follow(self, references: dict[str, Reference]) -> None:
        """Start a task."""
        self.pending.set({**references, "torque": Reference.constant(self._torque)})

    # ------------------------------------------------------------------ what is reported
    def estimate(self) -> Estimate | None:
        """The base's frame is the ball's center; pose and twist of the filter."""
        seen = self.snapshot()
        if seen is None:
            return None
        x, nq = seen[1], ball_base(self.robot).nq
        rotation = lie.euler_zyx_to_rotation(*x[2:5])
        estimator = self.controller.estimator
        assert estimator is not None
        p = estimator.filter.covariance
        position, velocity, attitude, bias = (slice(k, k + 3) for k in (0, 3, 6, 9))
        covariance, speeds = np.zeros((6, 6)), np.zeros((6, 6))
        covariance[:3, :3] = p[position, position]
        covariance[3:, 3:] = rotation @ p[attitude, attitude] @ rotation.T  # about the world's axes
        covariance[:3, 3:] = p[position, attitude] @ rotation.T
        covariance[3:, :3] = covariance[:3, 3:].T
        speeds[:3, :3] = rotation.T @ p[velocity, velocity] @ rotation
        speeds[3:, 3:] = p[bias, bias]
        linear = rotation.T @ np.array([x[nq], x[nq + 1], 0.0])
        return Estimate(
            np.array([x[0], x[1], self.planner.lift]), lie.rotation_to_quaternion(rotation),
            np.concatenate([linear, estimator.filter.rate]), covariance, speeds,
        )  # fmt: skip

"""From measured states to observations and torques of a ball robot: delay and drive lag compensated, offset-free."""

from __future__ import annotations

import math
from collections.abc import Sequence
from operator import mul

import numpy as np

from wbmpc.bases.ball.estimator import BallEstimator
from wbmpc.bases.ball.fall_detection import FallPredictor, stop_for
from wbmpc.bases.ball.learned_forces import LearnedForces
from wbmpc.bases.ball.messages import BallCommand, BallMeasurement
from wbmpc.bases.ball.model_steps import Learning, ModelSteps
from wbmpc.bases.ball.self_contact import SelfContact
from wbmpc.bases.ball.sensor_faults import BallReadings, EncoderMonitor
from wbmpc.bases.ball.sent_torques import DriveSettings, SentTorques
from wbmpc.bases.ball.torque_limits import TorqueLimits
from wbmpc.checks import numbers, positive
from wbmpc.control.monitor import Fault, Monitor, found_by
from wbmpc.errors import SensorFailure
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.mpc.policy import Policy
from wbmpc.mpc.policy_queue import PolicyQueue
from wbmpc.types import Observation

#: A torque that differs from the target by less than this share of its limit was not cut.
_ROUNDING = 1e-9


class BallController:
    """Prediction, disturbance observer and Riccati policy at the controller's rate.

    ``drives``: what the controller believes of them; its commands are for the state in which they will act. ``observer``: whether
    the disturbance is estimated, and the mass at the end effector where the model has it as a parameter; ``estimator``: takes the
    state from the sensors (left out: the measurement's own, idealized one). ``fall_predictor``: ends the run when the plans, or the lean
    that is felt, say that the robot will fall. Raises :class:`InputError` for numbers that cannot be.
    ``monitor``: of the encoders, the first of ``monitors``, where there is an estimator; without what the state needs of them the run ends.
    ``learned``: what it believes of forces.
    """

    def __init__(
        self, robot: RobotModel, mpc: MPC, torque: np.ndarray, period: float, drives: DriveSettings, observer: bool = True,
        estimator: BallEstimator | None = None, fall_predictor: FallPredictor | None = None,
    ) -> None:  # fmt: skip
        positive("ball robot's controller", period=period)
        numbers("ball robot's controller", "torque", torque, np.size(torque))
        self.robot, self.mpc, self.period, self.estimator = robot, mpc, period, estimator
        self.fall_predictor = fall_predictor
        self.limits = TorqueLimits(robot, torque.size)
        self._spin, self._rates = self.limits.spin.tolist(), robot.state["arm_velocity"]
        self._cut = _ROUNDING * self.limits.limit
        self.sent = SentTorques(torque, period, drives)
        self.learned = LearnedForces(robot, self._step, observer)
        self.measured: BallMeasurement | None = None
        self.monitor: EncoderMonitor | None = None
        if estimator is not None:
            stops = (robot.limits.state_lower[robot.state["arm"]], robot.limits.state_upper[robot.state["arm"]])
            own = SelfContact(robot) if robot.description.collision.self.pairs else None
            self.monitor = EncoderMonitor(self.limits.spin.size, robot.state.groups["arm"], stops, own)
        self.monitors: list[Monitor[BallReadings]] = [] if self.monitor is None else [self.monitor]
        self._found: list[Fault] = []
        self._accelerates: np.ndarray | None = None  # the arm, by the model, until the next measurement [rad/s²]
        self._steps_of: tuple[object, object, object, object, ModelSteps | None] | None = None  # of which parts
        self._steps_alike = type(self)._step is BallController._step
        self._own_parameters = type(self).parameters is BallController.parameters
        self._own_law = type(self)._law is BallController._law
        self.target = torque.copy()  # what the policy asks for, before it is clipped [N m]
        self.feedforward = torque.copy()  # its part without feedback
        self.torque = torque.copy()  # what the drives were last asked for

    def _step(self, x: np.ndarray, u: np.ndarray, h: float) -> np.ndarray:
        return self.mpc.solver.simulate(x, u, h)

    @property
    def _steps(self) -> ModelSteps | None:
        """The model in compiled steps; None where a subclass has one of its own, or the solver's is not compiled."""
        if not self._steps_alike:
            return None
        learned, d = self.learned, self.fall_predictor
        a, b, c = learned.observer, learned.payload, learned.lean_control
        known = self._steps_of
        if known is None or known[0] is not a or known[1] is not b or known[2] is not c or known[3] is not d:
            own = (self.mpc.solver, self.limits, self.sent, self.period, Learning(a, b, c, d))
            self._steps_of = known = a, b, c, d, ModelSteps.of(self.robot, *own)
        return known[4]

    def _through(self, x: np.ndarray, rows: slice) -> np.ndarray:
        """The state x after these rows of the torques that were sent, each for a period."""
        if rows.start == rows.stop:
            return x.copy()
        steps = self._steps
        found = None if steps is None else steps.through(x, rows)
        if found is not None:
            return found
        torques = self.sent.rows[rows]
        if self._steps_alike:
            return self._step(x, torques, self.period)
        for torque in torques:  # what else moves is for one step
            x = self._step(x, torque, self.period)
        return x

    def measure(self, measurement: BallMeasurement) -> None:
        """Take in this tick's (late) state; update the disturbance."""
        m = measurement
        if self.estimator is not None:
            turning = self._turning(m.age)
            state = self.estimator.update(m.time - m.age, m.wheel, m.arm, m.gyro, m.accel, turning)
            measurement = m.with_state(state)
        self.measured = measurement
        self._monitor_encoders(m.time, m.arm, self.period)
        self._detect_pushes(self.period)
        self._observe(measurement)
        if self.fall_predictor is not None:
            m, component = measurement, self.learned.leans(measurement)[4:]
            if component:
                stop_for(self.fall_predictor.judge(m.time, math.hypot(*component)))
            else:
                more = self.learned.carried, self._pushed(), self.learned.shift(m)
                stop_for(self.fall_predictor.update(m.time, m.state, *more))

    def _monitor_encoders(self, t: float, arm: np.ndarray, h: float) -> None:
        """Judge the encoders by readings ``arm`` of time t [s], ``h`` [s] after those before.

        Raises :class:`SensorFailure` when the state is not known any more.
        """
        if self.monitor is None:
            return
        assert self.estimator is not None and self.measured is not None
        joints, estimator_faults = self.estimator.arm, self.estimator.faults
        own = joints.arrays
        read = arm if joints.first else own["reading"]
        more = estimator_faults, own["surprised"], self.measured.state
        self._found += found_by(self.monitors, BallReadings(t, h, read, own["rate"], self._accelerates, *more))
        if self.monitor.lost:
            raise SensorFailure(f"{self.monitor.lost}; motors off")
        x, rates, acted = self.measured.state, self._rates, self.sent.at(self._late())
        self._accelerates = (self._through(x, slice(acted, acted + 1))[rates] - x[rates]) / self.period

    @property
    def limit(self) -> np.ndarray:
        """Largest torques (n + m) [N m] of the drives."""
        return self.limits.limit

    @property
    def clamped(self) -> bool:
        """Whether the last command was cut to the drives' limits."""
        return bool((np.abs(self.torque - self.target) > self._cut).any())

    @property
    def faults(self) -> list[Fault]:
        """What was found of the encoders, and of forces that push the robot away."""
        lean_control = self.learned.lean_control
        push_fault = None if lean_control is None else lean_control.push_fault
        return [*self._found, *filter(None, [push_fault])]

    def _pushed(self) -> Sequence[float] | np.ndarray:
        """The estimated horizontal force (2) [N] at the end effector; a subclass that has one has a model of its own."""
        return (0.0, 0.0)

    def _detect_pushes(self, h: float) -> None:
        """Estimate a push from the state that is measured, ``h`` [s] after the one before."""
        assert self.measured is not None
        if self.learned.push_estimator is not None:
            self.learned.detect_push(self.measured.state, self.sent.acted(self._late()), h)

    def _observe(self, measurement: BallMeasurement) -> None:
        learned = self.learned
        if learned.observer is None and learned.push_estimator is None:
            return
        forwards = self._own_parameters
        if learned.observer is None or not learned.learn(measurement, self.period, self.sent, self._steps, forwards):
            self.mpc.solver.set_parameters(self.parameters())

    def parameters(self) -> dict[str, np.ndarray]:
        """The model's parameters by group, as they are believed now."""
        return self.learned.parameters(self.measured)

    def _late(self) -> int:
        """By how many ticks the measurement is late; one from before all torques that are known counts as from the first."""
        assert self.measured is not None
        return self.sent.ticks(self.measured.age)

    def _turning(self, age: float) -> float:
        """The torque [N m] about the vertical with which the wheels turned the ball ``age`` [s] ago."""
        acted = self.sent.rows[self.sent.at(self.sent.ticks(age))]
        return sum(map(mul, self._spin, acted.tolist()))  # (of its wheels alone: the shorter one ends it)

    def state(self) -> np.ndarray:
        """The measured state brought up to now by the torques that have acted since."""
        assert self.measured is not None
        return self._through(self.measured.state, self.sent.since(self._late()))

    def ahead(self) -> np.ndarray:
        """The state in which the next command will act: by the dead time after now, under the torques that were sent before."""
        assert self.measured is not None
        late, dead = self._late(), self.sent.dead
        if self._steps_alike:
            return self._through(self.measured.state, self.sent.since(late + dead, 0))
        return self._through(self.state(), self.sent.since(dead, 0))  # what a subclass adds to the state now goes along

    def predict(self, t: float, until: float, plans: PolicyQueue) -> Observation:
        """The state at time ``until`` under the policies that will be active, through the drives' lag."""
        x, torque, dead = self.ahead(), self.sent.last, self.sent.dead * self.period
        steps = self._steps if self._own_law else None
        for k in range(round((until - t) / self.period)):
            policy, now = plans.at(t + k * self.period), t + dead + k * self.period
            if policy is None:
                break
            found = None if steps is None else steps.foresee(policy, now, x, torque)
            if found is None:
                torque = self.sent.follow(self.limits.limited(self._law(now, x, policy)[1], x), torque)
                found = self._step(x, torque, self.period), torque
            x, torque = found
        return Observation(until + dead, x)

    def stop(self) -> BallCommand:
        """No torque."""
        return BallCommand(np.zeros(self.limit.size))

    def command(self, t: float, plans: PolicyQueue) -> BallCommand:
        """Torques at the predicted present state."""
        fall_predictor, plan = self.fall_predictor, plans.current
        if fall_predictor is not None and plan is not None and plan is not fall_predictor.seen:
            stop_for(fall_predictor.update_plan(plan, self.learned.carried, self.learned.shift(self.measured)))
        now, measured, found = t + self.sent.dead * self.period, self.measured, None
        steps = self._steps if self._own_law else None
        if steps is not None and plan is not None and measured is not None:
            found = steps.act(plan, now, measured.state, self._late())
        if found is not None:
            self.feedforward, self.target, self.torque = found
            return BallCommand(self.torque)
        x = self.ahead()
        self.feedforward, self.target = self._law(now, x, plan, acts=True)
        return self._drive(self.limits.limited(self.target, x))

    def _law(self, t: float, x: np.ndarray, policy: Policy | None, acts: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """Torques [N m] without and with feedback in state x at time t [s]; ``acts``: they are sent, not only predicted."""
        assert policy is not None
        return policy.feedforward(t)[: self.limit.size], policy.law(t, x)[: self.limit.size]

    def _drive(self, torque: np.ndarray) -> BallCommand:
        """The command for possible torques, which the drives follow with their lag."""
        self.torque = torque
        self.sent.send(torque)
        return BallCommand(torque)

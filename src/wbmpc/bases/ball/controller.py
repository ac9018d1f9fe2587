"""From measured states to observations and torques of a ball robot: delay and drive lag compensated, offset-free."""

from __future__ import annotations

import math
from operator import mul

import numpy as np

from wbmpc.bases.ball.disturbance import DisturbanceObserver
from wbmpc.bases.ball.estimator import BallEstimator
from wbmpc.bases.ball.fall_detection import FallPredictor, stop_for
from wbmpc.bases.ball.lean_control import LeanControl
from wbmpc.bases.ball.messages import BallCommand, BallMeasurement
from wbmpc.bases.ball.model import ball_base
from wbmpc.bases.ball.model_steps import ModelSteps
from wbmpc.bases.ball.payload import PayloadEstimator
from wbmpc.bases.ball.push import PushEstimator
from wbmpc.bases.ball.self_contact import SelfContact
from wbmpc.bases.ball.sensor_faults import BallReadings, EncoderMonitor
from wbmpc.bases.ball.sent_torques import DriveSettings, SentTorques
from wbmpc.bases.ball.torque_limits import TorqueLimits
from wbmpc.checks import numbers, positive
from wbmpc.control.monitor import Fault, Monitor, found_by
from wbmpc.errors import NotFinite, SensorFailure
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.mpc import MPC
from wbmpc.mpc.policy import Policy
from wbmpc.mpc.policy_queue import PolicyQueue
from wbmpc.types import Observation

#: A torque that differs from the target by less than this share of its limit was not cut.
_ROUNDING = 1e-9
#: Innovations of the base's speeds beyond which a force is a push, and no disturbance to learn: of the ball along x and y [m/s], of yaw, pitch
#: and roll [rad/s].
GATE = (0.06, 0.06, 0.25, 0.12, 0.12)


class BallController:
    """Prediction, disturbance observer and Riccati policy at the controller's rate.

    ``drives``: what the controller believes of them; its commands are for the state in which they will act. ``observer``: whether
    the disturbance is estimated, and the mass at the end effector where the model has it as a parameter; ``estimator``: takes the
    state from the sensors (left out: the measurement's own, idealized one). ``forecast``: ends the run when the plans, or the lean
    that is felt, say that the robot will fall. Raises :class:`InputError` for numbers that cannot be.
    ``monitor``: of the encoders, the first of ``monitors``, where there is an estimator; without what the state needs of them the run ends.
    ``shoves``: detects pushes, for which the limit of the lean leaves room (None: it does not). ``lean_control``: lets the robot lean
    against forces that it has learned (None: as if there were none).
    """

    def __init__(
        self, robot: RobotModel, mpc: MPC, torque: np.ndarray, period: float, drives: DriveSettings, observer: bool = True,
        estimator: BallEstimator | None = None, forecast: FallPredictor | None = None,
    ) -> None:  # fmt: skip
        positive("ball robot's controller", period=period)
        numbers("ball robot's controller", "torque", torque, np.size(torque))
        self.robot, self.mpc, self.period, self.estimator = robot, mpc, period, estimator
        self.forecast = forecast
        self.limits = TorqueLimits(robot, torque.size)
        self._spin = self.limits.spin.tolist()
        self._cut = _ROUNDING * self.limits.limit
        self.sent = SentTorques(torque, period, drives)
        self.observer: DisturbanceObserver | None = None
        if observer:
            self.observer = DisturbanceObserver(
                self._step, ball_base(robot).numeric.mass_matrix, ball_base(robot).nq, np.array(GATE)
            )
        self.disturbance = np.zeros(ball_base(robot).nq)
        self.payload = (
            PayloadEstimator(ball_base(robot).numeric.tool_weight)
            if observer and "payload" in robot.parameters
            else None
        )
        self.shoves: PushEstimator | None = None
        self.lean_control: LeanControl | None = None
        self.measured: BallMeasurement | None = None
        self.monitor: EncoderMonitor | None = None
        if estimator is not None:
            stops = (robot.limits.state_lower[robot.state["arm"]], robot.limits.state_upper[robot.state["arm"]])
            own = SelfContact(robot) if robot.description.collision.self.pairs else None
            self.monitor = EncoderMonitor(self.limits.spin.size, robot.state.groups["arm"], stops, own)
        self.monitors: list[Monitor[BallReadings]] = [] if self.monitor is None else [self.monitor]
        self._found: list[Fault] = []
        self._accelerates: np.ndarray | None = None  # the arm, by the model, until the next measurement [rad/s²]
        self._known: tuple[object, int, np.ndarray] | None = (
            None  # of which measurement and how many commands, the state now
        )
        self._known_acted: tuple[object, int, np.ndarray] | None = (
            None  # the same of the torques that acted at the measurement
        )
        self._steps_of: tuple[object, object, ModelSteps | None] | None = None  # of which observer and payload
        self._steps_alike = type(self)._step is BallController._step
        self.target = torque.copy()  # what the policy asks for, before it is clipped [N m]
        self.feedforward = torque.copy()  # its part without feedback
        self.torque = torque.copy()  # what the drives were last asked for

    def _step(self, x: np.ndarray, u: np.ndarray, h: float) -> np.ndarray:
        return self.mpc.solver.simulate(x, u, h)

    @property
    def _model_steps(self) -> ModelSteps | None:
        """The model in compiled steps; None where a subclass has one of its own."""
        if not self._steps_alike:
            return None
        parts = (self.observer, self.payload)
        known = self._steps_of
        if known is None or known[0] is not parts[0] or known[1] is not parts[1]:
            self._steps_of = known = *parts, ModelSteps.of(self.robot, self.mpc.solver, *parts)
        return known[2]

    def _through(self, x: np.ndarray, torques: np.ndarray) -> np.ndarray:
        """The state x after ``torques`` (k, n + m), each for a period."""
        if not len(torques):
            return x
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
        self._detect_pushes(measurement.state, self.period)
        self._observe(measurement)
        if self.forecast is not None:
            m, more = measurement, (self._carried(), self._pushed(), self._answered())
            stop_for(self.forecast.update(m.time, m.state, *more))

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
        x, acted, model = self.measured.state, self._acted(), self._model_steps
        if model is not None:
            self._accelerates = model.accelerations(x, acted, self.period)
            return
        rates = self.robot.state["arm_velocity"]
        self._accelerates = (self._step(x, acted, self.period)[rates] - x[rates]) / self.period

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
        push_fault = None if self.lean_control is None else self.lean_control.push_fault
        return [*self._found, *filter(None, [push_fault])]

    def _carried(self) -> float:
        """The mass [kg] that the end effector is believed to hold."""
        return 0.0 if self.payload is None else self.payload.mass

    def _pushed(self) -> np.ndarray:
        """The estimated horizontal force (2) [N] at the end effector."""
        return np.zeros(2)

    def _answered(self) -> np.ndarray:
        """By how much (2) [m] the lean's divergent component counts like more than it is, under the learned disturbance."""
        if self.lean_control is None or self.measured is None:
            return np.zeros(2)
        return self.lean_control.shift(self.disturbance, float(self.measured.state[2]))

    def _detect_pushes(self, x: np.ndarray, h: float) -> None:
        """Estimate a push from the state x, ``h`` [s] after the one before."""
        if self.shoves is not None:
            self.shoves.update(x, self._acted(), h, self._step)

    def _observe(self, measurement: BallMeasurement) -> None:
        if self.observer is None and self.shoves is None:
            return
        if self.observer is not None:
            self._learn(measurement.time, measurement.state, self.period)
        self.mpc.solver.set_parameters(self.parameters())

    def _learn(self, t: float, x: np.ndarray, h: float) -> None:
        """Disturbance and payload from the state x at time t [s], ``h`` [s] after the one before."""
        observer, n, model = self.observer, ball_base(self.robot).nq, self._model_steps
        assert observer is not None
        if model is not None:
            model.learn(t, x, self._acted(), h)
        else:
            observer.update(t, x, self._acted(), h)
            if self.payload is not None:
                self.payload.observe(x[:n], observer.arrays, observer.learning, h)
        self.disturbance = self._finite(observer.force)
        if self.lean_control is not None:
            self.lean_control.check(t, self.disturbance, x)

    def _finite(self, disturbance: np.ndarray) -> np.ndarray:
        if not all(map(math.isfinite, disturbance.tolist())):
            raise NotFinite(f"the estimated disturbance is not finite{self._too_fast()}")
        return disturbance

    def _too_fast(self) -> str:
        """The arm's joint that is believed to turn farthest beyond its limit, for there the model has no answer in the end;
        empty if none does."""
        assert self.measured is not None
        part = self.robot.state["arm_velocity"]
        speeds, limits = np.abs(self.measured.state[part]), self.robot.limits.state_upper[part]
        i = int(np.argmax(speeds / limits))
        name, push_fault = (
            self.robot.state.groups["arm"][i],
            f"{speeds[i]:.0f} rad/s, and its limit is {limits[i]:g} rad/s",
        )
        return f": {name} is believed to turn at {push_fault}" if speeds[i] > limits[i] else ""

    def parameters(self) -> dict[str, np.ndarray]:
        """The model's parameters by group, as they are believed now."""
        own = {"disturbance": self.disturbance}
        if self.shoves is not None or self.lean_control is not None:
            own["push"] = self._room()
        return own if self.payload is None else {**own, "payload": np.array([self.payload.mass])}

    def _room(self) -> np.ndarray:
        """What (2) [m] the limit of the lean counts beside the lean: detected pushes, estimated forces."""
        pushed = None if self.shoves is None else self.shoves.room
        if self.lean_control is None or self.measured is None:
            return np.zeros(2) if pushed is None else pushed
        learned = self.lean_control.center(self.disturbance, float(self.measured.state[2]))
        return learned if pushed is None else pushed + learned

    def _late(self) -> int:
        """By how many ticks the measurement is late; one from before all torques that are known counts as from the first."""
        assert self.measured is not None
        return self.sent.ticks(self.measured.age)

    def _acted(self) -> np.ndarray:
        """The torques (n + m) that acted at the measurement."""
        measured, sent = self.measured, self.sent
        known = self._known_acted
        if known is None or known[0] is not measured or known[1] != sent.count:
            self._known_acted = known = measured, sent.count, sent.acted(self._late())
        return known[2]

    def _turning(self, age: float) -> float:
        """The torque [N m] about the vertical with which the wheels turned the ball ``age`` [s] ago."""
        acted = self.sent.acted(self.sent.ticks(age)).tolist()
        return sum(map(mul, self._spin, acted))  # (of its wheels alone: the shorter one ends it)

    def state(self) -> np.ndarray:
        """The measured state brought up to now by the torques that have acted since."""
        assert self.measured is not None
        return self._through(self.measured.state, self.sent.since(self._late()))

    def ahead(self) -> np.ndarray:
        """The state in which the next command will act: by the dead time after now, under the torques that were sent before."""
        known, measured, sent = self._known, self.measured, self.sent
        if known is None or known[0] is not measured or known[1] != sent.count:
            assert measured is not None
            if self._steps_alike:
                x = self._through(measured.state, sent.since(self._late() + sent.dead, 0))
            else:  # what a subclass adds to the state now goes along
                x = self._through(self.state(), sent.since(sent.dead, 0))
            self._known = known = measured, sent.count, x
        return known[2].copy()

    def predict(self, t: float, until: float, plans: PolicyQueue) -> Observation:
        """The state at time ``until`` under the policies that will be active, through the drives' lag."""
        x, torque, dead = self.ahead(), self.sent.last, self.sent.dead * self.period
        for k in range(round((until - t) / self.period)):
            policy = plans.at(t + k * self.period)
            if policy is None:
                break
            target = self.limits.limited(self._law(t + dead + k * self.period, x, policy)[1], x)
            torque = self.sent.follow(target, torque)
            x = self._step(x, torque, self.period)
        return Observation(until + dead, x)

    def stop(self) -> BallCommand:
        """No torque."""
        return BallCommand(np.zeros(self.limit.size))

    def command(self, t: float, plans: PolicyQueue) -> BallCommand:
        """Torques at the predicted present state."""
        forecast, plan = self.forecast, plans.current
        if forecast is not None and plan is not None and plan is not forecast.seen:
            stop_for(forecast.update_plan(plan, self._carried(), self._answered()))
        x = self.ahead()
        self.feedforward, self.target = self._law(t + self.sent.dead * self.period, x, plans.current, acts=True)
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

"""What a ball robot's controller learns of forces that its model does not have: a disturbance, a payload, pushes, how far to lean."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.ball.disturbance import DisturbanceObserver
from wbmpc.bases.ball.lean_control import LeanControl
from wbmpc.bases.ball.messages import BallMeasurement
from wbmpc.bases.ball.model import ball_base
from wbmpc.bases.ball.model_steps import ModelSteps
from wbmpc.bases.ball.payload import PayloadEstimator
from wbmpc.bases.ball.push import PushEstimator
from wbmpc.bases.ball.sent_torques import SentTorques
from wbmpc.errors import NotFinite
from wbmpc.model.robot import RobotModel

#: Innovations of the base's speeds beyond which a force is a push, and no disturbance to learn: of the ball along x and y [m/s], of yaw, pitch
#: and roll [rad/s].
GATE = (0.06, 0.06, 0.25, 0.12, 0.12)


class LearnedForces:
    """``observer``: of the ``disturbance`` (nq) [N, N m]; ``payload``: weighs a mass at the end effector, where the model has one as a
    parameter; both are None unless it ``observes``. ``push_estimator``: detects pushes, for which the limit of the lean leaves room (None: it
    does not). ``lean_control``: lets the robot lean against forces that it has learned (None: as if there were none).
    ``step(x, u, h)``: the model's state (nx) after h [s].
    """

    def __init__(self, robot: RobotModel, step: Callable[[Array, Array, float], Array], observes: bool) -> None:
        base = ball_base(robot)
        self._step, self._joints, self._rates = step, robot.state.groups["arm"], robot.state["arm_velocity"]
        self._max_rates = robot.limits.state_upper[self._rates]
        self.disturbance: Array = np.zeros(base.nq)
        self.observer: DisturbanceObserver | None = None
        self.payload: PayloadEstimator | None = None
        if observes:
            self.observer = DisturbanceObserver(step, base.numeric.mass_matrix, base.nq, np.array(GATE))
            if "payload" in robot.parameters:
                self.payload = PayloadEstimator(base.numeric.tool_weight)
        self.push_estimator: PushEstimator | None = None
        self.lean_control: LeanControl | None = None
        # at which measurement, under which disturbance
        self._leant: tuple[BallMeasurement, Array, Sequence[float]] | None = None

    @property
    def carried(self) -> float:
        """The mass [kg] that the end effector is believed to hold."""
        return 0.0 if self.payload is None else self.payload.mass

    @property
    def pushed(self) -> tuple[float, float]:
        """The room (2) [m] that the limit of the lean leaves for a push."""
        return (0.0, 0.0) if self.push_estimator is None else self.push_estimator.lean_margin

    def detect_push(self, x: Array, acted: Array, h: float) -> None:
        """Estimate a push from the state x (nx), ``h`` [s] after the one before, under the torques (nu) that ``acted``."""
        if self.push_estimator is not None:
            self.push_estimator.update(x, acted, h, self._step)

    def learn(
        self, measured: BallMeasurement, h: float, sent: SentTorques, steps: ModelSteps | None, forwards: bool = False
    ) -> bool:
        """Disturbance and payload from a state that was measured ``h`` [s] after the one before, under the torques that were ``sent``; by
        compiled ``steps`` where there are such. Whether the solver has got them, as they have to be if this ``forwards`` them.

        Raises :class:`NotFinite` for a disturbance that is not finite."""
        observer, forwarded, t, x = self.observer, False, measured.time, measured.state
        assert observer is not None
        late = sent.ticks(measured.age)
        if steps is not None:
            leans, forwarded = steps.learn(t, x, sent.at(late), h, forwards, self.pushed)
        else:
            observer.update(t, x, sent.acted(late), h)
            if self.payload is not None:
                self.payload.observe(x[: observer.size], observer.arrays, observer.learning, h)
        self.disturbance = observer.force
        if not forwarded:
            self.check_finite(self.disturbance, x)
        if steps is not None:
            self._leant = measured, self.disturbance, leans
        if self.lean_control is not None:
            self.lean_control.check(t, self.disturbance, x, self.leans(measured))
        return forwarded

    def check_finite(self, disturbance: Array, x: Array) -> None:
        """Raises :class:`NotFinite` if the ``disturbance`` (n) is not finite, which names the joint of the arm that is believed to turn farthest
        beyond its limit in the state x (nx): there the model has no answer in the end."""
        if np.isfinite(disturbance).all():
            return
        speeds = np.abs(x[self._rates])
        i = int(np.argmax(speeds / self._max_rates))
        cause = ""
        if speeds[i] > self._max_rates[i]:
            speed, limit = f"{speeds[i]:.0f} rad/s", f"{self._max_rates[i]:g} rad/s"
            cause = f": {self._joints[i]} is believed to turn at {speed}, and its limit is {limit}"
        raise NotFinite(f"the estimated disturbance is not finite{cause}")

    def leans(self, measured: BallMeasurement | None) -> Sequence[float]:
        """:meth:`LeanControl.leans` (4) [m] under the learned disturbance; the lean's component (2) [m], where it is known too."""
        known, control = self._leant, self.lean_control
        if control is None or measured is None:
            return (0.0,) * 4
        if known is None or known[0] is not measured or known[1] is not self.disturbance:
            leans = control.leans(self.disturbance, float(measured.state[2]))
            self._leant = known = measured, self.disturbance, leans
        return known[2]

    def shift(self, measured: BallMeasurement | None) -> Sequence[float]:
        """By how much (2) [m] the lean's divergent component counts like more than it is, under the learned disturbance."""
        return self.leans(measured)[:2]

    def room(self, measured: BallMeasurement | None) -> Sequence[float]:
        """What (2) [m] the limit of the lean counts beside the lean: detected pushes, estimated forces."""
        if self.lean_control is None or measured is None:
            return self.pushed
        x, y = self.lean_control.center(self.leans(measured), float(measured.state[2]))
        return self.pushed[0] + x, self.pushed[1] + y

    def parameters(self, measured: BallMeasurement | None) -> dict[str, Array]:
        """The model's parameters by group, as they are believed at a measurement."""
        own = {"disturbance": self.disturbance}
        if self.push_estimator is not None or self.lean_control is not None:
            own["push"] = np.array(self.room(measured))
        return own if self.payload is None else {**own, "payload": np.array([self.payload.mass])}

"""The fall that can be foreseen: plans, or a present state, with a lean which the wheels cannot stop any more."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from wbmpc.bases.ball.balance import Balance, load_offset
from wbmpc.bases.ball.model import ball_base
from wbmpc.checks import not_negative, numbers
from wbmpc.errors import FallPredicted
from wbmpc.kernel.function import CompiledFunction
from wbmpc.model.robot import RobotModel
from wbmpc.mpc.policy import Policy

#: So many planned states are evaluated in one call.
PLANNED = 16
#: So many plans in a row that lean too far, and so long [s] of a state that does, are a fall.
PLANS, SECONDS = 8, 0.05


@dataclass(frozen=True)
class Fall:
    """At ``time`` [s] it is certain that the robot will fall: ``str()`` says why."""

    time: float
    why: str

    def __str__(self) -> str:
        return f"the robot will fall: {self.why}; motors off"


def stop_for(falls: Iterable[Fall]) -> None:
    """Raise :class:`FallPredicted` if there is one."""
    for fall in falls:
        raise FallPredicted(str(fall))


class FallPredictor:
    """Monitors every new plan of a ball robot's MPC, and its state: returns a :class:`Fall` when falling is certain.

    The lean is a hard limit of the problem, relaxed only where it cannot be held. A plan in which its divergent component goes
    beyond the wheels' reach within its first ``ahead`` [s] says that the optimizer, with all torques that there
    are, has found no other way; :data:`PLANS` such plans in a row are needed, for one solve may be far from converged. What a plan
    says later is worth little while a push lasts: a lean grows tenfold in half a second, and robots whose plans were lost there
    for 0.2 s have stood. A state that has been beyond it for :data:`SECONDS` is lost whatever is planned: a ball that slides on the
    floor does not do what plans say. A force on the end effector moves the lean from which the component counts; plans of a robot whose
    input it is say how large it is to be. A disturbance that has been learned moves it too (``shift``: see
    :class:`wbmpc.bases.ball.lean_control.LeanControl`). Raises :class:`InputError` (:class:`NotFinite`) for numbers that cannot be.
    """

    def __init__(self, robot: RobotModel, arm: np.ndarray, ahead: float = 0.1) -> None:
        not_negative("forecast of a fall", ahead=ahead)
        balance = Balance.of(robot, numbers("forecast of a fall", "arm", arm, len(robot.state.groups["arm"])))
        has_force = "force" in robot.input
        self._force = robot.input["force"] if has_force else None
        self.reach, self._bad = float(balance.reach.max()), 0
        self._within, self._ahead = -np.inf, ahead
        n, x = ball_base(robot).nq, ca.SX.sym("x", robot.state.size)
        w = ca.SX.zeros(robot.parameters.size)
        mass, end_effector = ca.SX.sym("mass"), ca.SX.sym("push", 2)
        if "payload" in robot.parameters:
            w[robot.parameters["payload"]] = mass
        offset = load_offset(ball_base(robot), x[:n], w)
        component = offset + ca.jacobian(offset, x[:n]) @ x[n : 2 * n] / balance.pole + balance.answer * end_effector
        given = ca.vertcat(x, mass, end_effector)
        #: the divergent component (2) [m] of a state (nx), a mass [kg] at the tool and a force (2) [N] there
        self.component = CompiledFunction(ca.Function("component", [given], [ca.densify(component)]))
        self._evaluate, self._size = self.component.evaluator(PLANNED), robot.state.size
        #: the plan that was checked last
        self.seen: Policy | None = None

    def update_plan(self, policy: Policy, payload: float = 0.0, shift: Sequence[float] = (0.0, 0.0)) -> list[Fall]:
        """What follows from the active plan (the same one again changes nothing); ``payload`` [kg] at the tool, if the model has it;
        ``shift`` (2) [m] of the divergent component."""
        if policy is self.seen:
            return []
        self.seen = policy
        soon = int(policy.times.searchsorted(policy.times[0] + self._ahead, "right")) - 1
        force = np.zeros((soon, 2)) if self._force is None else policy.u[:soon, self._force][:, :2]
        maximum = self._maximum(policy.x[1 : soon + 1], payload, force, shift)
        self._bad = self._bad + 1 if maximum > self.reach else 0
        if self._bad >= PLANS:
            return [self._fall(float(policy.times[0]), f"{PLANS} plans in a row lean", maximum)]
        return []

    def update(
        self,
        t: float,
        x: np.ndarray,
        payload: float = 0.0,
        force: ArrayLike = (0.0, 0.0),
        shift: Sequence[float] = (0.0, 0.0),
    ) -> list[Fall]:
        """What follows from the state x (nx) that was measured at time t [s], with a horizontal ``force`` (2) [N] on the end effector and a
        ``shift`` (2) [m] of the divergent component."""
        return self.judge(t, self._maximum(x[None], payload, np.array([force]), shift))

    def judge(self, t: float, maximum: float) -> list[Fall]:
        """As :meth:`update`, of a divergent component that is ``maximum`` [m] long."""
        if maximum <= self.reach or not math.isfinite(self._within):
            self._within = t
        if t - self._within >= SECONDS:
            return [self._fall(t, f"for {1e3 * SECONDS:.0f} ms it has leant", maximum)]
        return []

    def _maximum(self, states: np.ndarray, payload: float, force: np.ndarray, shift: Sequence[float]) -> float:
        """Largest divergent component [m] of states (n, nx) under forces (n, 2) [N] on the end effector, and a ``shift`` (2)."""
        (x, y), n, most = shift, self._size, 0.0
        for start in range(0, len(states), PLANNED):
            some = slice(start, start + PLANNED)
            count = len(states[some])
            given = self._evaluate.arguments[:count]
            given[:, :n], given[:, n], given[:, n + 1 :] = states[some, :n], payload, force[some]
            most = max(most, *(math.hypot(u + x, v + y) for u, v in self._evaluate(count).tolist()))
        return most

    def _fall(self, t: float, who: str, maximum: float) -> Fall:
        lean = f"{who} by {1e3 * maximum:.0f} mm at the center of mass"
        return Fall(t, f"{lean}, and the wheels can stop {1e3 * self.reach:.0f} mm")

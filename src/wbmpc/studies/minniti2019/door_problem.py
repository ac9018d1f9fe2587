"""The problem of the ball robot before a door: free end effector and pushing end effector as modes, with and without the door's equation."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.ball.defaults import TaskCost, limit_arm, limit_torques
from wbmpc.bases.ball.residuals import JointEffort
from wbmpc.configuration import OneOf
from wbmpc.model.robot import RobotModel
from wbmpc.ocp import Constraint, Cost, OptimalControlProblem, RelaxedBarrier, SmoothL1, residuals, sets
from wbmpc.settings import MpcSettings, Nothing, Positive, Settings, Weight
from wbmpc.studies.minniti2019.door_model import WithDoor
from wbmpc.studies.minniti2019.door_plant import HALF_THICKNESS
from wbmpc.studies.minniti2019.door_residuals import ApproachSpeed, BodyClearance, PanelContact

PUSHING = ("held", "moving")
#: What base and elbow keep away from a panel [m], whose angle is known to 0.05 rad.
KEPT = 0.06
#: Of a body that comes nearer [1/m, per second].
PANEL_SLACK = 1e3


class PushCost(Settings):
    """Weights while the end effector pushes: error of the force along the normal and tangential forces [1/N²], orientation of the end effector
    [1/rad²], its linear and angular velocity, the ball's speed, the arm's angles [1/rad²] (a posture in which to follow the
    door)."""

    force: Weight = 3.0
    tangential: Weight = 0.1
    orientation: Weight = 10.0
    twist: Weight = 0.0
    angular: Weight = 0.2
    ball_speed: Weight = 0.2
    arm: Weight = 5.0


#: For an end effector whose motion the optimizer does not tie to the door: all force errors count alike, no posture (seeds 0 and 1).
UNTIED = PushCost(force=1.0, tangential=1.0, arm=0.0)


class FreeWrench(Settings):
    """The paper's problem: a free wrench at the end effector, and no door."""

    kind: Literal["wrench"] = "wrench"


class PushCone(Settings):
    """The end effector can only push, within a friction cone, as hard limits. ``friction``: friction coefficient of the cone;
    ``min_push`` [N]: along the door's normal."""

    kind: Literal["cone"] = "cone"
    friction: Positive = 0.35
    min_push: Weight = 0.5


class EstimatedCone(Settings):
    """A cone whose coefficient is not known: the robot's lower bound of it
    (:class:`wbmpc.studies.minniti2019.grip.GripEstimator`). ``least``: what any surface is trusted to have; ``min_push`` [N]: as of a
    :class:`PushCone`."""

    kind: Literal["estimated"] = "estimated"
    least: Positive = 0.09
    min_push: Weight = 0.5


class FreeApproach(Settings):
    """The end effector comes as its reference does."""

    kind: Literal["free"] = "free"


class LimitedApproach(Settings):
    """A touch at a speed that is limited, wherever the panel is. ``touch_speed`` [m/s]: the limit at the panel, towards it and along
    it; ``growth`` [1/s]: of the limit with the distance; ``known_to`` [m]: the panel is no farther than that from its probable place;
    ``leans``: the plan leans for the force before the touch, as a door needs that gives way; the touch of a slow end effector then recedes before
    it (left out: the plan knows of no touch before it is felt)."""

    kind: Literal["limited"] = "limited"
    touch_speed: Positive = 0.012
    growth: Positive = 5.0
    known_to: Weight = 0.010
    leans: bool = False

    def fastest(self, gap: float, after: Array) -> Array:
        """The limit (n) [m/s] at times ``after`` (n) [s] an end effector was ``gap`` [m] before the believed panel, if it comes at that limit."""
        return np.maximum((self.touch_speed + self.growth * gap) * np.exp(-self.growth * after), self.touch_speed)


class DoorEquation(Settings):
    """The door's states and equation of motion are in the problem. ``baumgarte`` [1/s]: rate at which planned gaps close; ``max_rate`` [rad/s]:
    largest rate of the door in plans; ``approach``: a :class:`FreeApproach` or a :class:`LimitedApproach`."""

    kind: Literal["door"] = "door"
    baumgarte: Positive = 10.0
    max_rate: Positive = 1.0
    approach: OneOf[FreeApproach | LimitedApproach] = FreeApproach()


class DoorScheme(Settings):
    """``contact``: what the problem knows of it, a :class:`FreeWrench` or the :class:`DoorEquation`; ``identify``: the door's impedance is
    estimated as it moves; ``cone``: none, a :class:`PushCone` or an :class:`EstimatedCone`."""

    contact: OneOf[FreeWrench | DoorEquation] = DoorEquation()
    identify: bool = True
    cone: OneOf[Nothing | PushCone | EstimatedCone] = PushCone()

    @property
    def approach(self) -> FreeApproach | LimitedApproach:
        """How the end effector comes to the panel."""
        return self.contact.approach if isinstance(self.contact, DoorEquation) else FreeApproach()

    @property
    def friction(self) -> float:
        """The friction coefficient that is planned with before anything is known of the panel's."""
        return self.cone.least if isinstance(self.cone, EstimatedCone) else getattr(self.cone, "friction", np.inf)

    @property
    def lead(self) -> float:
        """How far [m] ahead of an end effector that has not touched the panel is believed to be at least where plans lean for the touch: they
        close a gap by g̈ + 2 λ ġ + λ² g = 0, slow ones at λ g / 2: at this distance with the speed of the touch."""
        if isinstance(self.contact, FreeWrench) or not getattr(self.approach, "leans", False):
            return 0.0
        return 2.0 * self.approach.touch_speed / self.contact.baumgarte  # type: ignore[union-attr]

    @property
    def nearer(self) -> float:
        """How far [m] before its probable place a panel is believed to be until it is touched: as near as it may be."""
        return 0.0 if isinstance(self.approach, FreeApproach) else self.approach.known_to


def default_push_cost(scheme: DoorScheme) -> PushCost:
    """The weights while the end effector pushes that suit a scheme."""
    return PushCost() if isinstance(scheme.contact, DoorEquation) else UNTIED


def door_problem(
    robot: RobotModel,
    settings: MpcSettings,
    cost: TaskCost,
    slack: float,
    push: PushCost,
    scheme: DoorScheme,
    opening: float,
) -> OptimalControlProblem:
    """Costs of Minniti et al. 2019, sections III-A and IV-D, by modes; ``scheme`` adds what they leave out."""
    first = settings.first_interval or None
    contact, cone = scheme.contact, scheme.cone
    dynamics: Any = WithDoor(robot, opening) if isinstance(contact, DoorEquation) else robot.dynamics()
    ocp = OptimalControlProblem(dynamics, settings.horizon, settings.intervals, first_interval=first)
    _costs(ocp, robot, cost, push)
    if isinstance(contact, DoorEquation):
        ocp.add(Constraint("door", PanelContact(dynamics, contact.baumgarte), modes=PUSHING))
        rate = residuals.Expression(1, lambda s: s.all_x[dynamics.state["door"]][1])
        fast = sets.Box(-contact.max_rate, contact.max_rate)
        hard, barrier = settings.limits == "hard", RelaxedBarrier(settings.barrier_mu, 0.02)
        ocp.add(
            Constraint(
                "door_rate", rate, fast, at="path+terminal", penalty=RelaxedBarrier(settings.barrier_mu, 0.1), hard=hard
            )
        )
        if isinstance(scheme.approach, LimitedApproach):
            slow = ApproachSpeed(dynamics, scheme.approach.touch_speed)
            near = RelaxedBarrier(settings.barrier_mu, 0.1)
            ocp.add(Constraint("approach", slow, sets.NonNegative(), modes=("free",), penalty=near, hard=hard))
        apart = BodyClearance(dynamics, HALF_THICKNESS, KEPT)
        free = sets.NonNegative()
        ocp.add(Constraint("panel", apart, free, at="path+terminal", penalty=barrier, hard=hard, slack=PANEL_SLACK))
    ocp.add(Constraint("no_force", residuals.Input(robot, ["force"], reference=None), modes=("free",)))
    limit_arm(ocp, robot, settings, slack)
    limit_torques(ocp, robot, settings, cost.lean, ["wheel", "arm"])
    if not isinstance(cone, Nothing):
        within = residuals.FrictionCone(robot, cone.min_push)
        penalty = RelaxedBarrier(settings.barrier_mu, 0.1)
        ocp.add(
            Constraint(
                "cone", within, sets.NonNegative(), modes=PUSHING, penalty=penalty, hard=settings.limits == "hard"
            )
        )
    return ocp


def _costs(ocp: OptimalControlProblem, robot: RobotModel, cost: TaskCost, push: PushCost) -> None:
    h, b, end = cost.end_effector, cost.body, cost.terminal
    pose = np.array([h.weight] * 3 + [h.orientation, h.orientation, h.roll])
    turn = np.array([0.0] * 3 + [push.orientation, push.orientation, min(push.orientation, h.roll)])
    error = residuals.FramePose(robot, robot.tool, axes="reference")
    add = lambda name, residual, weight, **more: ocp.add(
        Cost(name, residual, list(weight), at="path+terminal", terminal_weight=list(end * np.asarray(weight)), **more)
    )
    add("end_effector", error, pose, norm=SmoothL1(h.limit), modes=("free",))
    add("turn", error, turn, modes=PUSHING)
    twist = residuals.FrameTwist(robot, robot.tool)
    add("twist", twist, np.array([h.twist] * 3 + [h.angular] * 3), modes=("free",))
    add("push_twist", twist, np.array([push.twist] * 3 + [push.angular] * 3), modes=PUSHING)
    kinds = (("body", b.ball_speed, b.arm, ("free",)), ("push_body", push.ball_speed, push.arm, PUSHING))
    for name, speed, posture, modes in kinds:
        n = robot.state
        weight = n.vector({"base": [b.ball, b.ball, b.yaw, 0, 0], "arm": posture, "arm_velocity": b.arm_rate})
        weight[n["base_velocity"]] = [speed, speed, b.yaw_rate, b.tilt_rate, b.tilt_rate]
        add(name, residuals.State(robot), weight, modes=modes)
    ocp.add(Cost("torque", residuals.Input(robot, ["wheel", "arm"]), {"wheel": cost.torque.wheel, "arm": 0.0}))
    ocp.add(Cost("effort", JointEffort(robot), cost.torque.arm))
    force = {"push": push.force, "across": push.tangential, "up": push.tangential}
    ocp.add(Cost("force", residuals.PushForce(robot), force, modes=PUSHING))

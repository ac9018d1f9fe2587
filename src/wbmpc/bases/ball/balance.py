"""How a ball robot falls, and how far it may lean: its unstable pole, and the leans that its wheels can still stop.

With the arm held, a lean goes as ẋ = A x + B τ with one unstable pole ω for each horizontal axis. Its divergent component
ξ = offset + rate / ω (capture point: Pratt et al. 2006; Takenaka et al. 2009) obeys ξ̇ = ω ξ + b τ: it can be stopped only as
long as ω |ξ| is smaller than the largest b τ within the torque limits. The ball's speed is not in it: no speed fells the robot.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from wbmpc.arrays import Array
from wbmpc.bases.ball.model import BallBase, ball_base
from wbmpc.errors import InputError
from wbmpc.model.kinematics import constant
from wbmpc.model.robot import RobotModel

#: The base's coordinates (x, y, yaw, pitch, roll); the arm's come after them.
BASE = 5
#: Steps of the sign of a matrix, at most: it doubles its digits with each once it is near.
SIGN_STEPS = 100


def load_offset(base: BallBase, q: ca.SX, w: ca.SX | None = None) -> ca.SX:
    """Horizontal offset (2) [m] of the center of mass of all that stands on the ball, from the ball's center, with the payload of
    the parameters w."""
    chain, first, mass = base.chain(q), ca.SX(3, 1), ca.SX(0)
    ball, _ = chain.link_place(1)
    for i, link in enumerate(base.tree.links):
        if i > 1 and link.mass > 0.0:
            position, turn = chain.link_place(i)
            first += link.mass * (position + turn @ constant(link.com) - ball)
            mass += link.mass
    carried = None if w is None else base.payload(w)
    if carried is not None:
        first += carried * (chain.frame_place(base.tool)[0] - ball)
        mass += carried
    return first[:2] / mass


@dataclass(frozen=True)
class Balance:
    """``pole`` [1/s]: how fast a lean grows, the mean of both axes. ``reach`` (n) [m]: the largest divergent component that the
    wheels can stop, in n evenly spread directions of the base (arm held, linear about the equilibrium). ``answer`` [m/N]: a
    steady horizontal force f on the tool counts like a divergent component of ``answer`` f, the mean of both axes: a robot
    that leans by so much against it balances without torque. For a steady generalized force d (5) [N, N m] on the base, in the
    heading's axes: ``shift`` (2, 5), the divergent component that it counts like; ``stand`` (2, 5), the offset [m] with which the
    robot stands still under it, so that the wheels' torque there is worth (shift + stand) d of the reach."""

    pole: float
    reach: Array
    answer: float
    shift: Array
    stand: Array

    @classmethod
    def of(cls, robot: RobotModel, arm: ArrayLike, directions: int = 36) -> Balance:
        """About the equilibrium for arm angles [rad]; the same of one robot are computed once."""
        numeric = ball_base(robot).numeric
        limits, maximum = robot.limits.input_upper[robot.input["wheel"]], robot.description.limits.spin_effort
        key = (np.asarray(arm, float).tobytes(), limits.tobytes(), maximum, directions)
        if key not in numeric.balances:
            numeric.balances[key] = cls._about(robot, arm, directions)
        found: Balance = numeric.balances[key]
        return found

    @classmethod
    def _about(cls, robot: RobotModel, arm: ArrayLike, directions: int) -> Balance:
        base = ball_base(robot)
        x, u = ball_base(robot).numeric.equilibrium(arm)
        a, b, pushed, offset, mass = _linear(robot, base, x, u)
        pole, component = divergent(a, offset)
        effect, answer = (component @ slope / pole for slope in (b, pushed))
        shift = component[:, BASE:] @ np.linalg.inv(mass) / pole
        limits, spin = robot.limits.input_upper[robot.input["wheel"]], base.wheel_torque_map()[2]
        maximum = robot.description.limits.spin_effort
        angles = 2.0 * np.pi * np.arange(directions) / directions
        reach = [_support(np.array([np.cos(v), np.sin(v)]) @ effect, limits, spin, maximum) for v in angles]
        # at rest, leans and wheel torques bear the force: M⁻¹ (forces by pitch, roll, wheels) z + M⁻¹ d = 0
        borne = np.linalg.pinv(mass @ np.hstack([a[BASE:, 3:BASE], b[BASE:]]))
        stand = -offset @ borne[:2]
        return cls(pole, np.array(reach), 0.5 * float(np.trace(answer)), shift, stand)


def divergent(a: Array, offset: Array) -> tuple[float, Array]:
    """The mean pole [1/s] and the divergent component (2, 10) of ẋ = a x, of which two modes grow: ξ = component @ x obeys
    ξ̇ = Ω ξ, and its part by the angles is that of the ``offset`` (2, 2).

    By an invariant subspace, not by eigenvectors: of two poles that are (nearly) the same, those are any pair. Its projector is half of
    one plus the sign of the matrix (Roberts 1980, by Newton's method).
    """
    poles = np.linalg.eigvals(a)
    least = 0.5 * float(poles.real.max())
    count, sign = int((poles.real > least).sum()), a - least * np.eye(len(a))
    if count != 2:
        raise InputError(f"balance: {count} poles of the base grow, not two (pitch and roll): {poles}")
    for _ in range(SIGN_STEPS):
        before, sign = sign, 0.5 * (sign + np.linalg.inv(sign))
        if np.abs(sign - before).max() <= 1e-13 * np.abs(sign).max():
            break
    left = np.linalg.svd(sign + np.eye(len(a)))[2][:2]  # its rows
    scale = offset @ np.linalg.inv(left[:, 3:BASE])
    return 0.5 * float(np.trace(left @ a @ left.T)), scale @ left


def _linear(robot: RobotModel, base: BallBase, x: Array, u: Array) -> tuple[Array, Array, Array, Array, Array]:
    """A (10, 10), B (10, wheels) of the base with the arm held, the same (10, 2) of a horizontal force on the tool, the
    offset's slope (2, 2) by (pitch, roll), and the base's mass matrix (5, 5)."""
    q, v = ca.SX.sym("q", base.nq), ca.SX.sym("v", base.nq)
    torque, end_effector = ca.SX.sym("u", u.size), ca.SX.sym("push", 2)
    more = ca.SX.zeros(robot.input.size - u.size)
    force = base.generalized_force(q, ca.vertcat(torque, more), ca.SX.zeros(robot.parameters.size))
    force -= base.inverse_dynamics(q, v, ca.SX(base.nq, 1))
    push = ca.jacobian(base.tool_force(q, ca.vertcat(end_effector, 0)), end_effector)
    parts = [ca.jacobian(force, q), ca.jacobian(force, torque), push, ca.jacobian(load_offset(base, q), q)]
    slopes = ca.Function("slopes", [q, v, torque], [ca.densify(p) for p in parts])
    n, wheels = base.nq, len(base.input["wheel"])
    by_q, by_u, by_push, offset = (np.array(s) for s in slopes(x[:n], x[n:], u))
    own = ball_base(robot).numeric.mass_matrix(x[:n])[:BASE, :BASE]
    mass = np.linalg.inv(own)
    a = np.block([[np.zeros((BASE, BASE)), np.eye(BASE)], [mass @ by_q[:BASE, :BASE], np.zeros((BASE, BASE))]])
    accelerates = lambda slope: np.vstack([np.zeros((BASE, slope.shape[1])), mass @ slope[:BASE]])
    return a, accelerates(by_u[:, :wheels]), accelerates(by_push), offset[:, 3:BASE], own


def _support(effect: Array, limits: Array, spin: Array, maximum: float) -> float:
    """Largest effect · τ over |τ| ≤ limits, |spin · τ| ≤ maximum: the least of limits · |effect − m spin| + maximum |m| over m, its dual,
    which is at a kink."""
    kinks = [0.0, *(effect[spin != 0.0] / spin[spin != 0.0])] if np.isfinite(maximum) else [0.0]
    return min(float(limits @ np.abs(effect - m * spin)) + (maximum * abs(m) if m else 0.0) for m in kinks)

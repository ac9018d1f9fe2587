"""A mass that comes or goes at once. Truth: the weight of a known mass, and an arm that it accelerates by Newton's law."""

from __future__ import annotations

import numpy as np
import pytest

from toys import robot
from wbmpc.bases.ball.payload import PayloadEstimator
from wbmpc.kernel.step import Backend, made_as

ROBOT = robot("rezero")
N, H = ROBOT.base.nq, 0.0025
HOME = ROBOT.home[:N]
WEIGHT, INERTIA = ROBOT.base.numeric.tool_weight(HOME), ROBOT.base.numeric.mass_matrix(HOME)


class Arm:
    """An estimator of the mass that a robot holds which a ``force`` (nq) besides that mass's weight moves; nobody else learns."""

    def __init__(self, mass: float = 0.0, backend: Backend = "compiled") -> None:
        self.estimator = PayloadEstimator(ROBOT.base.numeric.tool_weight, mass)
        self.velocity, self._backend = np.zeros(N), backend
        names = ("velocity", "after", "innovation", "force")
        self.observed = {name: np.zeros(N) for name in names} | {"mass": INERTIA.ravel().copy()}

    def observe(self, learning: float) -> None:
        with made_as(self._backend):  # the step is made with the first observation
            self.estimator.observe(HOME, self.observed, learning, H)

    def move(self, force: np.ndarray, seconds: float, learning: float = 1.0) -> float:
        """The mass after that."""
        for _ in range(round(seconds / H)):
            unexplained = force - self.estimator.mass * WEIGHT
            for name in ("velocity", "after"):  # the model says that nothing accelerates
                self.observed[name][:] = self.velocity
            self.observed["force"][:] = 0.0
            self.observe(learning)
            self.velocity = self.velocity + H * np.linalg.solve(INERTIA, unexplained)
        return self.estimator.mass


def test_a_load_is_known_within_a_fifth_of_a_second() -> None:
    assert Arm().move(1.0 * WEIGHT, 0.2) == pytest.approx(1.0, abs=0.15)
    assert Arm(mass=1.0).move(0.0 * WEIGHT, 0.2) == pytest.approx(0.0, abs=0.15)


def test_a_robot_that_has_not_been_calm_is_not_sure() -> None:
    arm = Arm()
    arm.move(0.0 * WEIGHT, 0.2, learning=0.2)
    assert arm.move(WEIGHT, 0.05) == 0.0


def test_what_is_no_weight_is_no_load() -> None:
    """A push at the base, and a torque of one arm's joint against the other's; and less than a quarter of a kilogram."""
    base = np.zeros(N)
    base[:2] = [100.0, 50.0]
    beside = np.zeros(N)
    beside[-2:] = [WEIGHT[-1], -WEIGHT[-2]]
    for force in (base, 2.0 * beside, 0.2 * WEIGHT):
        assert Arm().move(force, 0.2) == 0.0


def test_both_back_ends_weigh_alike() -> None:
    """A load that comes, is learned exactly, and goes; with noise of the speeds."""
    rng, arms = np.random.default_rng(3), (Arm(), Arm(backend="interpreted"))
    for k in range(160):
        speed, force = 0.01 * rng.normal(size=N), 0.1 * rng.normal(size=N) + (0.8 if 40 <= k < 110 else 0.0) * WEIGHT
        for arm in arms:
            arm.velocity += H * np.linalg.solve(INERTIA, force - arm.estimator.mass * WEIGHT)
            arm.observed["velocity"][:] = arm.velocity + speed
            arm.observed["after"][:], arm.observed["force"][:] = arm.velocity, 0.3 * force
            arm.observe(0.8)
        one, other = (np.append(arm.observed["force"], arm.estimator.mass) for arm in arms)
        np.testing.assert_allclose(one, other, rtol=1e-10, atol=1e-12)
    assert arms[0].estimator.mass > 0.0

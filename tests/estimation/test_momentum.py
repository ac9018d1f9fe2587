"""The force at the end effector without a sensor. Truth: a force that MuJoCo applies to the simulated robot's end effector."""

from __future__ import annotations

import numpy as np
import pytest

from toys import robot
from wbmpc.bases.ball.messages import BallCommand
from wbmpc.bases.ball.perturbation import BallPerturbation
from wbmpc.bases.ball.plant import BallPlant
from wbmpc.errors import InputError
from wbmpc.model.robot import load_robot
from wbmpc.studies.minniti2019.momentum import MomentumObserver, SensorlessForce

ROBOT, PUSHED = robot("rezero"), load_robot("rezero", contact="force")
HOME, TORQUE = ROBOT.base.numeric.equilibrium(ROBOT.home[ROBOT.state["arm"]])
FORCE = np.array([3.0, -1.5, 2.0])  # under which no joint gets faster than its drive in 0.1 s


def felt(perturbation: BallPerturbation, seed: int = 0) -> np.ndarray:
    """Estimates (n, 3) at 400 Hz: 0.1 s free, then 0.15 s under the force at the end effector, while the arm's torques vary."""
    plant = BallPlant(ROBOT.description, HOME, TORQUE, perturbation, seed)
    sensorless, out = SensorlessForce(PUSHED), []
    torque = TORQUE
    for k in range(100):
        if k == 40:
            sensorless.observer.zero()
            plant.push(FORCE, body="arm_forearm_link", point=[0.0, 0.0, 0.3])
        sensorless.update(plant.state(), torque, 0.0025, 0.0)
        out.append(sensorless.force)
        torque = TORQUE + np.array([0.0, 0.0, 0.0, 0.2, -0.3, 0.2]) * np.sin(0.2 * k)
        plant.step(BallCommand(torque), 5)
    return np.array(out)


def test_force_at_the_hand_is_found() -> None:
    """With a plant like the model, 0.1 s after its onset (three time constants of the observer); the ball's soft contact and
    its spin friction are not in the model."""
    found = felt(BallPerturbation.none(actuator_time_constant=0.0))
    assert np.abs(found[39]).max() < 0.3
    assert found[80] == pytest.approx(FORCE, abs=0.12 * np.linalg.norm(FORCE))
    early = found[45] @ FORCE / (FORCE @ FORCE)
    assert 0.1 < early < 0.6  # 12.5 ms of a bandwidth of 30 /s


def test_model_errors_are_zeroed_before_the_touch() -> None:
    """Two masses under known forces, a constant one that the model lacks, and later a force on a point that moves with both."""
    mass, unknown, jacobian = np.diag([2.0, 5.0]), np.array([1.5, -0.5]), np.array([[1.0, 0.5], [0.0, 2.0]])
    observer = MomentumObserver(lambda q: mass, lambda q, v: np.zeros(2), bandwidth=30.0)
    touch, v, h, found = np.array([3.0, -1.0]), np.zeros(2), 0.0025, []
    known = np.zeros(2)
    for k in range(800):
        observer.update(np.zeros(2), v, known, h)
        found.append(observer.force(jacobian, np.ones(2)))
        if k == 399:
            observer.zero()
        known = np.array([np.sin(0.1 * k), 0.3])
        pushed = jacobian.T @ touch if k >= 399 else np.zeros(2)
        v = v + h * np.linalg.solve(mass, known + unknown + pushed)
    assert np.linalg.norm(found[399]) > 0.5
    assert found[400] == pytest.approx(0.072 * touch, abs=0.01)  # one sample of a bandwidth of 30 /s
    assert found[-1] == pytest.approx(touch, abs=1e-3)


def test_bandwidth_must_be_positive() -> None:
    with pytest.raises(InputError, match="bandwidth"):
        MomentumObserver(lambda q: np.eye(1), lambda q, v: np.zeros(1), 0.0)

"""The task-space baseline and its comparison. Truth: accelerations of the planner's dynamics, figures computed once more."""

from __future__ import annotations

import signal
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from archives import without_units
from effort import thorough
from toys import robot
from wbmpc import lie
from wbmpc.bases.ball.defaults import RezeroCost, rezero_mpc
from wbmpc.bases.ball.sent_torques import DriveSettings
from wbmpc.bases.ball.settings import mpc_settings
from wbmpc.settings import ControlSettings
from wbmpc.studies.minniti2019 import taskspace as rezero_taskspace
from wbmpc.studies.minniti2019.taskspace import RezeroTaskspaceSettings
from wbmpc.studies.minniti2019.taskspace_control import TaskGains, TaskSpaceController

ROBOT = robot("rezero")
HOME, TORQUE = ROBOT.base.numeric.equilibrium(ROBOT.home[ROBOT.state["arm"]])


def hand_acceleration(x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Linear and angular (6), by differences of the end effector's pose along the motion of the planner's dynamics."""
    sx, su = ca.SX.sym("x", 16), ca.SX.sym("u", 6)
    f = ca.Function("f", [sx, su], [ROBOT.dynamics()(sx, su, ca.SX(11, 1), ca.SX(0, 1))])
    rate, h = np.array(f(x, u)).ravel(), 1e-3
    at = lambda s: ROBOT.pose(np.concatenate([x[:8] + s * x[8:] + 0.5 * s * s * rate[8:], x[8:]]))
    (after, turned), (now, middle), (previous, back) = at(h), at(0.0), at(-h)
    turn = lambda q: np.ravel(lie.quaternion_log(lie.quaternion_multiply(q, lie.quaternion_conjugate(middle))))
    return np.concatenate([after - 2.0 * now + previous, turn(turned) + turn(back)]) / h**2


def test_no_other_torques_come_nearer_to_what_the_hand_wants() -> None:
    """Without balance and torque weights: squared miss of the wanted acceleration, for the torques found and others."""
    place, quaternion = ROBOT.pose(HOME)
    goal, gains = place + [0.03, -0.02, 0.02], replace(TaskGains(), balance=1e-9, torque=1e-12)
    mpc = rezero_mpc(ROBOT, mpc_settings(3e-2), RezeroCost())
    controller = TaskSpaceController(
        ROBOT, mpc, lambda t: (goal, quaternion), gains, HOME, TORQUE, 0.0025, DriveSettings()
    )
    x = HOME.copy()
    x[13:16] = [1.0, -1.5, 1.2]
    after, turned = ROBOT.pose(x + np.r_[1e-6 * x[8:], np.zeros(8)])
    spin = np.ravel(lie.quaternion_log(lie.quaternion_multiply(turned, lie.quaternion_conjugate(quaternion)))) / 1e-6
    velocity = np.concatenate([(after - place) / 1e-6, spin])
    target = np.concatenate([gains.end_effector**2 * (goal - place), np.zeros(3)]) - 2.0 * gains.end_effector * velocity
    miss = lambda torque: float(np.sum((hand_acceleration(x, torque) - target) ** 2))
    torque, rng = controller._solve(0.0, x), np.random.default_rng(0)
    assert np.all(np.abs(torque) < controller.limit - 1e-3) or miss(torque) < miss(TORQUE)
    inside = lambda u: np.clip(u, -controller.limit, controller.limit)
    others = [miss(inside(torque + size * rng.normal(size=6))) for size in (0.03, 0.3) for _ in range(20)]
    assert miss(torque) <= min(others) + 1e-3
    assert miss(torque) < 0.5 * miss(TORQUE)


def test_torques_of_the_baseline_respect_the_limits() -> None:
    mpc = rezero_mpc(ROBOT, mpc_settings(3e-2), RezeroCost())
    far = (ROBOT.pose(HOME)[0] + [2.0, 0.0, 0.0], ROBOT.pose(HOME)[1])
    controller = TaskSpaceController(
        ROBOT, mpc, lambda t: far, replace(TaskGains(), end_effector=40.0), HOME, TORQUE, 0.0025, DriveSettings()
    )
    torque = controller._solve(0.0, HOME)
    assert np.all(np.abs(torque) <= controller.limit + 1e-9)
    assert np.any(np.abs(torque) > 0.99 * controller.limit)


@thorough
def test_both_controllers_take_the_steps() -> None:
    settings = RezeroTaskspaceSettings(settle_time=1.0, hold_time=1.0)
    result = rezero_taskspace.EXPERIMENT.run(settings, 1, None)
    assert result.completed, result.reason
    m, log = {n: v.value for n, v in result.metrics.items()}, result.log
    for name in ("mpc", "taskspace"):
        target = log.array(f"wanted_{name}")
        error = np.linalg.norm(log.array(f"hand_{name}") - target[:, :3], axis=1)
        assert m[f"hand_error_integral_{name}"] == pytest.approx(np.sum(error) * 0.0025, rel=0.01)
        assert 0.2 < m[f"hand_error_integral_{name}"] < 3.0  # steps of 0.1 to 0.4 m, a second each
        assert 0.0 < m[f"tilt_max_{name}"] < 0.5
    assert m["falls_taskspace"] == 0.0 and m["torque_squared_ratio"] > 0.0
    assert m["encoder_faults"] == 0.0 and result.faults == [] and without_units(log) == set()
    np.testing.assert_array_equal(log.array("wanted_mpc"), log.array("wanted_taskspace"))


@thorough
def test_ctrl_c_in_the_second_part_is_reported() -> None:
    def pressed(fraction: float, note: str) -> None:
        if note.startswith("taskspace") and fraction > 0.2:
            signal.raise_signal(signal.SIGINT)

    # the first part is only there to be over
    slow = RezeroTaskspaceSettings().mpc.model_copy(update={"rate": 40.0})
    settings = RezeroTaskspaceSettings(settle_time=0.5, hold_time=1.0, mpc=slow, control=ControlSettings(rate=200.0))
    result = rezero_taskspace.EXPERIMENT.run(settings, 1, pressed)
    assert result.interrupted and not result.completed and "interrupted" in result.reason
    # what was not run does not count as an error
    end_effector, target = result.log.array("hand_taskspace"), result.log.array("wanted_taskspace")
    error = np.linalg.norm(end_effector - target[:, :3], axis=1)
    assert (
        result.metrics["hand_error_integral_taskspace"].value
        <= error.max() * result.log.times("hand_taskspace")[-1] + 1e-9
    )

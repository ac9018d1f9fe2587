"""Elastic drives, dead time. Truth: two collinear hinges in MuJoCo (armature, spring); SciPy's frequency response; statics."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
import pytest
import scipy.signal

from effort import some
from wbmpc.bases.ball.elastic_drives import HEAD_ROOM, ElasticDrives
from wbmpc.bases.ball.messages import BallCommand
from wbmpc.bases.ball.perturbation import SeriesElasticDrives
from wbmpc.bases.ball.plant import BallPlant
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.errors import InputError
from wbmpc.model.robot import load_robot
from wbmpc.robots import load_description
from wbmpc.simulation.any_perturbation import AnyPerturbation

STEP = 5e-4
K, J, ZETA, GAIN, LOOP = 40.0, 0.01, 0.05, 1.0, 0.2
ROBOT = load_robot("rezero")
HOME, TORQUE = ROBOT.base.numeric.equilibrium(ROBOT.home[ROBOT.state["arm"]])
#: All drives behind springs, and nothing else that differs from the model.
ELASTIC = AnyPerturbation.none(
    actuator_time_constant=0.0,
    drives=SeriesElasticDrives(spring_damping=0.0, torque_gain=1.0, torque_damping=0.0),
)


def drives(n: int = 1, limit: float = 1e3, lag: float = 0.0, step: float = STEP) -> ElasticDrives:
    each = np.ones(n)
    return ElasticDrives(K * each, J * each, ZETA, GAIN, LOOP, limit * each, lag * each, step)


def hinges(load: float, elastic: bool, timestep: float = STEP) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """A load on a hinge; ``elastic``: behind a rotor (armature of a first hinge) and a spring (the second hinge)."""
    spec = mujoco.MjSpec()
    spec.option.timestep, spec.option.gravity = timestep, [0, 0, 0]
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    body = spec.worldbody.add_body(name="load", explicitinertial=True, mass=1.0, ipos=[0, 0, 0], inertia=[load] * 3)
    if elastic:
        body.add_joint(name="motor", axis=[0, 0, 1], armature=J)
        body.add_joint(name="spring", axis=[0, 0, 1], stiffness=[K, 0, 0], damping=[2 * ZETA * np.sqrt(K * J), 0, 0])
    else:
        body.add_joint(name="motor", axis=[0, 0, 1])
    spec.add_actuator(name="motor", target="motor", trntype=mujoco.mjtTrn.mjTRN_JOINT).set_to_motor()
    model = spec.compile()
    return model, mujoco.MjData(model)


def test_against_two_collinear_hinges() -> None:
    """A step and a sine into a load of the ball's size: its speed, the same within a hundredth of its largest."""
    command = lambda t: 2.0 + np.sin(60.0 * t)
    fine = STEP / 10
    model, data = hinges(0.04, elastic=True, timestep=fine)
    loop = 2.0 * LOOP * np.sqrt(K * (1.0 + GAIN) * J)
    truth = []
    for i in range(6000):
        t = fine * i
        target, spring = command(STEP * (i // 10)), -K * data.qpos[1]
        data.ctrl[0] = target + GAIN * (target - spring) + loop * data.qvel[1]
        mujoco.mj_step(model, data)
        if i % 10 == 9:
            truth.append(data.qvel.sum())
    model, data = hinges(0.04, elastic=False)
    ours, drive = [], drives()
    for i in range(600):
        t = STEP * i
        data.ctrl[0] = drive.step([command(t)], data.qvel)[0]
        mujoco.mj_step(model, data)
        ours.append(data.qvel[0])
    assert np.abs(np.array(ours) - truth).max() < 0.01 * np.abs(truth).max()
    assert drive.torque[0] != pytest.approx(command(STEP * 599), rel=0.01)  # it is not a rigid drive


@pytest.mark.parametrize("hertz", some([3.0, 14.0, 40.0], [1]))
def test_frequency_response_with_the_joint_held(hertz: float) -> None:
    step, omega = 1e-4, 2 * np.pi * hertz  # fine: the loop's own sampling is not in the truth
    drive, seen = drives(2, step=step), []
    for i in range(round(2.0 / step)):
        seen.append(drive.step(np.full(2, np.sin(omega * step * i)), np.zeros(2))[0])
    t = step * (np.arange(len(seen)) + 0.5)
    late = t > 1.0
    fit = np.linalg.lstsq(
        np.array([np.sin(omega * t[late]), np.cos(omega * t[late])]).T, np.array(seen)[late], rcond=None
    )
    d, c = 2 * ZETA * np.sqrt(K * J), 2 * LOOP * np.sqrt(K * (1 + GAIN) * J)
    _, (response,) = scipy.signal.freqs([d * (1 + GAIN), K * (1 + GAIN)], [J, d + c, K * (1 + GAIN)], [omega])
    assert np.hypot(*fit[0]) == pytest.approx(abs(response), rel=0.02)


def test_limits_and_lag() -> None:
    drive = drives(1, limit=3.0, lag=0.02)
    for _ in range(round(0.02 / STEP)):
        drive.step([5.0], [0.0])
    assert drive.target[0] == pytest.approx(3.0 * (1.0 - np.exp(-1.0)))
    for _ in range(round(2.0 / STEP)):
        drive.step([5.0], [0.0])
    assert drive.torque[0] == pytest.approx(3.0, rel=1e-6)


def slipping(traction: float, command: Callable[[float], float], seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Speeds of a load [rad/s] behind rotor, spring and a light wheel on dry friction, each on a hinge of its own (MuJoCo, a tenth
    of the step), and behind our drive."""
    spec = mujoco.MjSpec()
    spec.option.timestep, spec.option.gravity = STEP / 10, [0, 0, 0]
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    body, d = spec.worldbody, 2 * ZETA * np.sqrt(K * J)
    for name, inertia, stiffness, damping, friction in (
        ("rotor", J, 0.0, 0.0, 0.0), ("wheel", 2e-5, K, d, 0.0), ("load", 0.04, 0.0, 0.0, traction),
    ):  # fmt: skip
        body = body.add_body(name=name, explicitinertial=True, mass=1.0, ipos=[0, 0, 0], inertia=[inertia] * 3)
        body.add_joint(
            name=name, axis=[0, 0, 1], stiffness=[stiffness, 0, 0], damping=[damping, 0, 0], frictionloss=friction,
            solref_friction=[2e-4, 1.0], solimp_friction=[0.9999, 0.9999, 1e-3, 0.5, 2],
        )  # fmt: skip
    spec.add_actuator(name="motor", target="rotor", trntype=mujoco.mjtTrn.mjTRN_JOINT).set_to_motor()
    model = spec.compile()
    data, loop, limit = mujoco.MjData(model), 2.0 * LOOP * np.sqrt(K * (1.0 + GAIN) * J), 4.0
    ours, truth, speed, each = [], [], 0.0, np.ones(1)
    drive = ElasticDrives(K * each, J * each, ZETA, GAIN, LOOP, limit * each, 0.0 * each, STEP, traction)
    for i in range(round(seconds / STEP)):
        target = float(np.clip(command(STEP * i), -limit, limit))
        for _ in range(10):
            asked = target + GAIN * (target + K * data.qpos[1]) + loop * (data.qvel[1] + data.qvel[2])
            data.ctrl[0] = np.clip(asked, -HEAD_ROOM * limit, HEAD_ROOM * limit)
            mujoco.mj_step(model, data)
        truth.append(data.qvel.sum())
        speed += STEP * drive.step([target], [speed])[0] / 0.04
        ours.append(speed)
        assert abs(drive.torque[0]) <= traction
    return np.array(ours), np.array(truth)


def test_a_wheel_slips_beyond_its_traction() -> None:
    """Jumps from limit to limit, which the spring answers with more than the traction: the load goes as on dry friction in MuJoCo,
    within half a percent of its fastest. One that always grips would be far off."""
    jumps = lambda t: 8.0 * np.sign(np.sin(14.0 * t))
    ours, truth = slipping(4.0, jumps, 0.5)
    grips, _ = slipping(1e3, jumps, 0.5)
    fastest = np.abs(truth).max()
    assert np.abs(ours - truth).max() < 0.005 * fastest
    assert np.abs(grips - truth).max() > 0.05 * fastest


def test_balls_get_no_more_than_the_traction() -> None:
    """Commands that jump from limit to limit: all springs overshoot, but what acts on the ball is held by the wheels' traction."""
    plant, seen = BallPlant(ROBOT.description, HOME, TORQUE, ELASTIC), []
    for k in range(240):
        plant.step(BallCommand(np.where(k // 80 % 2, -1.0, 1.0) * np.array([4.0] * 3 + [20.0] * 3)), 1)
        seen.append(np.abs(plant.torque))
    maximum = np.max(seen, axis=0)
    assert maximum[:3].max() == pytest.approx(4.0, abs=1e-12)
    assert maximum[3:].max() > 20.0


def test_a_robot_at_rest_does_not_notice_its_springs() -> None:
    """Statics: at the equilibrium's torques the springs are wound up from the start, and the arm stays."""
    plant = BallPlant(ROBOT.description, HOME, TORQUE, ELASTIC)
    plant.step(BallCommand(TORQUE), 50)
    np.testing.assert_allclose(plant.torque, TORQUE, atol=0.03)  # the ball sinks a little into the floor
    np.testing.assert_allclose(plant.state()[5:8], HOME[5:8], atol=1e-4)


def test_springs_delay_torques_and_rigid_drives_do_not() -> None:
    rigid = BallPlant(ROBOT.description, HOME, TORQUE, AnyPerturbation.none(actuator_time_constant=0.0))
    rigid.step(BallCommand(TORQUE + 1.0))
    np.testing.assert_allclose(rigid.torque, TORQUE + 1.0, atol=1e-9)
    plant = BallPlant(ROBOT.description, HOME, TORQUE, ELASTIC)
    command = BallCommand(TORQUE + 1.0)
    np.testing.assert_allclose(plant.torque, TORQUE, atol=1e-9)
    plant.step(command)
    assert np.abs(plant.torque - TORQUE).max() < 0.05
    plant.step(command, 200)
    assert plant.torque[:3].min() > 0.5


def test_dead_time() -> None:
    """A torque acts after the dead time, not before."""
    plant = BallPlant(
        ROBOT.description, HOME, TORQUE, AnyPerturbation.none(actuator_time_constant=0.0, actuator_dead_time=0.003)
    )
    plant.step(BallCommand(TORQUE + 1.0), 6)
    np.testing.assert_allclose(plant.torque, TORQUE, atol=1e-12)
    plant.step(BallCommand(TORQUE + 1.0), 1)
    np.testing.assert_allclose(plant.torque, TORQUE + 1.0, atol=1e-12)


@pytest.mark.parametrize("time", [0.0003, 0.00275])
def test_a_dead_time_that_is_no_whole_step_is_rejected(time: float) -> None:
    with pytest.raises(
        InputError, match=r"plant\.actuator_dead_time: .* whole number of physics steps of 0\.5 ms; valid: e\.g\. "
    ):
        BallPlant(ROBOT.description, HOME, TORQUE, AnyPerturbation.none(actuator_dead_time=time))


def test_bad_drives() -> None:
    with pytest.raises(InputError, match=r"plant\.drives\.wheel_rotor"):
        ElasticDrives([K], [0.0], ZETA, GAIN, LOOP, [1e3], [0.0], STEP)
    for name in ("wheel_spring", "arm_spring", "wheel_rotor", "arm_rotor"):
        with pytest.raises(ValueError, match="greater than 0"):
            SeriesElasticDrives(**{name: 0.0})


#: What no line of the swerve robot's plant reads, by going through it.
OF_BALL_ROBOTS = ("actuator_dead_time", "drives", "torsional_friction") + (
    *("state_age", "position_noise", "angle_noise", "speed_noise", "rate_noise"),
)


@pytest.mark.parametrize("name", OF_BALL_ROBOTS)
def test_swerve_robots_reject_what_their_plant_does_not_read(name: str) -> None:
    with pytest.raises(InputError, match=rf"plant\.{name}: .*'swerve-ur10'.* does not read it; valid: "):
        SwervePlant(
            load_description("swerve-ur10"),
            perturbation=AnyPerturbation(**{name: "elastic" if name == "drives" else 0.1}),
        )

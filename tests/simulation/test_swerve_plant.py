"""The simulated swerve robot. Truth: statics, encoders' definition, the published drives and brakes."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from wbmpc.bases.swerve.brakes import BRAKE_TORQUE
from wbmpc.bases.swerve.messages import SwerveCommand
from wbmpc.bases.swerve.plant import STEER_SPEED, WHEEL_SPEED, SwervePlant
from wbmpc.bases.swerve.wheel_odometry import WheelOdometry
from wbmpc.errors import InputError
from wbmpc.model.robot import load_robot
from wbmpc.model.wheels import rolling_inverse_kinematics
from wbmpc.simulation.any_perturbation import AnyPerturbation
from wbmpc.studies.pankert2022.rolling import scale_wheels

ROBOT = load_robot("swerve-ur10")
STOP = SwerveCommand.stop()
H = {"leg": np.zeros(4), "steer": np.zeros(4)}
NONE = AnyPerturbation.none()


def plant(perturbation: AnyPerturbation = NONE, seed: int = 0, state=None, **options) -> SwervePlant:
    return SwervePlant(ROBOT.description, state, perturbation, seed, **options)


def at_rest(p: SwervePlant, seconds: float, brake: float = 0.0) -> None:
    for _ in range(round(seconds / 0.0025)):
        p.step(replace(STOP, brake=np.full(4, brake)), 5)


def test_rest_stays_at_rest_and_the_ground_carries_the_weight():
    p = plant(AnyPerturbation(), seed=3)
    start = p.truth()
    at_rest(p, 1.0)
    end = p.truth()
    assert np.abs(end.pose - start.pose).max() < 1e-6
    assert np.abs(end.tool - start.tool).max() < 1e-6
    assert end.wheel_force.sum() == pytest.approx(p.weight, rel=1e-6)
    assert p.time == pytest.approx(1.0) and not p.fell
    # the published mass is 100.87 kg; single masses are drawn within 5 %
    assert p.weight / 9.81 == pytest.approx(100.87, rel=0.05)
    assert plant().weight / 9.81 == pytest.approx(100.87, abs=0.01)


def test_without_a_search_for_islands_the_physics_are_the_same():
    """Truth: MuJoCo with that search, over a drive whose wheels steer, roll and slip."""

    def slow(spec: mujoco.MjSpec) -> None:
        spec.option.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_ISLAND)

    plants = [plant(AnyPerturbation(), seed=2, edit=edit) for edit in (None, slow)]
    assert plants[0].model.opt.disableflags != plants[1].model.opt.disableflags
    for k in range(60):
        turn = np.sin(0.1 * k + np.arange(4.0))
        for p in plants:
            p.step(SwerveCommand(4.0 + 3.0 * turn, turn, 0.2 * np.ones(6), np.zeros(4)), 5)
    quick, exact = (np.concatenate([p.data.qpos, p.data.qvel]) for p in plants)
    assert np.abs(plants[0].data.qvel).max() > 0.5
    np.testing.assert_allclose(quick, exact, rtol=0.0, atol=1e-12)


def test_truth_is_the_planners_kinematics():
    p = plant(state={"base": [0.4, -0.3, 2.0]})
    truth = p.truth()
    position, _ = ROBOT.pose(truth.state)
    # the tires sink in by less than half a millimeter
    assert np.abs(position - truth.tool).max() < 5e-4
    assert truth.pose == pytest.approx([0.4, -0.3, 2.0], abs=1e-4)
    x = ROBOT.home.copy()
    x[ROBOT.state["base"]] = [0.4, -0.3, 2.0]
    assert plant(state=x).truth().state == pytest.approx(truth.state, abs=1e-12)


def pushed(brake: float, state, seconds: float = 2.0) -> float:
    p = plant(state=state)
    start = p.truth().pose
    p.push([0.0, 100.0, 0.0])
    at_rest(p, seconds, brake)
    return float(np.hypot(*(p.truth().pose - start)[:2]))


def test_closed_brakes_hold_and_open_ones_let_the_base_go():
    assert pushed(0.0, H) < 3e-4
    assert pushed(1.0, H, seconds=1.0) > 0.02
    assert 2e-3 < pushed(1.0, None) < 0.02


def slip_torque(seed: int) -> float:
    """Torque [N m] at which the hinge of a wheel in the air starts to turn."""
    p = plant(AnyPerturbation(mass=0.0), seed, lift=0.5, settle=0.0)
    p.model.opt.gravity[:] = 0.0
    dof = p.model.joint("leg_LF").dofadr[0]
    torque = 150.0
    p.external = lambda m, d: d.qfrc_applied.__setitem__(dof, torque)
    while torque < 230.0 and abs(p.data.qvel[dof]) < 0.02:
        p.step(STOP, 2)
        torque += 0.5
    return torque


def test_a_brake_slips_at_200_newton_meters():
    assert 195.0 < slip_torque(0) < 206.0


def test_encoders_are_quantized_with_their_offsets():
    p = plant(AnyPerturbation(encoder_jitter=0.0), seed=5)
    m, joints, names = p.measure(), p.truth().joints, p._names
    for group, counts in (("leg", 2**14), ("steer", 2**14), ("wheel", 2**14), ("arm", 2**17)):
        step, values = 2 * np.pi / counts, getattr(m, group)
        assert values / step == pytest.approx(np.round(values / step), abs=1e-6)
        true = np.array([joints[n] for n in names[group]])
        assert np.abs(values - p.offsets[group] - true).max() <= step / 2 + 1e-12
    # the encoders see the start that was asked for
    assert np.abs(m.arm - ROBOT.home[ROBOT.state["arm"]]).max() < 1e-4
    # they are what was drawn, and nothing is drawn as zero
    for group, drawn in (
        ("steer", p.draw.mount_offset[1]),
        ("leg", p.draw.mount_offset[0]),
        ("arm", p.draw.arm_offset),
    ):
        np.testing.assert_array_equal(p.offsets[group], drawn)
        assert np.abs(drawn).min() > 0.0
    assert np.abs(p.offsets["steer"]).max() <= 0.003


def test_wheels_are_as_large_as_drawn():
    p = plant(AnyPerturbation(wheel_radius=0.01, wheel_radius_each=0.01), seed=5)
    assert np.unique(p.draw.radius).size == 4
    for factor, module in zip(p.draw.radius, p.base.modules, strict=True):
        size = p.model.geom(f"contact_{module.wheel}").size
        np.testing.assert_allclose(size[[0, 2]], factor * p.base.wheel_radius, rtol=1e-12)


def test_warnings_of_the_physics_go_to_the_log(tmp_path, monkeypatch, caplog):
    """MuJoCo itself would write them into a file in the working directory."""
    monkeypatch.chdir(tmp_path)
    caplog.set_level("WARNING", "wbmpc")
    p = plant()
    p.data.qvel[:] = 1e12
    p.step(STOP, 20)
    assert p.diverged
    assert "MuJoCo" in caplog.text
    assert not list(tmp_path.iterdir())


def test_a_message_has_one_age_of_up_to_two_milliseconds():
    p = plant(AnyPerturbation.none(encoder_jitter=0.002))
    command = replace(STOP, wheel=np.array([1.0, 1.0, -1.0, -1.0]))
    history, ages = [], []
    for k in range(400):
        p.step(command, 1)
        joints = p.truth().joints
        history.append([joints[n] for n in p._names["wheel"]])
        if k > 200:
            wheel = p.measure().wheel
            matches = [a for a in range(5) if np.array_equal(history[-1 - a], wheel)]
            assert len(matches) == 1
            ages += matches
    assert set(ages) == {0, 1, 2, 3, 4}


def test_measuring_is_of_the_state_before_the_command_and_changes_nothing():
    command = replace(STOP, wheel=np.full(4, 2.0), arm=np.full(6, 0.2))
    watched, unwatched = plant(), plant()
    for _ in range(20):
        previous = watched.measure()
        assert watched.measure() is previous
        watched.truth()
        watched.step(command, 5)
        unwatched.step(command, 5)
    assert np.array_equal(watched.data.qpos, unwatched.data.qpos)
    assert watched.measure().gyro == pytest.approx(unwatched.measure().gyro)


def test_runs_are_bitwise_repeatable_and_differ_by_seed():
    def run(seed: int) -> tuple[np.ndarray, list]:
        p, reported = plant(AnyPerturbation(), seed), []
        for k in range(60):
            m = p.measure()
            reported.append(np.concatenate([m.leg, m.steer, m.wheel, m.arm, m.gyro, m.accel]))
            p.step(replace(STOP, wheel=np.full(4, 0.02 * k), brake=np.full(4, float(k > 30))), 5)
        return p.data.qpos.copy(), reported

    (a, read_a), (b, read_b), (c, _) = run(1), run(1), run(2)
    assert np.array_equal(a, b) and all(np.array_equal(x, y) for x, y in zip(read_a, read_b, strict=True))
    assert not np.array_equal(a, c)


def test_steps_may_be_taken_singly():
    a, b = plant(AnyPerturbation(), 4), plant(AnyPerturbation(), 4)
    command = replace(STOP, arm=np.full(6, 0.3), wheel=np.full(4, 1.0))
    for _ in range(10):
        a.step(command, 5)
        for _ in range(5):
            b.step(command)
    assert np.array_equal(a.data.qpos, b.data.qpos)


def test_plant_and_planner_share_no_numbers():
    p, other = plant(AnyPerturbation(), 1), plant(AnyPerturbation(), 1)
    robot = load_robot("swerve-ur10")
    previous = [(link.mass, link.com.copy(), link.inertia.copy()) for link in robot.tree.links]
    home = robot.pose(robot.home)[0]
    kept = other.model.body_mass.copy()
    p.model.body_mass[:] = p.model.body_inertia[:] = p.model.body_ipos[:] = p.model.body_pos[:] = 7.0
    after = [(link.mass, link.com, link.inertia) for link in robot.tree.links]
    assert all(a == b[0] and np.array_equal(c, b[1]) for (a, c, _), b in zip(after, previous, strict=True))
    assert np.array_equal(robot.pose(robot.home)[0], home)
    assert np.array_equal(other.model.body_mass, kept)
    arrays = [a for link in robot.tree.links for a in (link.com, link.inertia, link.position, link.rotation)]
    arrays += [robot.base.geometry.hinge, robot.home]
    theirs = [p.model.body_mass, p.model.body_ipos, p.model.body_inertia, p.model.body_pos, p.data.qpos]
    assert not any(np.shares_memory(a, b) for a in arrays for b in theirs)
    ours = dict(zip([link.name for link in robot.tree.links], [link.mass for link in robot.tree.links], strict=True))
    ratios = [other.model.body(n).mass[0] / m for n, m in ours.items() if m > 0]
    assert all(0.95 <= r <= 1.05 for r in ratios) and len(set(ratios)) == len(ratios)


def drive(p: SwervePlant, v, seconds: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Roll a body twist with ramps; odometry and true pose, relative to the start, and the largest slip."""
    geometry, m = ROBOT.base.geometry, p.measure()
    odometry, start = WheelOdometry(geometry), p.truth().pose
    odometry.update(m.leg, m.steer, m.wheel)
    slip, ticks = 0.0, round(seconds / 0.0025)
    for k in range(ticks):
        m = p.measure()
        odometry.update(m.leg, m.steer, m.wheel)
        ramp = min(1.0, k / 200.0, (ticks - k) / 200.0)
        target, wheel = rolling_inverse_kinematics(geometry, m.leg, m.steer, ramp * np.asarray(v))
        p.step(SwerveCommand(wheel, 10.0 * (target - m.steer), np.zeros(6), np.zeros(4)), 5)
        slip = max(slip, float(p.truth().slip.max())) if k % 20 == 0 else slip
    m = p.measure()
    odometry.update(m.leg, m.steer, m.wheel)
    truth = p.truth().pose - start
    return odometry.pose, truth, slip


def test_odometry_follows_a_meter_straight_on():
    estimate, truth, slip = drive(plant(), [0.5, 0.0, 0.0], 2.5)
    assert truth[0] == pytest.approx(1.0, abs=0.03)
    # radius less half the tire's sink: some 7 mm in 10 m
    assert np.abs(estimate - truth).max() < 1.5e-3
    assert slip < 2e-3


def test_perturbed_wheels_make_odometry_drift():
    runs = [drive(plant(q, 2), [0.5, 0.0, 0.0], 2.5) for q in (NONE, AnyPerturbation())]
    ideal, real = (np.hypot(*(estimate - truth)[:2]) for estimate, truth, _ in runs)
    assert 5e-4 < real < 2e-2 and real > ideal


def test_drives_follow_with_their_lag_and_stop():
    p = plant()
    p.step(replace(STOP, arm=np.array([0.5, 0, 0, 0, 0, 0])), 40)
    reached = p.data.act[p.model.actuator("shoulder_pan_joint").id]
    assert reached == pytest.approx(0.5 * (1 - np.exp(-1.0)), rel=1e-6)
    at_rest(p, 0.5)
    assert np.abs(p.data.qvel).max() < 1e-3


def test_a_wheel_that_slides_carries_what_it_carries_at_rest():
    """Friction and drive forces lie in the floor and balance each other at constant speed: they shift no load. Statics alone."""
    fixed = load_robot("swerve-fixed-ur10")
    geometry, start = fixed.base.geometry, fixed.state.split(fixed.home)
    ahead = rolling_inverse_kinematics(geometry, np.zeros(4), start["steer"], np.array([0.15, 0.0, 0.0]))[0]
    ahead[1] += 0.5 * np.pi * (1.0 if ahead[1] < 0.0 else -1.0)  # one wheel across the way, which does not turn
    p = SwervePlant(fixed.description, start | {"steer": ahead}, NONE)
    at_rest(p, 0.1)
    rest = p.truth().wheel_force
    _, wheel = rolling_inverse_kinematics(geometry, np.zeros(4), ahead, np.array([0.15, 0.0, 0.0]))
    wheel[1], loads = 0.0, []
    for k in range(320):
        p.step(SwerveCommand(wheel * min(k / 120, 1.0), np.zeros(4), np.zeros(6), np.zeros(0)), 5)
        loads += [p.truth().wheel_force] if k > 200 else []
    assert p.truth().slip[1] > 0.12  # it slides
    assert np.abs(np.array(loads) - rest).max() < 0.15 * rest.min()


def test_drives_clip_at_their_limits():
    p = plant(lift=0.5, settle=0.0)
    p.step(SwerveCommand(np.full(4, 99.0), np.full(4, -99.0), np.full(6, 99.0), np.zeros(4)), 1)
    assert p.data.ctrl.max() == pytest.approx(WHEEL_SPEED) and p.data.ctrl.min() == pytest.approx(-STEER_SPEED)
    # those of another robot follow its file: as much faster than plans may be, and as strong as it says
    own = ROBOT.description
    wheels = [m.wheel for m in own.base.modules]
    limits = own.limits.model_copy(
        update={
            "velocity": own.limits.velocity | dict.fromkeys(wheels, 20.0),
            "effort": own.limits.effort | dict.fromkeys(wheels, 90.0),
        }
    )
    q = SwervePlant(own.model_copy(update={"limits": limits}), None, NONE, 0, lift=0.5, settle=0.0)
    q.step(SwerveCommand(np.full(4, 99.0), np.zeros(4), np.zeros(6), np.zeros(4)), 1)
    assert q.data.ctrl.max() == pytest.approx(2.0 * WHEEL_SPEED)
    assert q.model.actuator(wheels[0]).forcerange == pytest.approx([-90.0, 90.0])
    assert scale_wheels(np.array([5.0, 20.0, -1.0, 0.0]), 10.0) == pytest.approx([2.5, 10.0, -0.5, 0.0])
    assert not scale_wheels(np.zeros(4), 10.0).any()


@pytest.mark.parametrize(
    ("part", "values"),
    [("wheel", np.zeros(3)), ("steer", np.array([0, 0, np.nan, 0])), ("arm", np.zeros(7)), ("brake", np.zeros(2))],
)
def test_bad_commands_are_rejected(part, values):
    p = plant(settle=0.0)
    previous = p.data.qpos.copy()
    with pytest.raises(InputError, match=part):
        p.step(replace(STOP, **{part: values}), 5)
    assert np.array_equal(p.data.qpos, previous) and p.time == 0.0


def test_brakes_switch_dry_friction():
    p = plant()
    p.step(replace(STOP, brake=np.array([1.0, 0.0, 1.0, 0.0])), 1)
    dofs = [p.model.joint(n).dofadr[0] for n in ("leg_LF", "leg_RF", "leg_LB", "leg_RB")]
    assert p.model.dof_frictionloss[dofs] == pytest.approx([0.0, BRAKE_TORQUE, 0.0, BRAKE_TORQUE])


def test_the_inertial_unit_has_the_densities_and_biases_asked_for():
    p = plant(AnyPerturbation.none(gyro_noise=2e-4, gyro_bias=0.01, accel_noise=1e-3), seed=8)
    gyro, accel = [], []
    for _ in range(800):
        p.step(STOP, 5)
        m = p.measure()
        gyro.append(m.gyro)
        accel.append(m.accel)
    assert np.std(gyro, axis=0) == pytest.approx(2e-4 * np.sqrt(400.0), rel=0.15)
    assert np.std(accel, axis=0) == pytest.approx(1e-3 * np.sqrt(400.0), rel=0.15)
    assert np.mean(gyro, axis=0) == pytest.approx(p.draw.gyro_bias, abs=6e-4)
    assert np.mean(accel, axis=0) == pytest.approx([0.0, 0.0, 9.81], abs=3e-3)


def test_fixed_legs_have_no_leg_angles_and_ignore_brakes():
    p = SwervePlant(load_robot("swerve-fixed-ur10").description, None, AnyPerturbation(), 0)
    p.step(STOP, 5)
    p.step(replace(STOP, brake=np.zeros(0)), 5)
    assert p.measure().leg.size == 0 and p.measure().steer.size == 4


def test_falling_and_diverging_are_noticed():
    p = plant(settle=0.0)
    p.data.qpos[3:7] = [np.cos(0.5), np.sin(0.5), 0.0, 0.0]
    assert p.fell
    q = plant(settle=0.0)
    q.data.qvel[0] = np.nan
    q.step(STOP, 5)
    assert q.fell
    q.step(STOP, 5)
    assert q.time == pytest.approx(0.005)


def test_the_yaw_counts_turns():
    steer = rolling_inverse_kinematics(ROBOT.base.geometry, ROBOT.home[3:7], np.zeros(4), [0, 0, 1.0])[0]
    p = plant(state={"base": [0.0, 0.0, 3.1], "steer": steer})
    wheel = rolling_inverse_kinematics(ROBOT.base.geometry, ROBOT.home[3:7], steer, [0, 0, 1.0])[1]
    for _ in range(160):
        p.step(replace(STOP, wheel=wheel), 5)
    assert 3.3 < p.truth().pose[2] < 3.6


def test_unknown_names_are_rejected():
    with pytest.raises(InputError, match="valid: base, leg, steer, wheel, arm"):
        plant(state={"legs": np.zeros(4)})
    with pytest.raises(InputError, match="unknown body"):
        plant(settle=0.0).push([1.0, 0, 0], body="nothing")
    with pytest.raises(InputError, match="swerve base"):
        SwervePlant(load_robot("rezero").description)


def test_an_edit_adds_terrain_before_the_model_is_compiled():
    def block(spec) -> None:
        spec.worldbody.add_geom(name="block", type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.2, 0.2, 0.01], pos=[3, 0, 0.01])

    assert plant(edit=block, settle=0.0).model.geom("block").id >= 0

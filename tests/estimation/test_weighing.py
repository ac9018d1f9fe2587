"""A payload weighed by the torques of the arm's drives. Truth: MuJoCo's bias forces and its drives that carry a known mass."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from effort import draws
from toys import robot
from wbmpc.bases import base_type
from wbmpc.bases.swerve.defaults import SwerveCost, swerve_mpc
from wbmpc.bases.swerve.messages import SwerveCommand
from wbmpc.bases.swerve.perturbation import SwervePerturbation
from wbmpc.configuration import configure
from wbmpc.default_problem import carry
from wbmpc.errors import InputError
from wbmpc.estimation.payload import STILL, ArmScale, _holding_torques
from wbmpc.model.robot import RobotModel
from wbmpc.ocp import Reference
from wbmpc.registry import load
from wbmpc.robots import load_spec
from wbmpc.settings import MpcSettings, WheelLoadSettings
from wbmpc.solver import SQP

NAMES = ("swerve-ur10", "differential-ur10", "pr2")


@pytest.mark.parametrize("name", NAMES)
@given(seed=st.integers(0, 10**6))
@settings(max_examples=draws(5, 40), deadline=None)
def test_torques_are_those_of_mujoco_at_any_posture_and_acceleration(name: str, seed: int) -> None:
    model, rng = robot(name), np.random.default_rng(seed)
    m = load_spec(model.description).compile()
    d, x, felt = mujoco.MjData(m), model.home.copy(), rng.normal(0.0, 6.0, 3)
    part, names = model.state["arm"], model.state.groups["arm"]
    low, high = (np.clip(v[part], -3.0, 3.0) for v in (model.limits.state_lower, model.limits.state_upper))
    x[part] = rng.uniform(low, high)
    for group in model.state.groups:
        for joint, value in zip(model.state.groups[group], x[model.state[group]], strict=True):
            if group != "base":
                d.qpos[m.joint(joint).qposadr[0]] = value
    m.opt.gravity = -felt
    mujoco.mj_forward(m, d)
    dofs = [m.joint(n).dofadr[0] for n in names]
    own, each = (np.asarray(v).ravel() for v in _holding_torques(model, np.zeros(3))(x, felt))
    assert own == pytest.approx(d.qfrc_bias[dofs], abs=1e-8)
    jacobian = np.zeros((3, m.nv))
    (mujoco.mj_jacSite if model.tool in site_names(m) else mujoco.mj_jacBody)(
        m, d, jacobian, None, place_of(m, model.tool)
    )
    assert each == pytest.approx((felt @ jacobian)[dofs], abs=1e-9)


def site_names(m: mujoco.MjModel) -> list[str]:
    return [m.site(i).name for i in range(m.nsite)]


def place_of(m: mujoco.MjModel, tool: str) -> int:
    return int(m.site(tool).id if tool in site_names(m) else m.body(tool).id)


def weighed(model: RobotModel, perturbation: SwervePerturbation, seed: int, seconds: float = 1.0) -> ArmScale:
    """A scale that has watched a robot at rest."""
    plant, scale = base_type(model.description.base.type).plant(model, perturbation, seed), ArmScale(model)
    for _ in range(round(seconds / 0.01)):
        m = plant.measure()
        scale.update(m.time, m.arm, m.effort, m.accel, m.gyro)
        plant.step(rest(m), round(0.01 / plant.timestep))
    return scale


def rest(measured: object) -> object:
    """The command that holds a robot still."""
    from wbmpc.bases.planar_motion.messages import PlanarCommand

    if hasattr(measured, "leg"):
        return SwerveCommand.stop(measured.wheel.size, measured.arm.size)
    return PlanarCommand.stop(measured.wheel.size, measured.arm.size, measured.steer.size)


@pytest.mark.parametrize("name", NAMES)
def test_a_mass_is_weighed_exactly_by_exact_drives_and_within_half_a_kilogram_by_others(name: str) -> None:
    model = robot(name)
    for mass in (0.0, 1.5):
        assert weighed(model, SwervePerturbation.none(payload=mass), 0).mass == pytest.approx(mass, abs=0.02)
    for seed in range(3):
        scale = weighed(model, SwervePerturbation(payload=1.5), seed)
        assert scale.mass == pytest.approx(1.5, abs=0.5)
        assert scale.deviation < 1.0


def test_a_mass_is_known_soon_after_it_is_gripped_and_kept_while_the_arm_moves() -> None:
    model = robot("swerve-ur10")
    plant, scale = base_type("swerve").plant(model, SwervePerturbation.none(payload=0.01), 0), ArmScale(model)
    at, found = plant.model.body("payload").id, {}
    for k in range(300):
        if k == 100:
            plant.model.body_mass[at] = 5.0
        m = plant.measure()
        scale.update(m.time, m.arm, m.effort, m.accel, m.gyro)
        command = rest(m)
        if k >= 200:
            command = replace(command, arm=np.full(6, 3.0 * STILL))
        plant.step(command, round(0.01 / plant.timestep))
        found[k] = scale.mass
    assert found[99] == pytest.approx(0.0, abs=0.02)
    assert found[199] == pytest.approx(5.0, abs=0.3)
    assert found[299] == pytest.approx(found[210], abs=0.05)  # not weighed: the arm's own inertia would count


def test_nothing_is_weighed_where_drives_feel_no_mass() -> None:
    model = robot("swerve-ur10")
    scale = ArmScale(model, known=3.0)
    # free fall, a base that turns, no torques at all
    for accel, gyro, effort in (
        (np.zeros(3), np.zeros(3), np.ones(6)),
        (np.array([0, 0, 9.81]), np.array([0, 0, 1.0]), np.ones(6)),
        (np.array([0, 0, 9.81]), np.zeros(3), np.zeros(0)),
    ):
        for t in np.arange(0.0, 1.0, 0.05):
            assert not scale.update(t, model.home[model.state["arm"]], effort, accel, gyro)
    assert scale.mass == 3.0 and scale.deviation == np.inf


def test_an_arm_without_limits_of_torque_is_an_error_that_names_the_joint() -> None:
    model = robot("differential-ur10")
    first = model.state.groups["arm"][0]
    efforts = {k: v for k, v in model.description.limits.effort.items() if k != first}
    limits = model.description.limits.model_copy(update={"effort": efforts})
    without = RobotModel(model.description.model_copy(update={"limits": limits}))
    with pytest.raises(InputError, match=f"missing: {first}$"):
        ArmScale(without)


class Interpreted(MpcSettings):
    """Nothing is solved here: code would be compiled for nothing."""

    def solver(self) -> SQP:
        return replace(super().solver(), backend="interpreted")


def test_plans_count_with_a_new_mass_and_keep_what_else_their_references_say() -> None:
    stability = WheelLoadSettings(friction=0.5, payload=1.0, payload_center=(0.0, 0.0, 0.1))
    mpc = swerve_mpc(robot("swerve-ur10"), Interpreted(), SwerveCost(), stability=stability)
    push = [3.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    values = np.array([[*push, 1.0, 0.0, 0.0, 0.1], [*np.zeros(6), 1.0, 0.0, 0.0, 0.1]])
    mpc.reference["stability"] = Reference(np.array([0.0, 1.0]), values)
    carry(mpc, 4.0)
    assert mpc.reference["stability"].at(0.0).tolist() == [*push, 4.0, 0.0, 0.0, 0.1]
    assert mpc.reference["grip"].at(0.0).tolist() == [*[0.0] * 6, 4.0, 0.0, 0.0, 0.1, 0.5]


def test_a_load_that_plans_do_not_know_lifts_a_wheel_unless_it_is_weighed() -> None:
    experiment, found = load("tip-over"), {}
    for estimate in ("false", "true"):
        changes = ["stability.payload=0", f"stability.estimate_payload={estimate}", "after=1.5"]
        found[estimate] = experiment.run(configure(experiment.config_type, changes, "tip-over"), 1).metrics
    assert found["false"]["wheel_lifted_time_max"].value > 0.1
    assert found["true"]["wheel_lifted_time_max"].value == 0.0
    assert found["true"]["payload_error_end"].value < 0.7


def test_it_cannot_be_asked_for_without_physics() -> None:
    experiment = load("hold")
    changes = ["robot=swerve-ur10", "plant=kinematic", "stability=wheel_loads", "stability.estimate_payload=true"]
    with pytest.raises(InputError, match=r"estimate_payload.*plant=mujoco"):
        experiment.run(configure(experiment.config_type, changes, "hold"), 0)

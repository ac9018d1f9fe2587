"""Legs stand wider where the arm pulls. Truth: masses, wheels and end effector of MuJoCo, SciPy's convex hull, contact forces of the simulated
wheels."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest
from scipy.spatial import ConvexHull

import wbmpc as wb
from wbmpc import lie
from wbmpc.bases import base_type
from wbmpc.bases.swerve.leg_widening import BACK_AFTER, ENOUGH, TOO_LITTLE, LegWidening
from wbmpc.model.robot import RobotModel
from wbmpc.ocp import Constraint, Reference, residuals, sets
from wbmpc.robots import load_spec
from wbmpc.settings import WheelLoadSettings
from wbmpc.simulation.lockstep import run_lockstep
from wbmpc.tasks.loop import make_system
from wbmpc.tasks.settings import MujocoPlant, TaskSettings
from wbmpc.tasks.tip_over import reaching

SIDE, RATE, BEGIN = 0.5 * np.pi, 0.25, 0.3


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return reaching(wb.load_robot("swerve-ur10"), SIDE, "home")


class TrueMargin:
    """Margins [m] of a robot that carries a weight, from MuJoCo's masses."""

    def __init__(self, robot: RobotModel) -> None:
        self.robot, self.model = robot, load_spec(robot.description).compile()
        self.data = mujoco.MjData(self.model)

    def margin(self, x: np.ndarray, kg: float) -> float:
        robot, model, data = self.robot, self.model, self.data
        for group in ("leg", "steer", "arm"):
            for joint, value in zip(robot.state.groups[group], x[robot.state[group]], strict=True):
                data.qpos[model.joint(joint).qposadr[0]] = value
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        body = data.body(robot.description.base.body)
        mass = float(model.body_mass.sum())
        here = x.copy()
        here[:3] = 0.0
        tool = robot.pose(here, robot.tool)[0]
        turned = body.xmat.reshape(3, 3).T
        center = turned @ (data.subtree_com[0] - body.xpos)
        middle = (mass * center[:2] + kg * np.asarray(tool)[:2]) / (mass + kg)
        joints = [model.joint(w).id for w in robot.state.groups["wheel"]]
        wheels = [(turned @ (data.xpos[model.jnt_bodyid[j]] - body.xpos))[:2] for j in joints]
        return float(-np.max(ConvexHull(wheels).equations @ [*middle, 1.0]))


def holding(robot: RobotModel, kg: float, **terms: Any) -> Any:
    """With what is used of an MPC whose plan stays at home and knows that the end effector carries ``kg`` [kg]."""
    carried = Reference.constant([*[0.0] * 6, kg, 0.0, 0.0, 0.0])
    known = {"stability": SimpleNamespace(residual=residuals.WheelLoads(robot, payload=True))}
    plan = SimpleNamespace(x=robot.home[None], grid=np.zeros(1))
    return SimpleNamespace(
        solver=SimpleNamespace(trajectory=lambda copy: plan),
        ocp=SimpleNamespace(terms=terms or known),
        reference={"stability": carried},
    )


def widened(robot: RobotModel, mpc: Any) -> np.ndarray:
    """The robot (nx) with its legs where they are to be in the end."""
    legs = LegWidening(robot, mpc, RATE)
    legs.look(0.0, BEGIN)
    x = robot.home.copy()
    x[robot.state["leg"]] += legs.offset(np.array([100.0]))[0]
    return x


def test_the_stance_holds_what_the_arm_holds(robot: RobotModel) -> None:
    truth, kg = TrueMargin(robot), 15.0
    least = truth.margin(robot.home, 0.0)
    assert truth.margin(robot.home, kg) < TOO_LITTLE * least
    x = widened(robot, holding(robot, kg))
    assert truth.margin(x, kg) >= ENOUGH * least - 1e-6
    # no farther than that asks for
    way = x - robot.home
    assert truth.margin(robot.home + 0.8 * way, kg) < ENOUGH * least
    assert (x[robot.state["leg"]] <= robot.limits.state_upper[robot.state["leg"]] + 1e-9).all()


def test_legs_turn_as_fast_as_they_may_and_not_before_their_brakes_are_open(robot: RobotModel) -> None:
    legs = LegWidening(robot, holding(robot, 15.0), RATE)
    legs.look(0.0, BEGIN)
    times = np.linspace(0.0, 10.0, 1001)
    way = legs.offset(times)
    assert not way[times <= BEGIN].any() and legs.moved
    rates = np.abs(np.diff(way, axis=0)).max(axis=1) / np.diff(times)
    assert rates.max() == pytest.approx(RATE, rel=1e-6) and (rates < 1.001 * RATE).all()


def test_legs_go_back_some_time_after_the_load_is_put_down(robot: RobotModel) -> None:
    mpc = holding(robot, 15.0)
    legs, carried = LegWidening(robot, mpc, RATE), mpc.reference["stability"]
    where = []
    for t in np.arange(0.0, 40.0, 0.2):
        mpc.reference["stability"] = carried if t < 10.0 else Reference.constant(np.zeros(10))
        legs.look(float(t), float(t) + BEGIN)
        where.append(legs.offset(np.array([t]))[0])
    asked, times = np.abs(where).max(axis=1), np.arange(0.0, 40.0, 0.2)
    held = (times > 6.0) & (times < 10.0 + BACK_AFTER)
    assert np.ptp(asked[held]) == 0.0 and asked[held].min() > 0.3
    assert not asked[times > 25.0].any() and not legs.moved


def test_a_load_beside_the_end_effector_counts_where_it_is(robot: RobotModel) -> None:
    """12 kg are too light to ask for another stance; 0.3 m farther out they are not. The lever is MuJoCo's: along the reach."""
    near, far = holding(robot, 12.0), holding(robot, 12.0)
    rotation = lie.quaternion_to_rotation(robot.pose(robot.home, robot.tool)[1])
    center = rotation.T @ [0.0, 0.3, 0.0]
    far.reference["stability"] = Reference.constant([*[0.0] * 6, 12.0, *center])
    np.testing.assert_array_equal(widened(robot, near), robot.home)
    assert np.abs(widened(robot, far) - robot.home).max() > 0.1


@pytest.mark.parametrize("kg", [0.0, 3.0])
def test_a_light_load_moves_no_leg(robot: RobotModel, kg: float) -> None:
    np.testing.assert_array_equal(widened(robot, holding(robot, kg)), robot.home)


def test_constraints_of_another_kind_may_have_the_name(robot: RobotModel) -> None:
    own = Constraint("stability", residuals.Input(robot), sets.NonNegative())
    np.testing.assert_array_equal(widened(robot, holding(robot, 15.0, stability=own)), robot.home)


def test_only_a_plan_that_knows_loads_or_obstacles_moves_legs(robot: RobotModel) -> None:
    own = Constraint("stability", residuals.Input(robot), sets.NonNegative())
    for terms in ({}, {"stability": own}):
        mpc: Any = SimpleNamespace(obstacles=None, reference={"state": None}, ocp=SimpleNamespace(terms=terms))
        assert base_type("swerve").reshaping(robot, mpc, None) is None  # type: ignore[arg-type]


def test_wheels_share_a_weight_at_full_reach(robot: RobotModel) -> None:
    """In MuJoCo, with noise and delay: once the legs have turned the least loaded wheel carries more, brakes are closed and the end effector is
    where it was."""
    kg = 15.0
    settings = TaskSettings(
        robot="swerve-ur10",
        plant=MujocoPlant(payload=kg, wheel_radius_each=0.0),
        stability=WheelLoadSettings(payload=kg),
    )
    _, mpc = settings.prepare(robot=robot)
    system = make_system(robot, mpc, settings, 0)
    legs = base_type("swerve").reshaping(robot, mpc, system.controller)
    assert legs is not None
    truth, margins, brakes, tools, times = (
        TrueMargin(robot),
        list[float](),
        list[bool](),
        list[np.ndarray](),
        list[float](),
    )

    def see(t: float, command: Any, plans: Any) -> None:
        k = round(t / system.timing.period)
        if k % system.timing.mpc_every == 0:
            legs.update(t)
            now = system.plant.truth()
            times.append(t)
            margins.append(truth.margin(now.state[: robot.state.size], kg))
            brakes.append(bool(command.brake.any()))
            tools.append(now.tool)

    run_lockstep(*system.parts, 9.0, see)
    least = truth.margin(robot.home, 0.0)
    assert margins[0] < TOO_LITTLE * least and margins[-1] > ENOUGH * least - 5e-3
    assert any(brakes) and not any(np.array(brakes)[np.array(times) > 8.0])
    assert np.linalg.norm(tools[-1] - mpc.reference["end_effector"].at(9.0)[:3]) < 0.01

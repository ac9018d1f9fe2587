"""`touch`: contact at physics steps, its figures, the plan's limit of the speed. Truth: the momentum of a door that MuJoCo moves, differences
of plane geometry, SciPy's integration, series on paper."""

from __future__ import annotations

from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from wbmpc.bases.ball.messages import BallCommand
from wbmpc.bases.ball.perturbation import BallPerturbation
from wbmpc.configuration import configure
from wbmpc.errors import InputError
from wbmpc.model.robot import load_robot
from wbmpc.registry import load
from wbmpc.simulation.lockstep import Ending
from wbmpc.studies.minniti2019.contact import ContactDetector
from wbmpc.studies.minniti2019.door_control import DoorController
from wbmpc.studies.minniti2019.door_model import DoorGeometry, WithDoor, end_effector_motion, place_of
from wbmpc.studies.minniti2019.door_plant import Door
from wbmpc.studies.minniti2019.door_problem import DoorEquation, DoorScheme, LimitedApproach
from wbmpc.studies.minniti2019.door_residuals import ApproachSpeed
from wbmpc.studies.minniti2019.door_tracker import LIGHT, modes
from wbmpc.studies.minniti2019.door_trial import believed
from wbmpc.studies.minniti2019.grip import GripEstimator
from wbmpc.studies.minniti2019.press import TIPS
from wbmpc.studies.minniti2019.touch_figures import Touch, longest, metrics
from wbmpc.studies.minniti2019.touch_plant import TouchPlant

ROBOT = load_robot("rezero", contact="force")
HOME, TORQUE = ROBOT.base.numeric.equilibrium(ROBOT.home[ROBOT.state["arm"]])
HAND = ROBOT.pose(HOME)[0]


@pytest.mark.parametrize("tip", ["hard", "soft"])
def test_the_force_at_physics_steps_is_what_turns_the_door(tip: str) -> None:
    """A door without friction that swings into the tip: its angular momentum changes by the moment of the recorded force."""
    door = Door(
        (HAND[0] + 0.043, HAND[1] + 0.7), closed=-np.pi / 2 - 0.3, friction=0.0, closer=0.0, damping=0.0, grip=0.0, contact=TIPS[tip]
    )  # fmt: skip
    p = TouchPlant(ROBOT.description, door, HOME, TORQUE, BallPerturbation.none(actuator_time_constant=0.0))
    p.data.qpos[p._q], p.data.qvel[p._dof] = 0.3, -0.1
    for _ in range(160):
        p.step(BallCommand(TORQUE))
    steps = p.record()
    moment = float(np.sum(steps[:, 1]) * p.timestep * 0.7)
    assert steps[0, 1] == 0.0 and steps[:, 1].max() > 1.0
    assert door.inertia * (p.rate + 0.1) == pytest.approx(moment, rel=0.01)
    assert (
        np.abs(steps[:, 2]).max() < 1e-3 * steps[:, 1].max()
    )  # no grip, no force across, but for a turn within a step
    # before the touch the tip rests and the panel comes at 0.07 m/s
    first = int(np.flatnonzero(steps[:, 1] > 0.0)[0])
    assert steps[first - 2, 3] == pytest.approx(0.07, abs=0.01)


def test_the_row_is_the_difference_of_allowed_and_true_speed() -> None:
    dynamics, geometry = WithDoor(ROBOT, 1.0), believed(HAND)
    row = ApproachSpeed(dynamics, 0.01)
    x, u, m = (ca.SX.sym(n, k) for n, k in (("x", dynamics.state.size), ("u", dynamics.input.size), ("m", 1)))
    limit = ca.SX.sym("limit", 1)
    w = ca.DM(dynamics.parameters.vector({"place": place_of(geometry), "impedance": [2.5, 10.0, 3.0]}))
    symbols = SimpleNamespace(all_x=x, all_u=u, parameters=w, mode=m, reference=limit)
    value = ca.Function("row", [x, u, m, limit], [row(symbols)])
    motion, rng = end_effector_motion(ROBOT), np.random.default_rng(2)
    for allowed in (0.05, 0.01):
        for _ in range(5):
            state = HOME + 0.02 * rng.normal(size=HOME.size)
            _, velocity, _ = motion(state)
            along, normal = geometry.directions(0.0)
            found = np.array(value(np.concatenate([state, [0.0, 0.0]]), np.zeros(u.numel()), 1.0, allowed)).ravel()
            fast = [normal @ velocity, along @ velocity, -along @ velocity, velocity[2], -velocity[2]]
            assert 0.01 * found == pytest.approx(allowed - np.array(fast), abs=1e-9)


def test_no_row_of_the_approach_pushes_the_end_effector_off_the_panel() -> None:
    """A barrier pushes along a row's derivative: those by positions are zero where nothing moves."""
    dynamics = WithDoor(ROBOT, 1.0)
    x, u, m = (ca.SX.sym(n, k) for n, k in (("x", dynamics.state.size), ("u", dynamics.input.size), ("m", 1)))
    w = ca.DM(dynamics.parameters.vector({"place": place_of(believed(HAND)), "impedance": [2.5, 10.0, 3.0]}))
    symbols = SimpleNamespace(all_x=x, all_u=u, parameters=w, mode=m, reference=ca.SX(0.05))
    slope = ca.jacobian(ApproachSpeed(dynamics, 0.01)(symbols), x)[:, : ROBOT.state["base_velocity"].start]
    value = ca.Function("slope", [x, u, m], [slope])
    assert np.abs(np.array(value(np.concatenate([HOME, [0.0, 0.0]]), np.zeros(u.numel()), 1.0))).max() < 1e-9


def test_the_limit_falls_as_its_differential_equation_says() -> None:
    """Of an end effector that comes at the limit: ḋ = −(least + growth d) up to the panel, and the limit is that of the touch from there on."""
    approach = LimitedApproach(touch_speed=0.01, growth=4.0)
    there = lambda t, left: left[0]
    there.terminal = True  # type: ignore[attr-defined]
    times = np.linspace(0.0, 0.8, 9)
    run = solve_ivp(
        lambda t, left: -(0.01 + 4.0 * left), (0.0, 10.0), [0.1], events=there, dense_output=True, rtol=1e-9, atol=1e-12
    )
    assert run.t_events[0][0] > times[-1]
    assert approach.fastest(0.1, times) == pytest.approx(0.01 + 4.0 * run.sol(times)[0], rel=1e-5)
    assert approach.fastest(0.1, run.t_events[0] + np.array([0.0, 1.0])) == pytest.approx(0.01, rel=1e-5)


def test_plans_that_lean_for_a_touch_close_its_gap_at_its_speed() -> None:
    """Slow gaps close by g̈ + 2 λ ġ + λ² g = 0."""
    scheme = DoorScheme(contact=DoorEquation(approach=LimitedApproach(touch_speed=0.01, leans=True)))
    assert scheme.lead * DoorEquation().baumgarte / 2.0 == pytest.approx(0.01)
    assert DoorScheme(contact=DoorEquation(approach=LimitedApproach())).lead == 0.0 and DoorScheme().lead == 0.0


def test_a_touch_is_no_part_of_a_plan_before_it_is_felt() -> None:
    controller = DoorController.__new__(DoorController)
    controller.modes, controller.phase = modes(True), "approach"
    controller.contact = SimpleNamespace(touching=False)  # type: ignore[assignment]
    controller.push = SimpleNamespace(fastest=LimitedApproach().fastest, lead=0.0, give_up=9.0)  # type: ignore[assignment]
    controller.moving, controller._loaded = False, np.inf
    assert controller.schedule(2.0).events[0] > 1e3
    controller.phase, controller.contact.touching = "push", True
    assert controller.schedule(3.0).events[0] == 9.0


@pytest.mark.parametrize("opening", [1.0, -1.0])
def test_a_door_is_not_held_before_the_push_could_move_it(opening: float) -> None:
    """By statics: 3.5 N m at the hinge are 5 N at 0.7 m. What has not moved a tenth of a second after more than that is held."""
    controller = DoorController.__new__(DoorController)
    controller.modes, controller.phase, controller.moving, controller._loaded = modes(True), "push", False, np.inf
    controller.contact = SimpleNamespace(touching=True)  # type: ignore[assignment]
    controller.push = SimpleNamespace(fastest=LimitedApproach().fastest, lead=0.0, give_up=9.0)  # type: ignore[assignment]
    controller.geometry, controller.door = DoorGeometry((0.5, 0.2), 0.3, opening, 0.04), np.zeros(2)
    controller.lever, controller.impedance, controller.period = 0.7, np.array([2.5, 12.0, 3.5]), 0.01
    controller.grip = GripEstimator(0.1)
    normal, planned = controller.geometry.directions(0.0)[1], []
    place = controller.geometry.place(0.0, 0.7, 1.0)
    for k in range(60):
        controller.force = -(4.9 if k < 30 else 5.1) * normal
        controller._judge_grip(0.01 * k, (place, np.zeros(3), np.zeros(3)))
        planned.append(controller.schedule(0.01 * k).modes[0].name)
    assert planned == ["moving"] * 40 + ["held"] * 20


@pytest.mark.parametrize(("lead", "moves"), [(0.002, True), (0.0, True), (0.0, False)])
def test_a_panel_that_is_not_touched_is_ahead(lead: float, moves: bool) -> None:
    controller = DoorController.__new__(DoorController)
    controller.geometry, controller.push = believed(HAND), SimpleNamespace(lead=lead, fastest=moves)  # type: ignore[assignment]
    normal = controller.geometry.directions(0.0)[1]
    before = controller.geometry.gap(HAND, 0.0)
    for way in (0.05, 0.12, 0.11):
        controller._not_there(HAND + way * normal)
    farthest = controller.geometry.gap(HAND + 0.12 * normal, 0.0)
    assert farthest == pytest.approx(-lead if moves else 0.12 + before)


def test_a_light_contact_begins_at_once_and_outlasts_a_bounce() -> None:
    monitor, seen = ContactDetector(**LIGHT), []
    for k in range(100):
        hit = k in (10, 11, 25) or 40 <= k < 60
        seen.append(monitor.update(0.0025 * k, 3.0 if hit else 0.0))
    assert not any(seen[:10]) and all(seen[10:83]) and not any(seen[85:])
    with pytest.raises(InputError, match="release"):
        ContactDetector(release=-1.0)


@pytest.mark.parametrize("seed", range(5))
def test_a_tip_that_leans_on_a_panel_lightly_touches_it(seed: int) -> None:
    """Truth: the force itself, of 0.55 N for 0.13 s as a soft tip had it, which was no touch; the sensor's noise of 0.1 N is none in 20 s;
    nor is what is left of a mean when a push of 16 N has ended."""
    noise, h = 0.1 * np.random.default_rng(seed).normal(size=8400), 0.0025
    force = np.zeros(8400)
    force[8000:8052], force[8052:8200] = 0.55, 16.0
    monitor = ContactDetector(**LIGHT)
    seen = np.array([monitor.update(h * k, f) for k, f in enumerate(force + noise)])
    first = int(np.flatnonzero(seen)[0])
    assert 8000 <= first <= 8020 and seen[first:8200].all()  # within 50 ms
    assert not seen[8230:].any()
    with pytest.raises(InputError, match="mean_time"):
        ContactDetector(mean_time=-0.1)


def touch(force: np.ndarray, reason: str = "", speed: float = 0.1) -> Touch:
    """Forces at steps of 1 ms from 1 s on, before which the tip comes with 0.03 m/s."""
    t = np.arange(0.0, 3.0, 0.001)
    steps = np.zeros((t.size, 4))
    steps[:, 0], steps[t < 1.0, 3] = t, 0.03
    steps[1000 : 1000 + force.size, 1] = force
    return Touch(speed, 10.0, 0.5, 2.5, steps, Ending(reason))


def test_figures_of_a_touch_on_paper() -> None:
    force = np.full(1501, 10.0)
    force[:2], force[2:17], force[400:405] = 14.0, 0.0, 0.0
    good = touch(force)
    assert good.peak == 14.0 and good.lost == pytest.approx(0.015) and good.impact == pytest.approx(0.03)
    assert good.touched == pytest.approx(0.5)
    late = np.concatenate([np.zeros(300), force[:1000]])
    found = metrics([good, touch(late)], [touch(2.0 * force), touch(force)])
    assert found["touch_peak_ratio"].value == pytest.approx(1.4)
    assert found["touch_peak_ratio_plain"].value == pytest.approx(2.8)
    assert found["touch_time_extra"].value == pytest.approx(0.3)
    # from the last force to the end of the push it is lost
    assert found["contact_lost_max"].value == pytest.approx(2.5 - 2.299, abs=0.003)
    assert np.isinf(touch(force, "the robot fell").peak) and np.isinf(touch(np.zeros(5)).touched)
    assert np.isinf(metrics([good], [touch(np.zeros(5))])["touch_time_extra"].value)


def test_the_longest_loss() -> None:
    t = 0.1 * np.arange(8)
    assert longest(t, np.array([1, 0, 0, 1, 0, 0, 0, 1], bool)) == pytest.approx(0.3)
    assert longest(t, np.ones(8, bool)) == 0.0


@pytest.mark.parametrize("given", ["forces=[8]", "door=heavy", "speed=0.2"])
def test_settings_that_nothing_reads_are_rejected(given: str) -> None:
    with pytest.raises(InputError):
        configure(load("touch").config_type, [given], "touch")


def test_noise_of_the_speed_moves_no_panel_that_rests() -> None:
    """Speeds of an end effector that stands have a deviation of 0.02 m/s; a door that turns at 0.1 rad/s moves."""
    controller, rng = DoorController.__new__(DoorController), np.random.default_rng(3)
    controller.geometry, controller.phase, controller.period = believed(HAND), "push", 0.0025
    controller.contact = SimpleNamespace(touching=True)  # type: ignore[assignment]
    controller.push = SimpleNamespace(open=1.0, give_up=9.0)  # type: ignore[assignment]
    controller.sensor = SimpleNamespace(fault="")  # type: ignore[assignment]
    controller._place_door = controller._identify = lambda *given: None  # type: ignore[method-assign]
    controller.force = np.full(3, 5.0)
    controller.moving, controller._mean_rate, controller.door = False, 0.0, np.zeros(2)
    normal = controller.geometry.directions(0.0)[1]
    place = controller.geometry.place(0.0, 0.7, HAND[2])
    seen = {}
    for speed in (0.0, 0.07):
        moving = []
        for k in range(200):
            controller._follow(0.0025 * k, place, (speed + 0.02 * rng.normal()) * normal)
            moving.append(controller.moving)
        seen[speed] = np.mean(moving)
    assert seen[0.0] == 0.0 and seen[0.07] > 0.8

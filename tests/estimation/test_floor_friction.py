"""A floor's friction from slips. Truth: Coulomb's law of a base that is pushed along, and MuJoCo's floor under a robot that drives too fast."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from effort import draws
from toys import robot
from wbmpc.configuration import configure
from wbmpc.errors import InputError
from wbmpc.estimation.floor_friction import FORGETS, KEPT, SLIDES, FloorFriction, turning
from wbmpc.registry import load
from wbmpc.stability import StanceOf

H, GRAVITY = 0.0025, 9.81


class Base:
    """Wheels that ask for an acceleration [m/s²] along a floor of friction ``mu``, and slip by what it does not give; a share ``spin`` of
    it turns the base."""

    def __init__(self, floor: FloorFriction, spin: float = 0.0) -> None:
        self.floor, self.spin, self.rate = floor, spin, 0.0

    def drive(self, mu: float, asked: float, seconds: float) -> None:
        slip = 0.0
        for _ in range(round(seconds / H)):
            given = min(asked, mu * GRAVITY)
            slip = slip + H * (asked - given) if asked > given else 0.0
            self.rate += H * given * self.spin
            self.floor.update(H, np.array([given * np.sqrt(1.0 - self.spin**2), 0.0, GRAVITY]), self.rate, slip)


@given(mu=st.floats(0.1, 0.5), beyond=st.floats(1.5, 3.0), spin=st.floats(0.0, 1.0))
@settings(max_examples=draws(15, 150), deadline=None)
def test_a_slip_shows_the_coefficient_whether_the_base_is_pushed_or_turned(
    mu: float, beyond: float, spin: float
) -> None:
    floor = FloorFriction(0.6, turning=1.0)
    base = Base(floor, spin)
    base.drive(mu, 0.9 * mu * GRAVITY, 0.5)
    assert floor.bound == 0.6 and floor.slips == 0
    base.drive(mu, beyond * mu * GRAVITY, 0.6)
    assert floor.slips == 1
    assert floor.bound == pytest.approx(KEPT * mu, rel=0.03)


def test_a_floor_is_forgotten_and_one_that_bears_more_is_believed_at_once() -> None:
    floor = FloorFriction(0.6)
    base = Base(floor)
    base.drive(0.2, 5.0, 0.6)
    low = floor.bound
    base.drive(0.2, 0.0, FORGETS)
    assert floor.bound == pytest.approx(0.6 - (0.6 - low) / np.e, rel=0.01)
    base.drive(0.2, 5.0, 0.6)
    assert floor.bound == pytest.approx(low, rel=0.01) and floor.slips == 2
    base.drive(0.6, 0.4 * GRAVITY, 1.0)
    assert floor.bound == pytest.approx(KEPT * 0.4, rel=0.03)


def test_what_can_not_be_is_an_error_and_changes_nothing() -> None:
    with pytest.raises(InputError, match="believed"):
        FloorFriction(0.0)
    floor = FloorFriction(0.5)
    for accel, rate, slip in ((np.full(3, np.nan), 0.0, 0.0), (np.zeros(3), np.inf, 0.0), (np.zeros(3), 0.0, -SLIDES)):
        with pytest.raises(InputError):
            floor.update(H, accel, rate, slip)
    assert floor.bound == 0.5 and floor.slips == 0


def test_what_turning_takes_is_the_inertia_over_mass_and_distance_of_the_wheels() -> None:
    """Truth: the inertia of all bodies about the vertical by the parallel-axis theorem, in MuJoCo."""
    import mujoco

    from wbmpc.robots import load_spec

    model = robot("mecanum-ur10")
    m = load_spec(model.description).compile()
    d = mujoco.MjData(m)
    for joint, value in model.description.home.items():
        d.qpos[m.joint(joint).qposadr[0]] = value
    mujoco.mj_forward(m, d)
    base, inertia, mass = d.xpos[m.body(model.description.base.body).id], 0.0, 0.0
    for body in range(1, m.nbody):
        turn = d.ximat[body].reshape(3, 3)
        own = turn @ np.diag(m.body_inertia[body]) @ turn.T
        inertia += own[2, 2] + m.body_mass[body] * float(np.sum((d.xipos[body] - base)[:2] ** 2))
        mass += m.body_mass[body]
    distance = float(np.linalg.norm(StanceOf(model)(model.home).feet, axis=1).mean())
    assert turning(model) == pytest.approx(inertia / mass / distance, rel=0.02)
    reach = np.sum((model.pose(model.home)[0] - [*base[:2], 0.0])[:2] ** 2)
    assert turning(model, 10.0) == pytest.approx((inertia + 10.0 * reach) / (mass + 10.0) / distance, rel=0.02)


def test_plans_that_know_no_friction_or_robots_that_feel_no_slip_are_an_error() -> None:
    experiment, known = load("hold"), ["stability=wheel_loads", "stability.estimate_friction=true"]
    for changes, why in (
        (["robot=swerve-ur10"], "stability.friction=0"),
        (["robot=mecanum-ur10", "stability.friction=0.4"], "mecanum-ur10.*valid"),
        (["robot=swerve-ur10", "stability.friction=0.4", "plant=kinematic"], "plant=kinematic.*valid"),
    ):
        with pytest.raises(InputError, match=f"estimate_friction.*{why}"):
            experiment.run(configure(experiment.config_type, [*changes, *known], "hold"), 0)


def test_on_a_slippery_floor_a_robot_slides_less_if_it_feels_that_it_slips() -> None:
    experiment, found = load("swerve-fast"), {}
    for estimate in ("false", "true"):
        changes = ["course=s-curve", "plant.friction=0.3", "stability.friction=0.6", "plant.calibration=none"]
        changes += [f"stability.estimate_friction={estimate}", "after=2.5"]
        found[estimate] = experiment.run(configure(experiment.config_type, changes, "swerve-fast"), 1).metrics
    assert found["true"]["wheel_slip_max"].value < 0.6 * found["false"]["wheel_slip_max"].value
    assert found["true"]["floor_slips"].value >= 1.0 and 0.15 < found["true"]["floor_friction_least"].value < 0.31
    assert "floor_slips" not in found["false"]

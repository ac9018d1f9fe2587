"""Offset-free control. Truth: the disturbance that was put into the plant; zero mean error against the same loop without it.

The plants are integrated exactly or in finer steps than the plans; every measurement is noisy.
"""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest

from effort import some
from toys import Rows, robot
from wbmpc.errors import InputError, NotFinite
from wbmpc.estimation.offset import OffsetObserver
from wbmpc.model.ode import Ode
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Constraint, Cost, OptimalControlProblem, sets
from wbmpc.types import Observation

H, NOISE = 0.02, 1e-3
GRAVITY, LENGTH = 9.81, 0.5


def mass_point() -> Ode:
    """1 kg on a line, pushed by u and by an unknown force."""
    f = lambda x, u, w, m: ca.vertcat(x[1], u[0] + w[0])
    return Ode({"x": ["place", "speed"]}, {"u": ["force"]}, f, parameters={"d": ["force"]})


def lag() -> Ode:
    """A first-order lag of 0.3 s with a bias at its input."""
    f = lambda x, u, w, m: (u[0] + w[0] - x[0]) / 0.3
    return Ode({"x": ["y"]}, {"u": ["v"]}, f, parameters={"d": ["bias"]})


def arm() -> Ode:
    """2 kg at 0.5 m on one joint; the unknown torque stands for a load."""
    inertia = 2.0 * LENGTH**2
    gravity = lambda q: 2.0 * GRAVITY * LENGTH * ca.cos(q)
    f = lambda x, u, w, m: ca.vertcat(x[1], (u[0] + w[0] - gravity(x[0])) / inertia)
    return Ode({"x": ["q", "v"]}, {"u": ["torque"]}, f, parameters={"d": ["torque"]})


#: system, goal of its first state, u + d that holds it there, the plant's own ẋ (with what the model does not know)
HEAVY = 3.0 * LENGTH**2  # the arm carries 1 kg more than the model's 2 kg
CASES: dict[str, tuple[Callable[[], Ode], float, float, Callable[[np.ndarray, float], np.ndarray]]] = {
    "mass point": (mass_point, 0.5, 0.0, lambda x, u: np.array([x[1], u - 1.5])),
    "lag": (lag, 0.5, 0.5, lambda x, u: np.array([(u + 0.4 - x[0]) / 0.3])),
    "arm": (
        arm,
        0.7,
        2.0 * GRAVITY * LENGTH * np.cos(0.7),
        lambda x, u: np.array([x[1], (u - 3.0 * GRAVITY * LENGTH * np.cos(x[0])) / HEAVY]),
    ),
}


def controller(system: Ode, goal: float, hold: float, limit: float = 100.0) -> MPC:
    ocp = OptimalControlProblem(system, 1.0, 20, first_interval=H)
    target = np.zeros(system.state.size)
    target[0] = goal
    ocp.add(Cost("state", Rows(target.size, lambda s: s.x - target), [100.0, 1.0][: target.size], at="path+terminal"))
    ocp.add(Cost("input", Rows(1, lambda s: s.u + s.parameters - hold), 1.0))
    ocp.add(Constraint("limit", Rows(1, lambda s: s.u), sets.Box(-limit, limit), hard=True))
    return MPC(ocp, rate=1.0 / H)


def moved(rate: Callable[[np.ndarray, float], np.ndarray], x: np.ndarray, u: float) -> np.ndarray:
    """The plant H seconds later: ten classic Runge-Kutta steps."""
    h = H / 10
    for _ in range(10):
        a = rate(x, u)
        b = rate(x + 0.5 * h * a, u)
        c = rate(x + 0.5 * h * b, u)
        x = x + h / 6 * (a + 2 * b + 2 * c + rate(x + h * c, u))
    return x


def steady_error(case: str, observed: bool, seed: int) -> tuple[float, float]:
    """Mean error of the first state, and of the estimate against what it stands for, over the last 2 of 8 s."""
    make, goal, hold, rate = CASES[case]
    system = make()
    mpc, rng, x, u = controller(system, goal, hold), np.random.default_rng(seed), np.zeros(system.state.size), 0.0
    observer = OffsetObserver(
        system, "d", x, [0.0], measured=[system.state.names[0]], noise=NOISE, process=1e-2, walk=2.0
    )
    errors, estimates = [], []
    for k in range(400):
        observer.update([x[0] + NOISE * rng.normal()], [u], H)
        mpc.solver.set_parameters(observer.parameters() if observed else np.zeros(1))
        u = float(mpc.update(Observation(k * H, observer.state)).u[0, 0])
        x = moved(rate, x, u)
        errors.append(x[0] - goal)
        estimates.append(observer.offset[0] - (hold - u))  # at rest u + d = hold
    return float(np.mean(errors[-100:])), float(np.mean(estimates[-100:]))


@pytest.mark.parametrize("case", some(list(CASES), [1, 2]))
def test_no_steady_error_in_closed_loop(case: str) -> None:
    """The mean over 2 s is within what noise of 1e-3 leaves of it; without the estimate the error is tens of that."""
    for seed in (0, 1):
        error, estimate = steady_error(case, True, seed)
        assert abs(error) < 0.2 * NOISE, (error, seed)
        assert abs(estimate) < 0.05, estimate
    without, _ = steady_error(case, False, 0)
    assert abs(without) > 20 * NOISE


def test_an_input_weighed_against_zero_leaves_an_offset() -> None:
    """Why the cost must know d: the same loop with the input's cost around zero stays away by a share of d / (100 / 1)."""
    system = mass_point()
    mpc = controller(system, 0.5, 0.0)
    ocp = mpc.ocp
    del ocp.terms["input"]
    ocp.add(Cost("input", Rows(1, lambda s: s.u), 1.0))
    mpc, x = MPC(ocp, rate=1.0 / H), np.zeros(2)
    mpc.solver.set_parameters(np.array([-1.5]))  # the truth
    for k in range(400):
        x = moved(CASES["mass point"][3], x, float(mpc.update(Observation(k * H, x)).u[0, 0]))
    assert abs(x[0] - 0.5) > 5e-3


def test_no_wind_up_under_input_limits() -> None:
    """3 N against a drive of 2 N for 2 s, then 1 N: the estimate is right to 0.4 N rms of noise
    while the drive cannot hold it, and 0.6 s after.

    With the input that was commanded in place of the one that acted, it is wrong by what was cut off.
    """
    rng, system = np.random.default_rng(3), mass_point()
    mpc = controller(system, 0.0, 0.0, limit=2.0)
    reported, fooled = (
        OffsetObserver(system, "d", [0, 0], [0], measured=["x.place"], noise=NOISE, process=1e-2, walk=3.0)
        for _ in range(2)
    )
    x, u, asked, right, wrong = np.zeros(2), 0.0, 0.0, [], []
    for k in range(600):
        y = [x[0] + NOISE * rng.normal()]
        reported.update(y, [u], H)
        fooled.update(y, [asked], H)
        mpc.solver.set_parameters(reported.parameters())
        u = float(mpc.update(Observation(k * H, reported.state)).u[0, 0])
        asked = -20.0 * x[0] - 9.0 * x[1] - reported.offset[0]  # a linear law for the same task
        push = -3.0 if k < 100 else -1.0
        x = moved(lambda x, u, push=push: np.array([x[1], u + push]), x, u)
        right.append(reported.offset[0] - push)
        wrong.append(fooled.offset[0] - push)
    for part in (right[60:100], right[130:]):
        assert np.abs(part).max() < 1.0 and np.sqrt(np.mean(np.square(part))) < 0.4
    assert np.abs(wrong[60:100]).max() > 3.0
    assert abs(x[0]) < 0.02  # and the mass is back where it belongs


@pytest.mark.parametrize(
    ("system", "measured", "message"),
    [
        (
            Ode(
                {"x": ["place", "speed"]},
                {"u": ["force"]},
                lambda x, u, w, m: ca.vertcat(x[1], u[0] + w[0] + w[1]),
                parameters={"d": ["wind", "slope"]},
            ),
            ["x.place", "x.speed"],
            "'d.wind' cannot be distinguished from 'd.slope' by measuring x.place, x.speed",
        ),
        (
            Ode(
                {"x": ["place", "other"]},
                {"u": ["v"]},
                lambda x, u, w, m: ca.vertcat(u[0], w[0]),
                parameters={"d": ["push"]},
            ),
            ["x.place"],
            "'d.push' leaves no trace|'d.push' cannot be distinguished from 'x.other'",
        ),
        (
            # the place of a sensor that itself has an unknown zero: bias and level look the same
            Ode(
                {"x": ["level", "zero"]},
                {"u": ["v"]},
                lambda x, u, w, m: ca.vertcat(-x[0] + x[1] + w[0] + u[0], 0 * x[1]),
                parameters={"d": ["inflow"]},
            ),
            ["x.level"],
            "'d.inflow' cannot be distinguished from 'x.zero' by measuring x.level",
        ),
    ],
    ids=["two forces", "unseen", "a state that does not move"],
)
def test_what_cannot_be_distinguished_is_rejected(system: Ode, measured: list[str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        OffsetObserver(system, "d", np.zeros(2), np.zeros(1), measured=measured, noise=1e-3)


@pytest.mark.parametrize(
    ("y", "u", "h", "message"),
    [
        (0.5, 0.0, H, r"measurement needs 2 numbers \(x.place, x.speed\), got shape \(1,\)"),
        ([[0.5, 0.5]], 0.0, H, "measurement needs 2 numbers"),
        ([0.0, 0.0], [0.0, 0.0], H, "input needs 1 numbers"),
        ([0.0, 0.0], 0.0, -1.0, "at least 0 s, got -1"),
        ([0.0, 0.0], 0.0, np.nan, "must be finite"),
        ([0.0, np.nan], 0.0, H, "must be finite"),
    ],
)
def test_what_is_no_measurement_changes_nothing(y: object, u: object, h: float, message: str) -> None:
    observer = OffsetObserver(mass_point(), "d", [0, 0], [0], noise=1e-3)
    previous = observer.mean.copy(), observer.covariance.copy()
    with pytest.raises(InputError, match=message):
        observer.update(y, u, h)  # type: ignore[arg-type]
    np.testing.assert_array_equal(observer.mean, previous[0])
    np.testing.assert_array_equal(observer.covariance, previous[1])


def test_drift_of_a_swerve_base() -> None:
    """Its joints say nothing of it; poses do: a slope that is driven over with noise of 1 mm and 1 mrad."""
    model = robot("swerve-ur10")
    dynamics, joints = model.dynamics(), [n for n in model.state.names if not n.startswith("base.")]
    home, still, slope = model.home, np.zeros(model.input.size), np.array([0.03, -0.05, 0.02])
    with pytest.raises(InputError, match=r"'drift\..* leaves no trace by measuring leg"):
        OffsetObserver(dynamics, "drift", home, still, measured=joints, noise=1e-3)
    seen = ["base.x", "base.y", "base.yaw"]
    observer = OffsetObserver(dynamics, "drift", home, still, measured=seen, noise=1e-3, process=1e-4, walk=0.02)
    rng, pose = np.random.default_rng(2), home[:3].copy()
    for k in range(300):
        u = still.copy()
        u[:3] = 0.3, 0.1 * np.sin(0.05 * k), 0.2
        c, s = np.cos(pose[2] + 0.005 * (u[2] + slope[2])), np.sin(pose[2] + 0.005 * (u[2] + slope[2]))
        v = u[:3] + slope
        pose = pose + 0.01 * np.array([c * v[0] - s * v[1], s * v[0] + c * v[1], v[2]])
        observer.update(pose + 1e-3 * rng.normal(size=3), u, 0.01)
    np.testing.assert_allclose(observer.offset, slope, atol=0.01)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"noise": 0.0}, "noise: must be positive"),
        ({"noise": [1, 2]}, "noise: one number or 1"),
        ({"measured": ["x.z"]}, "x.z"),
    ],
)
def test_bad_settings(settings: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        OffsetObserver(mass_point(), "d", [0, 0], [0], **({"measured": ["x.place"], "noise": 1e-3} | settings))  # type: ignore[arg-type]


def spring() -> Ode:
    """1 kg on a spring of known stiffness, pushed by an unknown force."""
    f = lambda x, u, w, m: ca.vertcat(x[1], u[0] - w[0] * x[0] + w[1])
    return Ode({"x": ["place", "speed"]}, {"u": ["force"]}, f, parameters={"k": ["spring"], "d": ["force"]})


def pull_on_spring(observer: OffsetObserver, stiffness: float, seed: int) -> float:
    """Mean estimate over the last 2 of 4 s at a spring held away from rest by u = 9 and a force of 1.5, damped by u."""
    rng, x, found = np.random.default_rng(seed), np.array([1.0, 0.0]), []
    for _ in range(200):
        u = 9.0 - 4.0 * x[1]
        x = moved(lambda x, u: np.array([x[1], u - stiffness * x[0] + 1.5]), x, u)
        found.append(observer.update([x[0] + NOISE * rng.normal()], [u], H)[0])
    return float(np.mean(found[-100:]))


def test_known_parameters_are_part_of_the_model() -> None:
    """With the true stiffness the force is found; with another one, the spring's error passes for a force. They are kept."""
    system, how = spring(), {"measured": ["x.place"], "noise": NOISE, "process": 1e-2, "walk": 2.0}
    observer = OffsetObserver(system, "d", [1, 0], [0], known={"k": 8.0}, **how)  # type: ignore[arg-type]
    assert abs(pull_on_spring(observer, 8.0, 0) - 1.5) < 0.3
    np.testing.assert_array_equal(observer.parameters(), [8.0, observer.offset[0]])
    wrong = OffsetObserver(system, "d", [1, 0], [0], known={"k": 0.0}, **how)  # type: ignore[arg-type]
    assert pull_on_spring(wrong, 8.0, 0) < -5.0
    wrong.set_known({"k": [8.0]})  # and it recovers
    assert abs(pull_on_spring(wrong, 8.0, 1) - 1.5) < 0.3
    assert wrong.parameters()[0] == 8.0


@pytest.mark.parametrize(
    ("known", "message"),
    [
        (None, "'known' needs the values of the other parameters: 'k'"),
        ({"k": 8.0, "d": 0.0}, "'d' is estimated"),
        ({"k": np.nan}, "'k.spring' is not finite"),
        ({"k": [1.0, 2.0]}, "group 'k' has 1 entries"),
        ({"k": 8.0, "mass": 1.0}, "mass"),
    ],
)
def test_other_parameters_are_asked_for(known: dict[str, object] | None, message: str) -> None:
    with pytest.raises(InputError, match=message):
        OffsetObserver(spring(), "d", [0, 0], [0], measured=["x.place"], noise=NOISE, known=known)  # type: ignore[arg-type]


def test_numbers_that_are_not_finite_are_rejected() -> None:
    observer = OffsetObserver(lag(), "d", [0.0], [0.0], noise=1e-3)
    with pytest.raises(NotFinite, match="offset observer"):
        observer.update([np.nan], [0.0], H)

"""Progress along a path in an MPC. Truth: closed forms of a point mass, finite differences, MuJoCo-free distances."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest

import wbmpc as wb
from wbmpc import lie
from wbmpc.errors import InputError

FORCE, RATE = 1.0, 20.0


class Point:
    """A frame of a point in the plane, upright."""

    frames = ("point",)

    def frame_pose(self, x: ca.SX, frame: str) -> Any:
        return SimpleNamespace(position=ca.vertcat(x[0], x[1], 0), quaternion=ca.vertcat(1, 0, 0, 0))


def problem() -> wb.OptimalControlProblem:
    """A point mass of 1 kg whose force is bounded in every direction."""
    mass = wb.Ode({"p": ["x", "y"], "v": ["x", "y"]}, {"f": ["x", "y"]}, lambda x, u: ca.vertcat(x[2:], u))
    ocp = wb.OptimalControlProblem(wb.WithPath(mass), 2.0, 20)
    contour = wb.residuals.Contour(ocp.dynamics, Point(), "point")
    ocp.add(wb.Cost("contour", contour, {"contour": 1000.0, "lag": 1000.0}, at="path+terminal"))
    ocp.add(wb.Cost("effort", wb.residuals.Expression(2, lambda s: s.u), 1e-3))
    force = wb.residuals.Expression(1, lambda s: FORCE**2 - ca.dot(s.u, s.u))
    ocp.add(wb.Constraint("force", force, wb.sets.NonNegative(), hard=True))
    wb.add_progress(ocp, 20.0)
    return ocp


@pytest.fixture(scope="module")
def mpc() -> wb.MPC:
    return wb.MPC(problem(), rate=RATE, plan_only_limits=True)


def drive(mpc: wb.MPC, x: np.ndarray, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """States (n, 4) and progress (n) of a loop on the model itself, from rest at the path's start."""
    mpc.reset(x)
    states, progress = [x], [0.0]
    for k in range(steps):
        policy = mpc.update(wb.Observation(k / RATE, x))
        assert policy.x.shape[1] == 4 and policy.u.shape[1] == 2 and policy.gain.shape[1:] == (2, 4)
        x = mpc.simulate(x, policy(k / RATE), 1.0 / RATE)
        states.append(x)
        progress.append(mpc.path.progress((k + 1) / RATE))
    return np.array(states), np.array(progress)


def test_simulate_takes_whole_finite_states_alone(mpc: wb.MPC) -> None:
    x, u = np.zeros(4), np.zeros(2)
    for bad in ((0.0, u, 0.1), (x[1:], u, 0.1), (x, 0.0, 0.1), (x, u[1:], 0.1), (x * np.nan, u, 0.1), (x, u, None)):
        with pytest.raises(InputError, match="simulate"):
            mpc.simulate(*bad)
    with pytest.raises(InputError, match="simulate: 4 states and 2 inputs are needed"):
        mpc.simulate(np.zeros(6), u, 0.1)


def test_a_straight_line_takes_the_least_time(mpc: wb.MPC) -> None:
    """From rest to rest with speed V and force F: L / V + V m / F is the least time."""
    length, speed = 2.0, 0.8
    mpc.path.follow(wb.Path.line((0, 0, 0), (length, 0, 0)), speed, 5.0)
    states, progress = drive(mpc, np.zeros(4), 90)
    least = length / speed + speed / FORCE
    arrival = np.argmax(np.abs(states[:, 0] - length) < 0.01) / RATE
    assert least - 0.15 < arrival < 1.1 * least  # the last centimeter takes √(2 · 0.01 / F) = 0.14 s
    assert states[:, 0].max() < length + 1e-3 and states[:, 2].max() < 1.06 * speed
    assert progress[-1] == pytest.approx(length, abs=2e-3) and np.abs(states[:, 1]).max() < 1e-6
    # never faster than the force allows
    t = np.arange(len(states)) / RATE
    assert (states[:, 0] <= 0.5 * FORCE * t**2 + 1e-6).all()


def test_a_circle_is_driven_as_fast_as_the_force_allows(mpc: wb.MPC) -> None:
    """v² / R = F / m; another path needs no other solver."""
    radius = 0.5
    mpc.path.follow(wb.Path.circle((radius, 0, 0), (0, 0, 0)), 5.0, 5.0)
    states, progress = drive(mpc, np.array([radius, 0.0, 0.0, 0.0]), 120)
    speed = np.linalg.norm(states[60:, 2:], axis=1)
    assert speed == pytest.approx(np.full(61, np.sqrt(FORCE * radius)), rel=0.02)
    assert np.linalg.norm(states[:, :2], axis=1) == pytest.approx(np.full(121, radius), abs=0.03)
    assert progress[-1] > 2.0 * np.pi * radius  # it counts on in the second round


@pytest.mark.parametrize("axes", ["world", "reference"])
def test_errors_and_their_derivatives_are_those_of_the_path(axes: str) -> None:
    """Where it is expanded: the exact path's own error; differences of the exact error by s and by the state."""
    turns = [lie.quaternion_about((0.6, 0.0, 0.8), a) for a in (0.0, 0.7, 1.1, 2.0)]
    path = wb.Path([[0, 0, 0], [0.4, 0.1, 0], [0.7, 0.5, 0.2], [0.8, 0.9, 0.1]], turns)

    class Free:
        frames = ("tip",)

        def frame_pose(self, x: ca.SX, frame: str) -> Any:
            q = ca.vertcat(ca.sqrt(1.0 - ca.dot(x[3:6], x[3:6])), x[3:6])
            return SimpleNamespace(position=x[:3], quaternion=q)

    free = wb.Ode({"x": list("abcdef")}, {"u": list("abcdef")}, lambda x, u: u)
    residual = wb.residuals.Contour(wb.WithPath(free), Free(), "tip", axes)  # type: ignore[arg-type]
    x, r = ca.SX.sym("x", 8), ca.SX.sym("r", residual.reference)
    symbols = wb.residuals.Symbols(x[:6], ca.SX(6, 1), ca.SX(0, 1), ca.SX(0, 1), r, x, ca.SX(7, 1))
    value = residual(symbols)
    f = ca.Function("f", [x, r], [value, ca.jacobian(value, x)])

    def exact(at: np.ndarray) -> np.ndarray:
        pose, tangent = path.at([at[6]])[0], path.tangent([at[6]])[0]
        error = at[:3] - pose[:3]
        q = np.array([np.sqrt(1.0 - at[3:6] @ at[3:6]), *at[3:6]])
        pair = (q, lie.quaternion_conjugate(pose[3:]))
        turned = lie.quaternion_log(lie.quaternion_multiply(*(pair if axes == "world" else pair[::-1])))
        return np.concatenate([error - tangent * (tangent @ error), [tangent @ error], turned])

    rng = np.random.default_rng(1)
    for s in (0.2, 0.8):
        pose = path.at([s])[0]
        vector = pose[4:] * np.sign(pose[3]) + rng.normal(0.0, 1e-4, 3)
        at = np.concatenate([pose[:3] + rng.normal(0.0, 0.05, 3), vector, [s, 0.1]])
        got, jacobian = (np.array(v) for v in f(at, path.expansion([s])[0]))
        np.testing.assert_allclose(got.ravel(), exact(at), atol=1e-9)
        steps = 1e-6 * np.eye(8)
        differences = np.stack([(exact(at + h) - exact(at - h)) / 2e-6 for h in steps], axis=1)
        np.testing.assert_allclose(jacobian, differences, atol=2e-3)


def test_the_desired_speed_ends_with_the_path(mpc: wb.MPC) -> None:
    """v = √(2 a left) but for the very end; its slope by differences; no speed before a reference in time begins."""
    line = wb.Path.line((0, 0, 0), (2, 0, 0))
    speed = wb.Reference(np.array([0.0, 1.0]), np.array([[0.0], [0.9]]), "hold")
    mpc.path.follow(line, speed, 0.5)
    following = mpc.path.following
    assert following is not None
    s = np.array([0.0, 1.0, 1.7, 1.95, 1.99, 2.0])
    target = following.target(np.full(6, 1.5), s)
    assert target[:2, 1] == pytest.approx([0.9, 0.9]) and not target[:2, 2].any() and target[5, 1] == 0.0
    assert target[2, 1] == pytest.approx(np.sqrt(2.0 * 0.5 * 0.3), rel=0.06)
    step = 1e-6
    differences = (
        following.target(np.full(6, 1.5), s + step)[:, 1] - following.target(np.full(6, 1.5), s - step)[:, 1]
    ) / 2e-6
    np.testing.assert_allclose(target[2:5, 2], differences[2:5], rtol=1e-4)
    assert not following.target(np.zeros(6), s)[:, 1].any()


@pytest.mark.parametrize(("acceleration", "more"), [(0.5, 0.2), (2.5, 0.4)])
def test_the_end_of_a_path_costs_little_beside_a_stop(mpc: wb.MPC, acceleration: float, more: float) -> None:
    """From 1 m to 5 mm before the end: braking evenly takes √(2 · 1 / a) − √(2 · 0.005 / a)."""
    mpc.path.follow(wb.Path.line((0, 0, 0), (1, 0, 0)), 10.0, acceleration)
    following, s, t, step = mpc.path.following, 0.0, 0.0, 1e-3
    assert following is not None
    while s < 0.995:
        s += step * float(following.target(np.array([t]), np.array([s]))[0, 1])
        t += step
    least = np.sqrt(2.0 / acceleration) - np.sqrt(0.01 / acceleration)
    assert least < t < least + more


def test_desired_progress_is_limited_where_it_is_asked_to_be(mpc: wb.MPC) -> None:
    """Closed form: 0.5 m/s up to 1 m, then 0.2 m/s; the ramps of 5 m/s² take 0.05 s and 0.02 s longer."""
    mpc.path.follow(wb.Path.line((0, 0, 0), (9, 0, 0)), 1.0, 5.0)
    mpc.reset(np.zeros(4))
    most = np.array([0.0, 1.0, 1.0 + 1e-9, 9.0]), np.array([0.5, 0.5, 0.2, 0.2])
    found = mpc.path.desired(0.0, np.array([1.0, 2.0, 4.0]), most)
    assert found == pytest.approx([0.5, 1.0, 1.0 + 0.2 * 2.0], abs=0.04)
    assert mpc.path.desired(0.0, np.array([4.0]))[0] == pytest.approx(4.0 - 0.1, abs=0.04)


def test_progress_of_a_model_is_an_integrator_beside_it() -> None:
    """ẋ and its Jacobian by differences of the wrapped model."""
    inner = wb.Ode({"x": ["a", "b"]}, {"u": ["c"]}, lambda x, u: ca.vertcat(x[1] * u[0], ca.sin(x[0])))
    d = wb.WithPath(inner)
    assert d.state.names == ("x.a", "x.b", "path.position", "path.speed") and d.input.names == (
        "u.c",
        "path.acceleration",
    )
    x, u, none = ca.SX.sym("x", 4), ca.SX.sym("u", 2), ca.SX(0, 1)
    f = ca.Function("f", [x, u], [d(x, u, none, none), *d.jacobian(x, u, none, none)])
    at = np.array([0.3, -0.2, 5.0, 0.7, 0.4, -0.6])
    rate, again, jacobian = (np.array(v) for v in f(at[:4], at[4:]))
    np.testing.assert_allclose(rate.ravel(), [-0.2 * 0.4, np.sin(0.3), 0.7, -0.6])
    np.testing.assert_allclose(again, rate)
    value = lambda v: np.array(f(v[:4], v[4:])[0]).ravel()
    differences = [(value(at + h) - value(at - h)) / 2e-6 for h in 1e-6 * np.eye(6)]
    np.testing.assert_allclose(jacobian, np.array(differences).T, atol=1e-8)


def test_what_cannot_be_followed_is_named(mpc: wb.MPC) -> None:
    line = wb.Path.line((0, 0, 0), (1, 0, 0))
    with pytest.raises(InputError, match="contuor"):
        mpc.path.follow(line, 0.5, along={"contuor": lambda s: s})
    with pytest.raises(InputError, match="acceleration"):
        mpc.path.follow(line, 0.5, 0.0)
    with pytest.raises(InputError, match="one speed"):
        mpc.path.follow(line, wb.Reference.constant([1.0, 2.0]))
    with pytest.raises(InputError, match="virtual time"):
        wb.RealTimeRunner(None, None, mpc)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="no progress"):
        wb.residuals.Progress(wb.Ode({"x": ["a"]}, {"u": ["b"]}, lambda x, u: u))
    with pytest.raises(InputError, match="a group 'path' already"):
        wb.WithPath(mpc.ocp.dynamics)

"""Frequency-aware problems. Truth: scipy.signal's responses, a Riccati recursion on the exponential of the augmented matrices,
the unfiltered problem where pole and zero cancel."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
import scipy.linalg
import scipy.signal

from wbmpc.errors import InputError
from wbmpc.model.augment import DriveLag, FrequencyShaping, InputFilter
from wbmpc.model.ode import Ode
from wbmpc.model.robot import load_robot
from wbmpc.mpc.filters import FilterMemory
from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import (
    Constraint,
    Cost,
    OptimalControlProblem,
    Reference,
    Transcription,
    frequency_aware,
    residuals,
    sets,
)
from wbmpc.solver import SQP, Solver, Status
from wbmpc.types import Observation

FILTERS = [InputFilter(4.0, 30.0), InputFilter(9.0, 50.0, 2.0)]
A = np.array([[0.0, 1.0, 0.0], [-3.0, -0.2, 1.0], [0.5, 0.0, -1.0]])
B = np.array([[0.0, 0.1], [1.0, 0.0], [0.3, 2.0]])


def linear() -> Ode:
    """A linear system that is no robot: two inputs of one group."""
    return Ode({"x": ["a", "b", "c"]}, {"u": ["left", "right"]}, lambda x, u: ca.DM(A) @ x + ca.DM(B) @ u)


def pendulum() -> Ode:
    return Ode({"x": ["angle", "rate"]}, {"u": ["torque"]}, lambda x, u: ca.vertcat(x[1], u - 5.0 * ca.sin(x[0])))


def problem(dynamics, target, rest, maximum: float = np.inf, intervals: int = 40) -> OptimalControlProblem:
    """State and input against a target; the input within ``maximum``."""
    ocp = OptimalControlProblem(dynamics, 2.0, intervals, integrator="rk4")
    n, m = dynamics.state.size, dynamics.input.size
    ocp.add(Cost("state", residuals.Expression(n, lambda s: s.x - ca.DM(target)), 10.0, at="path+terminal"))
    ocp.add(Cost("effort", residuals.Expression(m, lambda s: s.u - ca.DM(rest)), 0.3))
    if np.isfinite(maximum):
        ocp.add(Constraint("limits", residuals.Expression(m, lambda s: s.u), sets.Box(-maximum, maximum), hard=True))
    return ocp


def matrices(dynamics: FrequencyShaping) -> tuple[np.ndarray, ...]:
    """A, B of the wrapped system and C, D of what acts, by differentiation."""
    x, u, none = ca.SX.sym("x", dynamics.state.size), ca.SX.sym("u", dynamics.input.size), ca.SX(0, 1)
    f, acting = dynamics(x, u, none, none), dynamics.view(x, u)[1]
    parts = [ca.jacobian(f, x), ca.jacobian(f, u), ca.jacobian(acting, x), ca.jacobian(acting, u)]
    return tuple(np.array(ca.DM(ca.evalf(ca.densify(p)))) for p in parts)


@pytest.mark.parametrize("k", [0, 1])
def test_every_input_has_its_own_response(k: int) -> None:
    """u over ν of the realization is the inverse of gain (s + zero) / (s + pole)."""
    a, b, c, d = matrices(FrequencyShaping(linear(), {"u": FILTERS}))
    f, omega = FILTERS[k], np.array([0.1, 3.0, 20.0, 300.0])
    states = slice(3, 5)
    system = (a[states, states], b[states, k : k + 1], c[k : k + 1, states], d[k : k + 1, k : k + 1])
    _, ours = scipy.signal.freqresp(system, omega)
    _, truth = scipy.signal.freqs([1.0, f.pole], [f.high, f.high * f.zero], omega)
    np.testing.assert_allclose(ours, truth, rtol=1e-10)


def test_loop_shaped_regulator() -> None:
    """The plan's gains and cost are those of the discrete Riccati recursion on the exponential of the augmented system."""
    target, rest = np.zeros(3), np.zeros(2)
    ocp = frequency_aware(problem(linear(), target, rest), {"u": FILTERS})
    x0 = np.array([1.0, -0.5, 0.2, 0.1, -0.3])
    solution = Solver(ocp, SQP()).solve(x0)
    zero, pole, high = (np.diag([getattr(f, n) for f in FILTERS]) for n in ("zero", "pole", "high"))
    c = np.linalg.inv(high) @ (pole - zero)
    a = np.block([[A, B @ c], [np.zeros((2, 3)), -zero]])
    b = np.vstack([B @ np.linalg.inv(high), np.eye(2)])
    h = 0.05
    whole = scipy.linalg.expm(h * np.block([[a, b], [np.zeros((2, 7))]]))
    f, g = whole[:5, :5], whole[:5, 5:]
    q, r = np.diag([10.0, 10.0, 10.0, 0.0, 0.0]), 0.3 * np.eye(2)
    value, gains = q.copy(), []
    for _ in range(40):
        gain = -np.linalg.solve(h * r + g.T @ value @ g, g.T @ value @ f)
        value = h * q + f.T @ value @ (f + g @ gain)
        gains.append(gain)
    np.testing.assert_allclose(solution.gain[0], gains[-1], rtol=2e-3, atol=2e-3)  # rk4 against the exponential
    assert solution.cost == pytest.approx(0.5 * x0 @ value @ x0, rel=1e-3)


def test_a_filter_that_cancels_changes_nothing() -> None:
    """Pole = zero: the same plan of a pendulum at its torque limit, over a swing."""
    plain = problem(pendulum(), [2.0, 0.0], [0.0], maximum=4.0)
    aware = frequency_aware(plain, {"u": InputFilter(7.0, 7.0)})
    previous = Solver(plain, SQP(iterations=200)).solve(np.zeros(2))
    after = Solver(aware, SQP(iterations=200)).solve(np.zeros(3))
    assert previous.status is after.status is Status.CONVERGED
    assert np.abs(previous.u).max() > 3.9  # the limit is felt
    np.testing.assert_allclose(after.u, previous.u, atol=1e-5)
    np.testing.assert_allclose(after.x[:, :2], previous.x, atol=1e-5)
    assert list(plain.dynamics.state.groups) == ["x"]  # the problem that was given is as it was


def test_no_transient_from_rest() -> None:
    """A pendulum held at an angle goes on being held; filters that start at zero make it move."""
    angle = 0.8
    torque = 5.0 * np.sin(angle)
    aware = frequency_aware(problem(pendulum(), [angle, 0.0], [torque]), {"u": InputFilter(3.0, 25.0)})
    x, u = aware.dynamics.equilibrium(np.array([angle, 0.0]), np.array([torque]))
    solver = Solver(aware, SQP(iterations=100))
    solver.warm_start(x, u)
    solution = solver.solve(x)
    np.testing.assert_allclose(solution.x[:, 0], angle, atol=1e-7)
    np.testing.assert_allclose(solution.u, u[0], atol=1e-6)
    cold = solver.solve(np.array([angle, 0.0, 0.0]))
    assert np.abs(cold.x[:, 0] - angle).max() > 1e-2


def test_memory_follows_the_filter() -> None:
    """States under inputs that are held, against scipy.signal.lsim; what comes out is what acted."""
    dynamics = FrequencyShaping(linear(), {"u": FILTERS})
    rng, h = np.random.default_rng(0), 0.01
    inputs = rng.normal(size=(60, 2))
    memory = FilterMemory(dynamics, inputs[0])
    start = memory.states.copy()
    for u in inputs:
        memory.advance(u, h)
    for k, f in enumerate(FILTERS):
        fine = np.repeat(inputs[:, k], 2)
        t = 0.5 * h * np.arange(fine.size + 1)
        system = ([[-f.pole]], [[f.high]], [[1.0]], [[0.0]])
        _, _, x = scipy.signal.lsim(system, np.append(fine, 0.0), t, X0=[start[k]], interp=False)
        assert memory.states[k] == pytest.approx(float(np.ravel(x)[-1]), rel=1e-9)
    np.testing.assert_allclose(
        FilterMemory(dynamics, [0.4, -2.0]).input(dynamics.equilibrium(np.zeros(3), np.array([0.4, -2.0]))[1]),
        [0.4, -2.0],
    )


def test_closed_loop_asks_for_less_that_is_fast() -> None:
    """A pendulum with noise on its measured rate: the share of the torque beyond 10 rad/s falls to less than a third."""

    def torques(aware: bool) -> np.ndarray:
        angle, h = 0.5, 0.01
        torque = np.array([5.0 * np.sin(angle)])
        plain = problem(pendulum(), [angle, 0.0], torque, maximum=6.0, intervals=20)
        ocp = frequency_aware(plain, {"u": InputFilter(5.0, 50.0)}) if aware else plain
        mpc, x, rng, seen = MPC(ocp, rate=100.0), np.array([angle, 0.0]), np.random.default_rng(1), []
        memory = FilterMemory(ocp.dynamics, torque) if aware else None
        mpc.reset(*(ocp.dynamics.equilibrium(x, torque) if aware else (x, torque)))
        for i in range(300):
            measured = x + [0.0, 0.05 * rng.normal()]
            wrapped = memory.state(measured) if memory else measured
            u = mpc.update(memory.observation(i * h, measured) if memory else Observation(i * h, wrapped))(
                i * h, wrapped
            )
            if memory:
                u = memory.input(u)
                memory.advance(u, h)
            for _ in range(10):
                x = x + 0.1 * h * np.array([x[1], u[0] - 5.0 * np.sin(x[0])])
            seen.append(u[0])
        assert abs(x[0] - angle) < 0.05
        return np.array(seen[100:])

    fast = scipy.signal.butter(2, 10.0 / (np.pi / 0.01), "high", output="sos")
    plain, aware = (np.std(scipy.signal.sosfilt(fast, torques(a) - 5.0 * np.sin(0.5))) for a in (False, True))
    assert aware < plain / 3.0


def test_problems_that_are_wrapped_already() -> None:
    """Through a lag: costs of the inner problem's own input see ν, its limits see what acts; jumps go through."""
    robot = load_robot("rezero")
    lagging = DriveLag(robot.dynamics(), {"wheel": 0.02})
    ocp = OptimalControlProblem(lagging, 1.0, 4)
    command = residuals.ProblemInput(lagging, ["wheel"])
    ocp.add(Cost("command", command, 1.0))
    ocp.add(Cost("rest", residuals.State(robot)))
    ocp.add(Constraint("limits", command, sets.Box(-4.0, 4.0)))
    aware = frequency_aware(ocp, {"wheel": InputFilter(5.0, 40.0)})
    solver = Solver(aware)
    solver.set_reference("rest", Reference.constant(robot.home))
    x, u = aware.dynamics.equilibrium(np.concatenate([robot.home, np.ones(3)]), np.full(robot.input.size, 2.0))
    t = Transcription(aware)
    evaluate = lambda name, z: ca.Function("r", [t.x, t.u], [t.residual(aware.term(name))])(x, z)
    np.testing.assert_allclose(evaluate("command", u + 1.0), 2.0 + 1.0)
    np.testing.assert_allclose(evaluate("limits", u + 1.0), 2.0 + 5.0 / 40.0)

    falling = pendulum()
    falling.jump = lambda x, w, m: -x
    jumped = FrequencyShaping(falling, {"u": InputFilter(1.0, 2.0)}).jump(ca.SX([1.0, 2.0, 3.0]), None, None)
    np.testing.assert_allclose(ca.DM(jumped), np.array([[-1.0], [-2.0], [3.0]]))


def test_bad_requests() -> None:
    ocp = problem(linear(), np.zeros(3), np.zeros(2))
    with pytest.raises(InputError, match="at least one is needed; valid: u"):
        frequency_aware(ocp, {})
    with pytest.raises(InputError, match="unknown input group 'v'"):
        frequency_aware(ocp, {"v": FILTERS[0]})
    with pytest.raises(InputError, match="one or 2 are needed, got 1"):
        frequency_aware(ocp, {"u": FILTERS[:1]})
    with pytest.raises(InputError, match="cost that depends on a filtered input 'state'"):
        frequency_aware(ocp, {"u": FILTERS}, ["state"])
    with pytest.raises(InputError, match="no filters"):
        FilterMemory(ocp.dynamics, np.zeros(2))

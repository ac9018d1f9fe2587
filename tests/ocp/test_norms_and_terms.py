"""Norms, barriers, sets, terms, schedules. Truth: their formulas written with NumPy, finite differences, messages."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from toys import Rows, ToyDynamics, pendulum, robot, swerve_solver
from wbmpc.bases.ball.residuals import CapturePoint
from wbmpc.errors import InputError
from wbmpc.model.robot import load_robot
from wbmpc.ocp import (
    AugmentedLagrangian,
    Constraint,
    Cost,
    Mode,
    ModeSchedule,
    OptimalControlProblem,
    Quadratic,
    Reference,
    RelaxedBarrier,
    SmoothL1,
    Transcription,
    residuals,
    sets,
)
from wbmpc.solver import SQP, Solver
from wbmpc.studies.minniti2019.door_residuals import PanelContact
from wbmpc.trajectory import geometric_grid

POINTS = np.array([-3.0, -0.5, -0.02, 0.0, 0.01, 0.05, 0.0999, 0.1001, 0.3, 2.0, 50.0])


def evaluate(function, points: np.ndarray = POINTS) -> np.ndarray:  # type: ignore[no-untyped-def]
    s = ca.SX.sym("s", points.size)
    return np.array(ca.Function("f", [s], [ca.densify(function(s))])(points)).ravel()


@pytest.mark.parametrize("norm", [Quadratic(), SmoothL1(0.3), RelaxedBarrier(0.2, 0.1)])
def test_gradient_is_the_derivative_of_the_value(norm) -> None:  # type: ignore[no-untyped-def]
    h = 1e-6
    want = (evaluate(norm.value, POINTS + h) - evaluate(norm.value, POINTS - h)) / (2 * h)
    np.testing.assert_allclose(evaluate(norm.gradient), want, rtol=1e-6, atol=1e-7)
    symbol = ca.SX.sym("r")
    casadi = ca.Function("g", [symbol], [ca.gradient(norm.value(symbol), symbol)])
    np.testing.assert_allclose(evaluate(norm.gradient), [float(casadi(v)) for v in POINTS], rtol=1e-10, atol=1e-12)
    assert np.all(evaluate(norm.curvature) > 0.0)


def test_barrier_formula_and_curvature() -> None:
    """Feller and Ebenbauer's quadratic relaxation; beyond it, curvature is the second derivative."""
    mu, delta = 0.2, 0.1
    b = RelaxedBarrier(mu, delta)
    near = 0.5 * (((POINTS - 2 * delta) / delta) ** 2 - 1) - np.log(delta)
    want = mu * np.where(delta < POINTS, -np.log(np.maximum(POINTS, delta)), near)
    np.testing.assert_allclose(evaluate(b.value), want, rtol=1e-12)
    h = 1e-5
    second = (evaluate(b.gradient, POINTS + h) - evaluate(b.gradient, POINTS - h)) / (2 * h)
    np.testing.assert_allclose(evaluate(b.curvature), second, rtol=1e-4)
    # twice continuously differentiable at δ
    for f in (b.value, b.gradient, b.curvature):
        low, high = evaluate(f, np.array([delta - 1e-9, delta + 1e-9]))
        assert low == pytest.approx(high, rel=1e-6)


def test_smooth_l1_is_quadratic_near_and_linear_far() -> None:
    assert evaluate(SmoothL1(2.0).value, np.array([1e-3]))[0] == pytest.approx(0.5e-6, rel=1e-5)
    assert evaluate(SmoothL1(2.0).gradient, np.array([1e6]))[0] == pytest.approx(2.0, rel=1e-6)
    r = POINTS[POINTS != 0.0]
    np.testing.assert_allclose(
        evaluate(SmoothL1(2.0).curvature, r), evaluate(SmoothL1(2.0).gradient, r) / r, rtol=1e-12
    )


@pytest.mark.parametrize(
    "make",
    [
        lambda: SmoothL1(0.0),
        lambda: SmoothL1(np.inf),
        lambda: RelaxedBarrier(0.0, 1.0),
        lambda: RelaxedBarrier(1.0, -1.0),
        lambda: RelaxedBarrier(1.0, np.inf),
        lambda: AugmentedLagrangian(np.inf),
    ],
)
def test_bad_norms(make) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(InputError, match=r"positive|finite"):
        make()


ROW = Rows(2, lambda s: s.u[0:2])


def problem(*terms, **more) -> OptimalControlProblem:  # type: ignore[no-untyped-def]
    ocp = OptimalControlProblem(ToyDynamics(2, 2, lambda x, u, w, m: u), 1.0, 2, **more)
    for term in terms:
        ocp.add(term)
    return ocp


def test_boxes_become_rows_and_others_stay_symbolic() -> None:
    box = sets.Box([-1.0, -np.inf], [2.0, 3.0])
    t = Transcription(
        problem(Constraint("a", ROW, box), Constraint("b", Rows(1, lambda s: s.u[0] * s.u[1]), sets.NonNegative()))
    )
    assert [(i, s, c) for i, s, c, *_ in t.path.barriers] == [(2, 1.0, 1.0), (2, -1.0, 2.0), (3, -1.0, 3.0)]
    assert [c.name for c, _ in t.path.general_barriers] == ["b"]
    assert t.end.barriers == []
    assert float(t.values["cost"]([0, 0], [2, 3], [], [])) == pytest.approx(-1e-2 * np.log(6.0))


@pytest.mark.parametrize(
    ("box", "message"),
    [
        (sets.Box([0.0, 0.0, 0.0], 1.0), "one number or 2"),
        (sets.Box(np.nan, 1.0), "NaN"),
    ],
)
def test_bad_boxes(box: sets.Box, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Transcription(problem(Constraint("a", ROW, box)))


def test_bad_constraints() -> None:
    for more, message in (
        ({"hard": True, "penalty": AugmentedLagrangian()}, "exclude each other"),
        ({"softness": -1.0}, "softness"),
        ({"slack": 0.0}, "slack must be positive"),
    ):
        with pytest.raises(InputError, match=message):
            Constraint("a", ROW, sets.Box(0, 1), **more)
    with pytest.raises(InputError, match="no input to depend on"):
        Transcription(problem(Constraint("a", ROW, at="terminal")))
    with pytest.raises(InputError, match="no input to depend on"):
        Transcription(problem(Constraint("a", ROW, sets.Box(0, 1), at="terminal", hard=True)))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Cost("a", ROW, [1.0, 2.0, 3.0]), r"cost 'a', weight: one number or 2 are needed, got 3"),
        (lambda: Cost("a", ROW, -1.0), "not negative"),
        (lambda: Cost("a", ROW, np.nan), "finite"),
        (lambda: Cost("a", ROW, {"al": 1.0}), r"did you mean 'all'\?"),
        (lambda: Cost("a", ROW, at="pth"), r"did you mean 'path'\?"),
        (lambda: Cost("a", ROW, terminal_weight=[1.0]), "one number or 2"),
        (lambda: residuals.State(robot("rezero"), ["arn"]), r"did you mean 'arm'\?"),
        (lambda: residuals.FramePose(robot("rezero"), "tol"), r"did you mean 'tool'\?"),
        (
            lambda: residuals.FramePose(robot("rezero"), "tool", "quaternion"),
            "unknown orientation .* valid: log, vector",
        ),
        (
            lambda: residuals.FramePose(robot("rezero"), "tool", axes="wrld"),
            r"axes.* 'world'\?\); valid: world, reference",
        ),
        (lambda: residuals.Limits(robot("rezero"), "inputs"), r"did you mean 'input'\?\); valid: state, input, both"),
        (lambda: CapturePoint(robot("rezero"), 0.0), "capture point: 'pole' must be positive"),
        (lambda: CapturePoint(robot("rezero"), 4.7, answer=np.nan), "capture point: 'answer' must be finite"),
        (lambda: CapturePoint(robot("rezero"), 4.7, directions=0), "directions: a whole number from 1 on is needed"),
        (lambda: PanelContact(None, -1.0), "panel contact: 'rate' must not be negative"),
        (
            lambda: residuals.FrictionCone(load_robot("rezero", contact="force"), np.nan),
            "'min_push' must be finite",
        ),
        (lambda: residuals.FrameTwist(robot("rezero"), "tol"), r"did you mean 'tool'\?"),
        (lambda: residuals.FrameWrench(robot("rezero"), "tool"), "loaded with contact='force' or contact='wrench'"),
        (lambda: residuals.FrameWrench(robot("swerve-ur10"), "tool0"), "inputs are speeds it has no effect"),
        (lambda: residuals.FrameWrench(load_robot("rezero", contact="force"), "tol"), r"did you mean 'tool'\?"),
        (lambda: Cost("a", ROW, {"all": [1.0]}), r"weight of 'all': one number or 2 are needed, got 1"),
        (lambda: Cost("a", ROW, {"all": [1.0, np.inf]}), r"weight of 'all': must be finite and not negative, got inf$"),
        (lambda: Cost("a", ROW, "abc"), r"weight: numbers are needed, got 'abc'"),
        (lambda: Cost("a", ROW, [[1.0, 2.0]]), "one number or 2"),
        (lambda: Cost("a", ROW, terminal_weight=-1.0), "terminal weight: must be finite and not negative, got -1$"),
        (lambda: Cost("a", ROW, modes="open"), "modes must be a tuple of names"),
        (lambda: Cost("a", ROW, modes=()), "at least one"),
        (lambda: Constraint("a", ROW, softness=np.nan), "softness"),
        (lambda: problem(Cost("a", ROW), Cost("a", ROW)), "already there"),
        (lambda: problem(Cost("hand", ROW)).term("hnd"), r"did you mean 'hand'\?"),
        (lambda: Transcription(problem(Cost("a", Rows(3, lambda s: s.u)))).values, "its size says 3"),
        (lambda: SQP(iterations=0), "at least 1"),
        (lambda: SQP(backend="compile"), r"did you mean 'compiled'\?"),
    ],
)
def test_clear_errors(make, message: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(InputError, match=message):
        make()


@pytest.mark.parametrize(
    "arguments",
    [
        {"horizon": 1.0, "intervals": 0}, {"horizon": -1.0, "intervals": 5}, {"horizon": np.nan, "intervals": 5},
        {"horizon": 1.0, "intervals": 5, "first_interval": 0.5}, {"horizon": 1.0, "intervals": 5, "first_interval": -0.1},
        {"horizon": 1.0, "intervals": 2, "grid": [0.0, 0.5, 0.5]}, {"horizon": 1.0, "intervals": 2, "grid": [0.1, 0.5]},
        {"horizon": 1.0, "intervals": 2, "integrator": "rk3"}, {"horizon": 1.0, "intervals": 2.5},
        {"horizon": 1.0, "intervals": True}, {"horizon": "1", "intervals": 2},
        {"horizon": 1.0, "intervals": 2, "grid": [0, np.nan, 1]}, {"horizon": 1.0, "intervals": 2, "grid": [0, 1, np.inf]},
        {"horizon": 1e13, "intervals": 50, "first_interval": 0.017},
        {"horizon": 10.0, "intervals": 50, "first_interval": 1e-30},
    ],
)  # fmt: skip
def test_bad_grids(arguments: dict) -> None:
    with pytest.raises(InputError):
        OptimalControlProblem(ToyDynamics(2, 2, lambda x, u, w, m: u), **arguments)


def test_geometric_grid() -> None:
    grid = OptimalControlProblem(ToyDynamics(1, 1, lambda x, u, w, m: u), 10.0, 50, first_interval=0.017).grid
    steps = np.diff(grid)
    assert (grid[0], len(grid)) == (0.0, 51)
    assert grid[-1] == pytest.approx(10.0, rel=1e-12)
    assert steps[0] == pytest.approx(0.017, rel=1e-9)
    np.testing.assert_allclose(steps[1:] / steps[:-1], steps[1] / steps[0], rtol=1e-9)


@pytest.mark.parametrize(("horizon", "intervals", "first"), [(10.0, 50, 2e-5), (1e5, 3, 0.2), (1.0, 1000, 1e-6)])
def test_geometric_grid_at_its_limits(horizon: float, intervals: int, first: float) -> None:
    steps = np.diff(geometric_grid(horizon, intervals, first))
    assert steps.sum() == pytest.approx(horizon, rel=1e-12)
    assert steps[0] == pytest.approx(first, rel=1e-9)
    np.testing.assert_allclose(steps[1:] / steps[:-1], steps[1] / steps[0], rtol=1e-6)


def test_modes_are_checked() -> None:
    for values in ([7.0, np.nan], ["x"], np.inf):
        with pytest.raises(InputError, match=r"mode 'x'.*'brake'.* (numbers are needed|must be finite numbers)"):
            Mode("x", {"brake": values})


def test_terms_and_schedules_agree_on_the_modes() -> None:
    """Checked when a schedule is set, and before the first solve without one: every name, for one that is never there is silent."""
    closed, opened = Mode("closed"), Mode("open")
    for modes in (("opn",), ("closed", "opn")):
        solver = Solver(problem(Cost("a", ROW), Cost("b", ROW, modes=modes)), SQP(backend="interpreted"))
        with pytest.raises(
            InputError, match=r"term 'b', modes: unknown mode 'opn' \(did you mean 'open'\?\); valid: closed, open"
        ):
            solver.set_schedule(ModeSchedule((closed, opened, closed), (1.0, 2.0)))
        with pytest.raises(
            InputError, match=r"term 'b', modes \(no mode schedule is set\): unknown mode .*; valid: default"
        ):
            solver.solve(np.zeros(2))
    Solver(problem(Cost("b", ROW, modes=("open", "closed"))), SQP(backend="interpreted")).set_schedule(
        ModeSchedule((closed, opened), (1.0,))
    )


def test_declared_modes_may_come_later() -> None:
    """A problem that says which modes there are takes any schedule of them, one after the other."""
    closed, opened, half = Mode("closed"), Mode("open"), Mode("half")
    ocp = problem(Cost("b", ROW, modes=("half", "open")), modes=("closed", "half", "open"))
    solver = Solver(ocp, SQP(backend="interpreted"))
    solver.solve(np.zeros(2))  # in none of them
    for schedule in (ModeSchedule((closed,)), ModeSchedule((closed, half), (1.0,)), ModeSchedule((opened,))):
        solver.set_schedule(schedule)
        assert solver.schedule is schedule
    with pytest.raises(
        InputError, match=r"mode schedule: unknown mode 'opn' \(did you mean 'open'\?\); valid: closed, half, open"
    ):
        solver.set_schedule(ModeSchedule((Mode("opn"),)))
    ocp.add(Cost("c", ROW, modes=("hafl",)))
    with pytest.raises(
        InputError, match=r"term 'c', modes: unknown mode 'hafl' \(did you mean 'half'\?\); valid: closed, half"
    ):
        Solver(ocp, SQP(backend="interpreted")).set_schedule(ModeSchedule((half,)))
    with pytest.raises(InputError, match="modes: a sequence of names is needed, got 'open'"):
        problem(modes="open")


def test_brakes_are_open_or_closed() -> None:
    solver = swerve_solver(n=2, backend="interpreted")
    solver.set_schedule(ModeSchedule((Mode("open", {"brake": [1, 0, 1, 0]}),)))
    with pytest.raises(InputError, match="mode 'x': values of 'brake' must be from 0 to 1, got"):
        solver.set_schedule(ModeSchedule((Mode("x", {"brake": [7, 0, 0, 0]}),)))


def test_mode_schedule() -> None:
    a, b = Mode("a"), Mode("b")
    schedule = ModeSchedule((a, b, a), (1.0, 2.0))
    assert [schedule.index(t) for t in (0.0, 0.999, 1.0, 1.5, 2.0, 9.0)] == [0, 0, 1, 1, 2, 2]
    with pytest.raises(InputError, match="2 events need 3 modes, got 2"):
        ModeSchedule((a, b), (1.0, 2.0))
    for events in ((2.0, 1.0), (1.0, 1.0), (np.nan, 1.0)):
        with pytest.raises(InputError, match="finite and increasing"):
            ModeSchedule((a, b, a), events)


def test_references_are_checked() -> None:
    for make, message in (
        (lambda: Reference([0.0, 1.0], [[1.0]]), "2 times need 2 rows"),
        (lambda: Reference([1.0, 0.0], [[1.0], [2.0]]), "not decrease"),
        (lambda: Reference([0.0], [[np.inf]]), "finite"),
        (lambda: Reference([0.0], [[1.0]], "spline"), "unknown kind"),
        (lambda: Reference([0.0], [[1.0]], "pose"), "7 numbers"),
        (lambda: Reference.poses([0.0], [[0, 0, 0]], [0, 0, 0, 0]), "quaternion has length 0, 1 is needed"),
    ):
        with pytest.raises(InputError, match=message):
            make()


def test_solver_input_is_checked() -> None:
    s = pendulum("interpreted")
    for call, message in (
        (lambda: s.set_reference("stte", Reference.constant([0.0] * 4)), r"did you mean 'state'\?"),
        (lambda: s.set_reference("state", Reference.constant([0.0] * 3)), "4 numbers per sample"),
        (lambda: s.set_weight("inpt", 1.0), r"did you mean 'path.input'\?"),
        (lambda: s.set_weight("state", [1.0, 2.0]), "one number or 4 are needed, got 2"),
        (lambda: s.set_weight("state", np.nan), "finite"),
        (lambda: s.set_weight("state", {"al": 1.0}), r"did you mean 'all'\?"),
        (lambda: s.set_parameters(np.zeros(2)), "1 finite numbers"),
        (lambda: s.set_parameters({"v": np.zeros(1)}), "unknown group 'v'"),
        (lambda: s.set_schedule(ModeSchedule((Mode("a", {"n": [1.0]}),))), "unknown group 'n'"),
        (lambda: s.solve(np.array([0.0, np.nan, 0.0, 0.0])), "'x.1' is not finite"),
        (lambda: s.solve(np.zeros(3)), "4 numbers are needed"),
        (lambda: s.warm_start(np.zeros(3)), "warm start, x"),
        (lambda: s.warm_start(np.zeros(4), np.zeros(5)), "warm start, u"),
    ):
        with pytest.raises(InputError, match=message):
            call()
    s.set_weight("state", {"all": [1.0, 2.0, 3.0, 4.0]}, "terminal")
    np.testing.assert_array_equal(s.constants[s.problem.constant.slices["terminal.state"]], [1, 2, 3, 4])


def test_a_weight_changed_is_a_weight_given() -> None:
    lower, changed = pendulum("interpreted"), pendulum("interpreted")
    x0 = np.array([0.1, 0.3, 0.0, 0.0])
    assert isinstance(changed, Solver)
    previous = lower.solve(x0)
    changed.set_weight("input", 5.0)
    after = changed.solve(x0)
    assert np.abs(after.u).sum() < 0.8 * np.abs(previous.u).sum()


def test_a_cost_of_the_input_at_the_end_is_rejected() -> None:
    dynamics = ToyDynamics(2, 1, lambda x, u, w, m: ca.vertcat(x[1], u[0]))
    ocp = OptimalControlProblem(dynamics, 1.0, 5)
    ocp.add(Cost("effort", Rows(1, lambda s: s.u), 1.0, at="terminal"))
    with pytest.raises(InputError, match="cost 'effort', at: its residual depends on the input"):
        Solver(ocp, SQP(backend="interpreted"))


def test_boxes_and_schedules_that_mean_nothing() -> None:
    with pytest.raises(InputError, match="above the upper one in row 1"):
        sets.Box([0.0, 2.0], [1.0, 1.0])
    with pytest.raises(InputError, match="modes must be Mode objects"):
        ModeSchedule(["closed", "open"], [1.0])  # type: ignore[arg-type]


def test_a_term_is_expressed_once_for_all_that_asks_for_it() -> None:
    """Values at the path and at the end, derivatives, rows: of one expression. Another term of that name has its own."""
    asked: list[str] = []

    def residual(s: residuals.Symbols) -> ca.SX:
        asked.append("residual")
        return s.x

    ocp = OptimalControlProblem(ToyDynamics(2, 1, lambda x, u, w, m: ca.vertcat(x[1], u)), 1.0, 4)
    ocp.add(Cost("state", Rows(2, residual), 1.0, at="path+terminal"))
    t = Transcription(ocp)
    assert len(t.values) + len(t.derivatives) > 10 and asked == ["residual"]
    other = Cost("state", Rows(2, lambda s: 2.0 * s.x), 1.0)
    assert ca.is_equal(t.residual(other), 2.0 * t.x, 1) and ca.is_equal(t.residual(ocp.term("state")), t.x, 1)

"""Arguments of the Python interface that are no real numbers: an :class:`InputError` that names them, whatever NumPy would make of
them. Truth: NumPy's kinds of arrays; lengths and times that have no meaning for floats of 53 bits."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import wbmpc as wb
from wbmpc.errors import InputError
from wbmpc.robots import load_description
from wbmpc.stability.configurations import configuration_positions

TWO: list[Any] = [
    np.array([1.0 + 1j, 0.0]), [1j, 0.0], np.ma.masked_array([1.0, 0.0], mask=[True, False]), np.array([1.0, 2.0], object),
    np.array(["1", "2"]), ["a", "b"], "12", [[1.0], [1.0, 2.0]], None, [None, 1.0], {"a": 1}, [10**400, 0],
]  # fmt: skip
ONE: list[Any] = [
    "1",
    None,
    1j,
    [1.0],
    np.array([1.0]),
    np.array([1.0, 2.0]),
    True,
    b"1",
    {},
    float("nan"),
    np.inf,
    10**400,
]
TIMES = [*ONE, 1e300, -1e300]


class Given:
    """A cart on a line that follows a reference."""

    def __init__(self) -> None:
        self.dynamics = wb.Ode({"x": ["p", "v"]}, {"u": ["f"]}, lambda x, u: ca.vertcat(x[1], u[0]))
        self.ocp = self.problem()
        self.solver = wb.Solver(self.ocp, wb.SQP(backend="interpreted"))
        self.mpc = wb.MPC(self.ocp, wb.SQP.real_time(backend="interpreted"), rate=10.0)
        self.mpc.reference["speed"] = wb.Reference.constant([0.0])
        self.policy = self.mpc.update(wb.Observation(0.0, np.zeros(2)))

    def problem(self, **given: Any) -> wb.OptimalControlProblem:
        ocp = wb.OptimalControlProblem(self.dynamics, **{"horizon": 1.0, "intervals": 4, **given})
        ocp.add(wb.Cost("speed", wb.residuals.Input(self.dynamics), 1.0))
        return ocp


@pytest.fixture(scope="module")
def given() -> Given:
    return Given()


VECTORS: dict[str, Callable[[Given, Any], object]] = {
    "solve": lambda g, v: g.solver.solve(v),
    "warm start": lambda g, v: g.solver.warm_start(v),
    "observation": lambda g, v: g.mpc.update(wb.Observation(1.0, v)),
    "simulate": lambda g, v: g.solver.simulate(v, np.zeros(1), 0.1),
    "reset": lambda g, v: g.mpc.reset(v),
    "policy": lambda g, v: g.policy(0.1, [] if v is None else v),
    "times": lambda g, v: wb.Reference(v, np.zeros((2, 1))),
    "values": lambda g, v: wb.Reference(np.arange(2.0), v),
    "positions": lambda g, v: wb.Reference.poses(0.0, v, [1.0, 0.0, 0.0, 0.0]),
    "quaternions": lambda g, v: wb.Reference.poses(0.0, np.zeros(3), v),
    "weights": lambda g, v: wb.Cost("c", wb.residuals.State(g.dynamics), v),
    "box": lambda g, v: wb.sets.Box(v, 5.0),
    "grid": lambda g, v: g.problem(grid=[] if v is None else v),
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", VECTORS)
def test_vectors_are_of_real_numbers(name: str, given: Given) -> None:
    for value in TWO:
        with pytest.raises(InputError):
            VECTORS[name](given, value)


NUMBERS: dict[str, tuple[Callable[[Given, Any], object], list[Any]]] = {
    "start of the horizon": (lambda g, v: g.solver.solve(np.zeros(2), v), TIMES),
    "observation": (lambda g, v: g.mpc.update(wb.Observation(v, np.zeros(2))), TIMES),
    "policy": (lambda g, v: g.policy(v), ["1", None, 1j, [1.0, 2.0], b"1", {}, float("nan"), np.inf]),
    "rate": (lambda g, v: wb.MPC(g.ocp, rate=v), [*ONE, 0.0, -1.0]),
    "horizon": (lambda g, v: g.problem(horizon=v), [*ONE, 0.0, -1.0, 1e300]),
    "intervals": (lambda g, v: g.problem(intervals=v), [*ONE, 0, -1, 2.5, 10**8]),
    "first_interval": (lambda g, v: g.problem(first_interval=v), [v for v in ONE if v is not None] + [1e300, 0.0]),
    "reference": (lambda g, v: g.solver.set_reference("speed", v), [3.0, None, np.zeros(1), "a", {}]),
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", NUMBERS)
def test_numbers_are_real_finite_and_of_this_world(name: str, given: Given) -> None:
    act, values = NUMBERS[name]
    for value in values:
        with pytest.raises(InputError, match=name):
            act(given, value)


def test_what_numpy_has_for_a_number_is_one(given: Given) -> None:
    for one in (1, np.float32(1.0), np.int64(1), np.array(1.0)):
        given.solver.solve(np.array([1, 0]), one)
    for two in (
        [1, 0],
        np.ma.masked_array([1.0, 0.0]),
        np.array([1.0, 0.0], ">f8"),
        np.array([True, False]),
        (1.0, np.float16(2)),
    ):
        given.solver.solve(two, 0.0)


@pytest.mark.parametrize(("quaternion", "good"), [
    ([2.0, 0, 0, 0], False), ([0.0, 0, 0, 0], False), ([0.98, 0, 0, 0], False), ([0.707, 0.707, 0, 0], True), ([0.71, 0, 0, 0.71], True),
])  # fmt: skip
def test_quaternions_of_references_are_of_unit_length_but_for_rounding(quaternion: list[float], good: bool) -> None:
    if not good:
        with pytest.raises(InputError, match=r"reference: the quaternion has length [\d.]+, 1 is needed"):
            wb.Reference.poses([0.0, 1.0], np.zeros((2, 3)), quaternion)
        return
    values = wb.Reference.poses([0.0, 1.0], np.zeros((2, 3)), quaternion).values
    assert np.allclose(np.linalg.norm(values[:, 3:], axis=1), 1.0, atol=1e-15)


def test_times_of_references_are_of_this_world() -> None:
    with pytest.raises(InputError, match=r"reference: times must be at most 1e\+10 s"):
        wb.Reference([0.0, 1e300], np.zeros((2, 1)))


@pytest.mark.parametrize("text", ["\u0661,\u0661,\u0661,\u0661", "1_0,0,0,0", "\uff11 0 0 0", "0x1 0 0 0"])
def test_angles_of_legs_in_a_text_are_numbers_of_ascii(text: str) -> None:
    with pytest.raises(InputError, match="configuration"):
        configuration_positions(wb.load_robot(load_description("swerve-ur10").source), text)


# ---------------------------------------------------------------------- closed loops
@pytest.fixture(scope="module")
def arm() -> tuple[wb.RobotModel, wb.MPC]:
    """A robot with an MPC that does nothing."""
    robot = wb.load_robot("differential-ur10")
    ocp = wb.OptimalControlProblem(robot.dynamics(), horizon=1.0, intervals=4)
    ocp.add(wb.Cost("effort", wb.residuals.Input(robot), 1.0))
    return robot, wb.MPC(ocp, wb.SQP.real_time(backend="interpreted"), rate=50.0)


BAD_TIMES = [*TIMES, 1e9, -1.0]
BAD_ARGUMENTS = [
    *(("duration", v) for v in [*BAD_TIMES, 0, 0.0]),
    *(("since", v) for v in BAD_TIMES),
    *(("seed", v) for v in (-1, 1.0, "1", None, True, [], float("nan"), np.array([1]))),
    *(("name", v) for v in (3, None, "\x1b[2J", "a\nb", "\ud800")),
    *(("out", v) for v in (3, [], "\0", "\ud800", "x" * 5000)),
    *((k, v) for k in ("robot", "mpc") for v in (None, 3, "differential-ur10")),
    ("computation_delay", float("nan")), ("settle_time", -1), ("plant", "magic"), ("plant", 3),
]  # fmt: skip


@pytest.mark.parametrize(("name", "value"), BAD_ARGUMENTS, ids=range(len(BAD_ARGUMENTS)))
def test_arguments_of_a_simulation_are_checked_before_anything_is_made(
    name: str, value: Any, arm: tuple[wb.RobotModel, wb.MPC], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    arguments = {"robot": arm[0], "mpc": arm[1], "duration": 0.1, "out": tmp_path / "run", name: value}
    with pytest.raises(InputError, match=name):
        wb.simulate(**arguments)
    assert not list(tmp_path.iterdir())


def test_a_simulation_needs_the_mpc_of_its_robot(arm: tuple[wb.RobotModel, wb.MPC]) -> None:
    """States have the same names; a base that rolls sideways has an input more."""
    with pytest.raises(InputError, match=r"plant: MuJoCo needs an MPC on the robot's own dynamics"):
        wb.simulate(wb.load_robot("mecanum-ur10"), arm[1], 0.1)
    with pytest.raises(InputError, match="closed loop: 'settings': SimulationSettings is needed"):
        wb.closed_loop(*arm, 0.1, settings=3)  # type: ignore[arg-type]


def test_whole_numbers_of_thousands_of_digits_are_an_error() -> None:
    """Python itself raises an error for their text."""
    huge = 10**5000
    for make in (
        lambda: wb.shapes.Sphere(huge),
        lambda: wb.shapes.Sphere(1.0, [0, 0, huge]),
        lambda: wb.shapes.ConvexMesh([[0, 0, huge]] * 4),
        lambda: wb.shapes.DistanceGrid([0, 0, 0], 0.1, [[[huge]]]),
        lambda: wb.Obstacles().set("a", wb.shapes.Sphere(1.0), seen=0.0, expire=huge),
    ):
        with pytest.raises(InputError):
            make()


@pytest.mark.parametrize("radius", ["1", True, None, b"1", 1j, [1.0]])
def test_lengths_of_shapes_are_numbers(radius: Any) -> None:
    with pytest.raises(InputError, match="sphere: 'radius' needs one finite number"):
        wb.shapes.Sphere(radius)
    with pytest.raises(InputError, match="sphere: 'center' needs 3 finite numbers"):
        wb.shapes.Sphere(1.0, ["1", 0, 0])  # type: ignore[list-item]


# ---------------------------------------------------------------------- what problems are made of
def _constraint(given: Given, **wrong: Any) -> wb.Constraint:
    return wb.Constraint("limit", **{"residual": wb.residuals.Input(given.dynamics), **wrong})


WRONG_PARTS: dict[str, tuple[Callable[[Given], object], str]] = {
    "set": (lambda g: _constraint(g, set=(-1.0, 1.0)), r"constraint 'limit', set: got '\(-1.0, 1.0\)'; valid: .*wb.sets.Box"),
    "class of a set": (lambda g: _constraint(g, set=wb.sets.NonNegative), "constraint 'limit', set: .*valid: "),
    "penalty": (lambda g: _constraint(g, penalty=1e3), "constraint 'limit', penalty: got '1000.0'; valid: wb.RelaxedBarrier"),
    "residual": (lambda g: _constraint(g, residual=lambda s: s.u), "term 'limit', residual: .*valid: one of wb.residuals"),
    "class of a residual": (lambda g: wb.Cost("c", wb.residuals.Input), "term 'c', residual: .*valid: one of wb.residuals"),
    "norm": (lambda g: wb.Cost("c", wb.residuals.Input(g.dynamics), norm="l1"), "cost 'c', norm: got 'l1'; valid: wb.SmoothL1"),
    "term": (lambda g: g.problem().add("speed"), "term: a wb.Cost or a wb.Constraint is needed, got 'speed'"),
    "dynamics": (lambda g: wb.OptimalControlProblem("cart", 1.0, 4), r"dynamics: a system is needed, .*wb.Ode\(…\), got 'cart'"),
    "settings of an MPC": (lambda g: wb.MPC(g.ocp, solver="sqp"), r"mpc, solver: settings are needed, got 'sqp'; valid: wb.SQP\(…\)"),
    "settings of a solver": (lambda g: wb.Solver(g.ocp, "sqp"), r"solver: settings are needed, got 'sqp'; valid: wb.SQP\(…\)"),
    "problem of a solver": (lambda g: wb.Solver(g.dynamics), "solver: an OptimalControlProblem is needed"),
    "problem of an MPC": (lambda g: wb.MPC(None), "mpc: an OptimalControlProblem is needed, got 'None'"),
}  # fmt: skip


@pytest.mark.parametrize("part", WRONG_PARTS)
def test_parts_of_a_problem_are_of_the_kind_that_is_needed(part: str, given: Given) -> None:
    make, message = WRONG_PARTS[part]
    with pytest.raises(InputError, match=message):
        make(given)


def test_a_reference_of_a_term_that_compares_with_none_says_how_it_would(given: Given) -> None:
    ocp = wb.OptimalControlProblem(given.dynamics, 1.0, 4)
    ocp.add(wb.Cost("own", wb.residuals.Expression(1, lambda s: s.u), 1.0))
    with pytest.raises(
        InputError, match=r"reference 'own': its term compares with none; valid: none, or .*reference=…"
    ):
        wb.Solver(ocp, wb.SQP(backend="interpreted")).set_reference("own", wb.Reference.constant([0.0]))


def test_an_unknown_public_name_has_a_hint() -> None:
    with pytest.raises(AttributeError, match=r"no attribute 'Solvr' \(did you mean 'Solver'\?\)"):
        wb.Solvr  # noqa: B018

"""Arguments of the Python interface that are no real numbers: an :class:`InputError` that names them, whatever NumPy would make of
them. Truth: NumPy's kinds of arrays; lengths and times that have no meaning for floats of 53 bits."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest

import wbmpc as wb
from wbmpc.errors import InputError
from wbmpc.robots import load_description
from wbmpc.stability.configurations import leg_angles

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
        leg_angles(wb.load_robot(load_description("swerve-ur10").source), text)

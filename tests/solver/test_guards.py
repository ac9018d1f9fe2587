"""One thread at a time, Ctrl-C, and guesses that are no numbers. Truth: solvers of their own for every thread; the exception
that Python's handler raises."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import wbmpc as wb
from effort import some
from small_problems import cartpole
from toys import LinearQuadratic
from wbmpc.errors import InputError, NotFinite, SolverBusy
from wbmpc.interrupts import Interruptible
from wbmpc.mpc.input_rows import InputRows
from wbmpc.solver import SLQ, SQP, Solver, Status, Trajectory
from wbmpc.solver.guards import Exclusive


def linear(seed: int = 0) -> tuple[LinearQuadratic, Solver]:
    lq = LinearQuadratic(8, 4, 0, n=60, seed=seed)
    return lq, Solver(lq.problem(), SQP(iterations=20))


def together(*work: Callable[[], object]) -> None:
    """All at once, each in a thread; what any of them raises is raised."""
    raised: list[BaseException] = []

    def guarded(one: Callable[[], object]) -> None:
        try:
            one()
        except BaseException as error:
            raised.append(error)

    threads = [threading.Thread(target=guarded, args=(one,)) for one in work]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if raised:
        raise raised[0]


def test_a_solver_of_several_threads_never_returns_the_solution_of_another() -> None:
    """Linear systems have one solution for each start, which a solver of the thread's own says."""
    lq, shared = linear()
    starts = [k * lq.x0 for k in (-2.0, 1.0, 3.0)]
    own = [linear()[1].solve(x0).u for x0 in starts]
    seen = {"busy": 0, "solved": 0}

    def work(x0: np.ndarray, expected: np.ndarray) -> None:
        for _ in range(150):
            try:
                found = shared.solve(x0)
            except SolverBusy as error:
                assert "in use by another thread" in str(error)
                seen["busy"] += 1
                continue
            assert found.status is Status.CONVERGED
            np.testing.assert_allclose(found.x[0], x0, atol=1e-7)
            np.testing.assert_allclose(found.u, expected, atol=1e-5 * np.abs(expected).max())
            seen["solved"] += 1

    together(*(lambda x0=x0, u=u: work(x0, u) for x0, u in zip(starts, own)))
    assert seen["solved"] > 0 and seen["busy"] > 0
    assert shared.solve(starts[0]).status is Status.CONVERGED  # and nobody has kept it


@pytest.mark.parametrize("what", ["solve", "warm_start", "simulate", "run", "update", "advance", "reset"])
def test_every_way_into_the_memory_is_closed_while_another_thread_is_in_it(what: str) -> None:
    """The guess of an MPC runs within its update: there another thread has its turn."""
    lq, _ = linear()
    u = np.zeros(4)
    mpc = wb.MPC(lq.problem(), rate=50.0)
    ways: dict[str, Callable[[], object]] = {
        "solve": lambda: mpc.solver.solve(lq.x0),
        "warm_start": lambda: mpc.solver.warm_start(lq.x0),
        "simulate": lambda: mpc.solver.simulate(lq.x0, u, 0.1),
        "run": lambda: mpc.solver.iterate(lq.x0),
        "update": lambda: mpc.update(wb.Observation(0.0, lq.x0)),
        "advance": lambda: mpc.advance(wb.Observation(0.0, lq.x0)),
        "reset": lambda: mpc.reset(lq.x0),
    }
    rejected: list[SolverBusy] = []

    def from_another_thread(t: float, x0: np.ndarray, trajectory: Trajectory) -> None:
        mpc.solver.warm_start(x0)  # its own thread may

        def enter() -> None:
            with pytest.raises(SolverBusy) as caught:
                ways[what]()
            rejected.append(caught.value)

        together(enter)

    mpc.guess = from_another_thread
    mpc.reset(lq.x0)
    policy = mpc.update(wb.Observation(0.0, lq.x0))
    assert len(rejected) == 1 and np.isfinite(policy.u).all()
    mpc.guess = None
    together(lambda: ways[what]() is None)  # free again, for any thread


def test_nobody_changes_the_data_of_another_threads_solve() -> None:
    """Weights, parameters, modes and the barrier: a solution of half the old and half the new ones would count as converged."""
    problem = cartpole(10)
    solver = Solver(problem.ocp, SQP())
    cost = next(
        t.name for t in problem.ocp.terms.values() if isinstance(t, wb.Cost) and t.at in ("path", "path+terminal")
    )
    weight = problem.ocp.term(cost).weight  # type: ignore[union-attr]

    def through_a_barrier() -> None:
        with solver.barrier(1e-3):
            pass

    ways: dict[str, Callable[[], object]] = {
        "weight": lambda: solver.set_weight(cost, weight),
        "parameters": lambda: solver.set_parameters(np.zeros(problem.ocp.dynamics.parameters.size)),
        "schedule": lambda: solver.set_schedule(solver.schedule),
        "reset": solver.reset,
        "barrier": through_a_barrier,
    }
    for what, way in ways.items():

        def rejected(way: Callable[[], object] = way) -> None:
            with pytest.raises(SolverBusy, match="in use by another thread"):
                way()

        with solver.exclusive:
            together(rejected)
            way()  # its own thread may
        together(way)
        assert solver.solve(problem.x0).status is not Status.NOT_FINITE, what


def test_ctrl_c_while_it_is_entered_or_left_keeps_it_from_nobody() -> None:
    """At each step at which Python calls handlers: where a function begins, and after one of C's. Truth: another thread enters."""
    for step in range(100):
        exclusive, left = Exclusive("it"), [step]

        def pressed(frame: object, event: str, _: object, left: list[int] = left) -> None:
            if event in ("call", "c_return"):
                left[0] -= 1
                if left[0] < 0:
                    raise KeyboardInterrupt

        sys.setprofile(pressed)
        try:
            with exclusive, exclusive:
                exclusive.once("it", abs, 1)
        except KeyboardInterrupt:
            pass
        finally:
            sys.setprofile(None)
        together(lambda exclusive=exclusive: exclusive.once("it", abs, 1))
        if left[0] > 0:
            break
    assert 10 < step < 99


def test_solves_within_a_barrier_are_of_the_thread_that_set_it() -> None:
    """Where two contexts of two threads overlap, the last one to leave would keep the barrier of the other one for good."""
    lq, solver = linear()
    before = solver.numbers.copy()

    def enter() -> None:
        with pytest.raises(SolverBusy), solver.barrier(0.5):
            pass
        with pytest.raises(SolverBusy):
            solver.solve(lq.x0)

    with solver.barrier(0.1):
        together(enter)
        assert solver.solve(lq.x0).usable
    np.testing.assert_array_equal(solver.numbers, before)
    for value in (np.nan, np.inf, -1.0, "1"):
        with pytest.raises(InputError, match="barrier: 'value'"), solver.barrier(value):  # type: ignore[arg-type]
            pass
    np.testing.assert_array_equal(solver.numbers, before)


def test_entering_again_leaves_only_at_the_end_also_by_an_exception() -> None:
    lock = Exclusive("the solver")
    with pytest.raises(ValueError, match="inner"), lock, lock:
        raise ValueError("inner")
    together(lambda: lock.__enter__())


INTERRUPTED = """
import os, random, signal, sys, threading, time
import casadi as ca
import numpy as np
from wbmpc.solver import SQP, Solver
from small_problems import cartpole
backend, what = sys.argv[1:]
problem = cartpole(20)
solver = Solver(problem.ocp, SQP(iterations=400, backend=backend))
random.seed(0)
found, before = {}, signal.getsignal(signal.SIGINT)
for k in range(int(os.environ["TIMES"])):
    delay = random.uniform(0.0, 0.05)
    began = threading.Event()
    def interrupt():
        began.wait()
        time.sleep(delay)
        os.kill(os.getpid(), signal.SIGINT)
    thread = threading.Thread(target=interrupt)
    thread.start()
    try:
        began.set()
        while True:
            if what == "solve":
                solver.warm_start(problem.x, problem.u)
                solver.solve(problem.x0)
            else:
                solver.simulate(problem.x0, np.ones(1), 0.01)
    except BaseException as error:
        name = type(error).__name__
        found[name] = found.get(name, 0) + 1
    thread.join()
    assert signal.getsignal(signal.SIGINT) is before
print(found)
"""


@pytest.mark.parametrize(
    ("backend", "what"), some([("interpreted", "solve"), ("interpreted", "simulate"), ("compiled", "solve")], [2])
)
def test_ctrl_c_is_a_keyboard_interrupt_wherever_it_comes(backend: str, what: str) -> None:
    paths = os.pathsep.join([str(Path(__file__).parents[1]), *sys.path])
    environment = {**os.environ, "PYTHONPATH": paths, "TIMES": "40"}
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPTED, backend, what], env=environment, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.strip() == "{'KeyboardInterrupt': 40}"


def test_a_signal_within_what_leaving_calls_comes_out_after_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Python looks for signals in every function, also of its own module that sets their handlers."""
    previous, asked = signal.getsignal(signal.SIGINT), signal.getsignal
    sent: list[int] = []

    def getsignal(number: int) -> object:
        if number == signal.SIGINT and not sent:
            sent.append(number)
            os.kill(os.getpid(), number)
        return asked(number)

    with pytest.raises(KeyboardInterrupt), Interruptible():
        monkeypatch.setattr(signal, "getsignal", getsignal)
    assert sent and asked(signal.SIGINT) is previous


class _Odd(Exception):
    pass


@pytest.fixture(params=[signal.SIGTERM, signal.SIGALRM, signal.SIGUSR1])
def odd_handler(request: pytest.FixtureRequest):  # type: ignore[no-untyped-def]
    """Of a signal: also of those by which programs limit their time."""

    def handler(number: int, frame: object) -> None:
        raise _Odd(number)

    previous = signal.signal(request.param, handler)
    yield request.param, handler
    signal.signal(request.param, previous)


@pytest.mark.skipif(threading.current_thread() is not threading.main_thread(), reason="signals are the main thread's")
def test_what_a_handler_raises_comes_out_though_it_was_dropped(odd_handler: tuple[signal.Signals, object]) -> None:
    number, handler = odd_handler

    def drop() -> None:
        with contextlib.suppress(_Odd):
            signal.raise_signal(number)

    with pytest.raises(_Odd), Interruptible():
        drop()
    with pytest.raises(_Odd), Interruptible():
        drop()
        raise NotImplementedError("Wrong number or type of arguments")
    with pytest.raises(_Odd), Interruptible() as signals:
        drop()
        signals.check()
        raise AssertionError("went on")
    with pytest.raises(ZeroDivisionError), Interruptible():
        _ = 1 / 0
    assert signal.getsignal(number) is handler


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_guess_that_is_not_finite_names_where(bad: float) -> None:
    problem = cartpole(10)
    solver = Solver(problem.ocp, SQP())
    solver.warm_start(problem.x0, np.ones(1))
    x, u = np.zeros((11, 4)), np.zeros((10, 1))
    x[7, 1] = u[9, 0] = bad
    for given, words in (
        ((x,), ("warm start, x", "x[1]", "x.angle", "node 7", str(bad))),
        ((problem.x0, u), ("warm start, u", "u[0]", "u.force", "node 9", str(bad))),
        ((np.array([0.0, 0.0, bad, 0.0]),), ("warm start, x", "x[2]", "x.cart_rate", str(bad))),
        ((problem.x0, np.array([bad])), ("warm start, u", "u[0]", str(bad))),
    ):
        with pytest.raises(NotFinite) as caught:
            solver.warm_start(*given)
        assert all(word in str(caught.value) for word in words), caught.value
    with pytest.raises(InputError, match="warm start, x: numbers are needed"):
        solver.warm_start(["one", "two"])  # type: ignore[arg-type]
    assert (solver.ws.u == 1.0).all() and np.isfinite(solver.ws.x).all()  # as it was
    fine = Solver(problem.ocp, SLQ(step=0.05))
    with pytest.raises(NotFinite, match="node 7"):
        fine.warm_start(x)


@pytest.mark.parametrize("what", ["solve", "update"])
def test_a_handler_that_solves_in_the_middle_of_a_solve_is_an_error(what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A program's own timer has a handler that solves, too. Truth: a solver without one."""
    lq, _ = linear()
    mpc, plain = wb.MPC(lq.problem()), wb.MPC(lq.problem())

    def call(one: wb.MPC, x0: np.ndarray) -> np.ndarray:
        one.reset(x0)
        return one.solver.solve(x0).u if what == "solve" else one.update(wb.Observation(0.0, x0)).u

    def handler(*_: object) -> None:
        with pytest.raises(SolverBusy, match="a signal's handler"):
            _ = mpc.solver.solve(2.0 * lq.x0) if what == "solve" else mpc.update(wb.Observation(0.0, 2.0 * lq.x0))
        came.append(1)

    came: list[int] = []
    read, previous = mpc.solver.solution, signal.signal(signal.SIGUSR1, handler)

    def interrupted(*outcome: float) -> object:
        signal.raise_signal(signal.SIGUSR1)
        return read(*outcome)  # type: ignore[arg-type]

    monkeypatch.setattr(mpc.solver, "solution", interrupted)
    try:
        np.testing.assert_array_equal(call(mpc, lq.x0), call(plain, lq.x0))
    finally:
        signal.signal(signal.SIGUSR1, previous)
    assert came


@pytest.mark.parametrize("backend", ["compiled", "interpreted"])
@pytest.mark.parametrize("name", ["warm_start", "reset"])
def test_a_handler_that_changes_the_memory_of_a_solve_is_an_error(
    name: str, backend: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its guess was returned as the converged solution. Truth: a solver without a handler, twice, as slacks are kept."""
    problem = cartpole(10)
    one, plain = (Solver(problem.ocp, SQP(backend=backend, iterations=2)) for _ in range(2))  # type: ignore[arg-type]
    given = {"warm_start": (np.ones(4),), "reset": ()}[name]
    came: list[int] = []

    def handler(*_: object) -> None:
        with pytest.raises(SolverBusy, match=r"called before Solver\.solve has ended"):
            getattr(one, name)(*given)
        came.append(1)

    read, previous = one.solution, signal.signal(signal.SIGUSR1, handler)

    def interrupted(*outcome: float) -> object:
        signal.raise_signal(signal.SIGUSR1)
        return read(*outcome)  # type: ignore[arg-type]

    monkeypatch.setattr(one, "solution", interrupted)
    try:
        for x0 in (problem.x0, 1.1 * problem.x0):
            np.testing.assert_array_equal(one.solve(x0).x, plain.solve(x0).x)
    finally:
        signal.signal(signal.SIGUSR1, previous)
    assert len(came) == 2
    getattr(one, name)(*given)  # afterwards it may


@pytest.mark.parametrize("name", ["MPC.reset", "MPC.resume", "MPC.recover", "Solver.warm_start", "Solver.reset"])
def test_a_handler_that_changes_the_memory_of_an_update_is_an_error(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """What it set was returned as the plan. Truth: an MPC without a handler."""
    problem = cartpole(10)
    mpc, plain = (wb.MPC(problem.ocp) for _ in range(2))
    x, u, seen = np.ones((11, 4)), np.ones((10, 1)), wb.Observation(0.0, problem.x0)
    given: tuple[Any, ...] = {
        "MPC.reset": (np.ones(4),), "MPC.resume": (x, u, 0.0), "MPC.recover": (seen, x, u, 0.0),
        "Solver.warm_start": (np.ones(4),), "Solver.reset": (),
    }[name]  # fmt: skip
    of, method = name.split(".")
    change = getattr(mpc if of == "MPC" else mpc.solver, method)
    came: list[int] = []

    def handler(*_: object) -> None:
        with pytest.raises(SolverBusy, match=rf"{name}: called before MPC\.update has ended"):
            change(*given)
        came.append(1)

    read, previous = mpc.solver.solution, signal.signal(signal.SIGUSR1, handler)

    def interrupted(*outcome: float) -> object:
        signal.raise_signal(signal.SIGUSR1)
        return read(*outcome)  # type: ignore[arg-type]

    monkeypatch.setattr(mpc.solver, "solution", interrupted)
    for one in (mpc, plain):
        one.reset(problem.x0)
    try:
        for t in (0.0, 0.02):
            seen = wb.Observation(t, problem.x0)
            np.testing.assert_array_equal(mpc.update(seen).u, plain.update(seen).u)
    finally:
        signal.signal(signal.SIGUSR1, previous)
    assert len(came) == 2
    change(*given)  # afterwards it may


@pytest.mark.parametrize("what", ["schedule", "reference"])
def test_what_a_handler_sets_while_tables_are_made_is_not_lost(what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """It was: the tables of what had been set before were taken, and all solves went on with them. Truth: it is set before."""
    from wbmpc.solver import receding

    def ocp() -> wb.OptimalControlProblem:
        gain = lambda x, u, w=None, m=None: 0.0 * x + m[0] * u
        dynamics = wb.Ode({"x": ["x"]}, {"u": ["u"]}, gain, mode={"m": ["gain"]})
        made = wb.OptimalControlProblem(dynamics, horizon=1.0, intervals=10)
        made.add(wb.Cost("x", wb.residuals.State(dynamics), 1.0))
        made.add(wb.Cost("u", wb.residuals.Input(dynamics), 1.0))
        return made

    set_other = {
        "schedule": lambda one: one.set_schedule(wb.ModeSchedule((wb.Mode("half", {"m": (0.5,)}),))),
        "reference": lambda one: one.set_reference("x", wb.Reference.constant(np.array([3.0]))),
    }[what]
    one, plain = Solver(ocp()), Solver(ocp())
    for each in (one, plain):
        each.set_schedule(wb.ModeSchedule((wb.Mode("all", {"m": (1.0,)}),)))
    set_other(plain)
    make, came = receding.make_tables, []

    def interrupted(*given: Any) -> Any:
        made = make(*given)
        if not came:
            came.append(1)
            set_other(one)
        return made

    monkeypatch.setattr(receding, "make_tables", interrupted)
    for _ in range(2):
        np.testing.assert_array_equal(one.solve(np.ones(1)).x, plain.solve(np.ones(1)).x)


def test_a_solver_that_was_busy_at_a_fork_is_free_in_the_child() -> None:
    """Its thread is not there, and would never leave. Truth: the same solve before. One that the forking thread is in stays in use."""
    lq, solver = linear()
    before, own = solver.solve(lq.x0).x, Exclusive("it")
    held, ended = threading.Event(), threading.Event()

    def hold() -> None:
        with solver.exclusive:
            held.set()
            ended.wait(60.0)

    def child() -> bool:
        raised = []
        try:
            own.once("it", lambda _: None, None)
        except SolverBusy as error:
            raised.append(error)
        return len(raised) == 1 and bool(np.allclose(solver.solve(lq.x0).x, before, atol=1e-9))

    def fork(_: None) -> int:
        pid = os.fork()
        if pid == 0:
            status = 1
            with contextlib.suppress(BaseException):
                status = 0 if child() else 2
            os._exit(status)
        return os.waitpid(pid, 0)[1]

    thread = threading.Thread(target=hold)
    thread.start()
    try:
        assert held.wait(60.0)
        assert own.once("it", fork, None) == 0
        with pytest.raises(SolverBusy, match="in use by another thread"):
            solver.solve(lq.x0)
    finally:
        ended.set()
        thread.join()


def test_a_guess_that_calls_its_own_update_is_one_error_and_the_mpc_goes_on() -> None:
    """Truth: an MPC without a guess."""
    lq = LinearQuadratic(4, 2, 0, n=10)
    mpc, plain = wb.MPC(lq.problem()), wb.MPC(lq.problem())
    for one in (mpc, plain):
        one.reset(lq.x0)
    start = wb.Observation(t=0.0, x=lq.x0)

    def again(t: float, x0: np.ndarray, trajectory: Trajectory) -> Trajectory | None:
        mpc.update(wb.Observation(t=t, x=x0))
        return None

    mpc.guess = again
    for _ in range(2):  # the mark of the first failure is gone
        with pytest.raises(SolverBusy, match=r"MPC\.update: called before its last call has ended"):
            mpc.update(start)
    mpc.guess = None
    np.testing.assert_array_equal(mpc.update(start)(0.0), plain.update(start)(0.0))


@pytest.mark.parametrize("at", [1, 2])
def test_ctrl_c_while_an_mpc_reads_its_limits_is_not_lost(at: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """CasADi asks for sizes, in Python, and drops what is raised there: nothing of the MPC's own would ever hear of it."""
    calls, size1 = 0, ca.SX.size1

    def asked(self: ca.SX) -> int:
        nonlocal calls
        calls += 1
        if calls == at:
            signal.raise_signal(signal.SIGINT)
        return int(size1(self))

    def rows(solver: Solver) -> InputRows:
        monkeypatch.setattr(ca.SX, "size1", asked)
        return InputRows(solver)

    monkeypatch.setattr("wbmpc.mpc.mpc.InputRows", rows)
    with pytest.raises(KeyboardInterrupt):
        wb.MPC(cartpole(5).ocp, SQP.real_time())
    assert calls >= at

"""Exported controllers. Truth: the loop in Python to the last bit, the system's C compiler and its nm."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import wbmpc as wb
from command_line import call
from effort import draws, thorough
from exported import LOWER, PERIOD, UPPER, Controller, trolley
from wbmpc.embedded import check as checks
from wbmpc.embedded.exporter import check_prefix
from wbmpc.embedded.image import Export
from wbmpc.embedded.interface import public_names
from wbmpc.embedded.texts import _names
from wbmpc.errors import InputError, RunAborted
from wbmpc.solver.controller import Result
from wbmpc.solver.controller_data import Figure

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler (cc)")
NARROW = (wb.Mode("wide"), wb.Mode("narrow"))


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Export:
    return wb.export(trolley(), tmp_path_factory.mktemp("export"), prefix="trolley", samples=8)


@pytest.fixture(scope="module")
def pair(done: Export, tmp_path_factory: pytest.TempPathFactory) -> tuple[wb.MPC, Controller]:
    """The same controller twice; both go through the same tests."""
    made = Controller(done, tmp_path_factory.mktemp("library"))
    assert made.create() == Result.OK
    return trolley(), made


numbers = st.floats(-2.0, 2.0, width=32)
steps = st.lists(
    st.tuples(
        st.sampled_from(["go", "go", "go", "reference", "hold", "schedule", "weight", "lost"]),
        st.tuples(numbers, numbers), st.floats(0.0, 0.3),
    ),
    min_size=3, max_size=8,
)  # fmt: skip


@settings(max_examples=draws(12, 200), deadline=None)
@given(steps)
def test_it_does_what_python_does_to_the_last_bit(pair: tuple[wb.MPC, Controller], course: list) -> None:
    """Through changes of references, modes and weights, states that nobody can be in, plans that are kept, and resets."""
    mpc, made = pair
    start, t, policy, figures = np.array([0.1, 0.0]), 0.0, None, np.empty(len(Figure))
    mpc.reset(start)
    assert made("reset", start, np.zeros(2)) == Result.OK
    for word, pushed, dt in course:
        t, x = t + dt, np.array(pushed) * (1e300 if word == "lost" else 1.0)
        _change(mpc, made, word, t, pushed)
        failures = mpc.statistics.failures
        found = made("update", t, x)
        try:
            policy = mpc.update(wb.Observation(t, x))
        except RunAborted:
            assert found == Result.NO_PLAN
            return
        assert found == (Result.KEPT if mpc.statistics.failures > failures else Result.OK)
        assert made("figures", figures) == Result.OK
        assert (
            figures[Figure.EXTENDED] == mpc.statistics.extended
            and figures[Figure.ITERATIONS] == mpc.solve_info["iterations"]
        )
        for at in (t, t + 0.03, t + 0.4, policy.end + 1.0):
            _compare(policy, made, at, np.array(pushed))


def _change(mpc: wb.MPC, made: Controller, word: str, t: float, pushed: tuple[float, float]) -> None:
    values = np.array([pushed, pushed[::-1], (0.1, 0.0)])
    times = t + np.array([0.0, 0.1, 0.6])
    if word in ("reference", "hold"):
        kind = ("linear", "pose", "hold").index("linear" if word == "reference" else "hold")
        mpc.reference["state"] = wb.Reference(times, values, "linear" if kind == 0 else "hold")
        mpc.reference["limit"] = wb.Reference(times, 0.05 * values, "linear" if kind == 0 else "hold")
        names = list(mpc.solver.problem.references.slices)
        assert made("set_reference", names.index("state"), kind, 3, times, values) == Result.OK
        assert made("set_reference", names.index("limit"), kind, 3, times, 0.05 * values) == Result.OK
    elif word == "schedule":
        mpc.set_schedule(wb.ModeSchedule((NARROW[1], NARROW[0]), (t + 0.2,)))
        assert made("set_schedule", 1, np.array([t + 0.2]), np.array([1, 0])) == Result.OK
    elif word == "weight":
        weight = np.abs(np.array(pushed)) + 0.1
        mpc.solver.set_weight("state", weight)
        groups = [name for name, part in mpc.solver.problem.constant.slices.items() if part.stop > part.start]
        assert made("set_constants", groups.index("path.state"), weight) == Result.OK


def _compare(policy: wb.Policy, made: Controller, t: float, x: np.ndarray) -> None:
    u, planned_x, planned_u = np.empty(2), np.empty(2), np.empty(2)
    assert made("policy", t, x, u) == Result.OK
    np.testing.assert_array_equal(u, policy(t, x))
    assert made("planned", t, planned_x, planned_u) == Result.OK
    np.testing.assert_allclose(planned_x, policy.state(t), atol=1e-15)
    np.testing.assert_array_equal(planned_u, policy(t))


def test_what_cannot_be_is_an_error_and_changes_nothing(pair: tuple[wb.MPC, Controller]) -> None:
    _, made = pair
    x, one, nan = np.zeros(2), np.zeros(1), np.array([0.0, np.nan])
    assert made("reset", nan, x) == Result.NOT_A_NUMBER
    assert made("reset", x, x) == Result.OK
    assert made("policy", 0.0, x, np.empty(2)) == Result.NO_PLAN
    assert made("update", float("nan"), x) == made("update", 0.0, nan) == Result.NOT_A_NUMBER
    assert made("update", 1.0, x) == Result.OK
    before = made.block.copy()
    assert made("update", 0.5, x) == Result.TIME_WENT_BACK
    assert made("policy", 1.0, nan, np.empty(2)) == Result.NOT_A_NUMBER
    two = np.zeros((2, 2))
    assert made("set_reference", 2, 0, 1, one, x) == made("set_reference", -1, 0, 1, one, x) == Result.NO_SUCH_INDEX
    assert made("set_reference", 0, 1, 1, one, x) == made("set_reference", 0, 4, 1, one, x) == Result.NO_SUCH_INDEX
    assert made("set_reference", 0, 0, 0, one, x) == made("set_reference", 0, 0, 9, one, x) == Result.TOO_MANY
    assert made("set_reference", 0, 0, 1, one, nan) == Result.NOT_A_NUMBER
    assert made("set_reference", 0, 0, 2, np.array([1.0, 0.5]), two) == Result.NOT_SORTED
    assert made("set_schedule", 9, np.arange(9.0), np.zeros(10, int)) == Result.TOO_MANY
    assert made("set_schedule", 1, one, np.array([0, 2])) == Result.NO_SUCH_INDEX
    assert made("set_schedule", 2, np.zeros(2), np.zeros(3, int)) == Result.NOT_SORTED
    assert made("set_constants", 99, x) == Result.NO_SUCH_INDEX
    assert (made.block != before).sum() <= 8 * 8  # room that a policy works in
    made.size -= 8
    assert made.create() == Result.WRONG_SIZE
    made.size += 8
    made.block = made.block[8:]
    assert made.create() == Result.NOT_ALIGNED
    made.block = np.zeros(made.size + 64, dtype=np.uint8)
    assert made("update", 1.0, x) == Result.NOT_CREATED


def test_a_huge_start_does_not_keep_it_from_its_first_plan(done: Export, tmp_path: Path) -> None:
    """As in Python (tests/mpc/test_first_guess.py), to the last bit; a state that nobody can be in is forgotten."""
    mpc, made = trolley(), Controller(done, tmp_path)
    made.create()
    x, huge = np.array([0.3, 0.0]), np.full(2, 1e200)
    mpc.reset(huge, huge)
    assert made("reset", huge, huge) == Result.OK
    with pytest.raises(RunAborted):
        mpc.update(wb.Observation(0.0, huge))
    assert made("update", 0.0, huge) == Result.NO_PLAN
    for t in (0.0, PERIOD):
        assert made("update", t, x) == Result.OK
        _compare(mpc.update(wb.Observation(t, x)), made, t, x)


def test_a_copy_of_a_block_goes_on_alone_and_its_front_gives_inputs(done: Export, tmp_path: Path) -> None:
    made, x, u, v = Controller(done, tmp_path), np.array([0.3, 0.1]), np.empty(2), np.empty(2)
    made.create()
    made("update", 0.0, x)
    other = np.zeros(made.size + 64, dtype=np.uint8)
    twin = other[-other.ctypes.data % 64 :][: made.size]
    twin[:] = made.block
    first, made.block = made.block, twin
    assert made("update", PERIOD, x) == Result.OK
    made("policy", PERIOD, x, u)
    first[:], made.block = 0xFF, first  # what the copy came from is gone
    header = (done.directory / "trolley.h").read_text()
    front = int(header.split("TROLLEY_PLAN_SIZE ")[1].split()[0])
    assert front < 0.1 * made.size
    first[:front] = twin[:front]
    assert made("policy", PERIOD, x, v) == Result.OK
    np.testing.assert_array_equal(u, v)


def test_it_counts_and_holds_the_limits(done: Export, tmp_path: Path) -> None:
    made, x, u, found = Controller(done, tmp_path), np.array([0.3, 0.1]), np.empty(2), np.empty(len(Figure))
    made.create()
    assert made("update", 0.0, x) == Result.OK
    assert made("policy", 0.0, np.array([9.0, 9.0]), u) == Result.OK
    assert (u >= LOWER + np.array([0.05, -0.05]) - 1e-9).all() and (u <= UPPER + np.array([0.05, -0.05]) + 1e-9).all()
    assert made("figures", found) == Result.OK
    assert found[Figure.UPDATES] == found[Figure.CUT] == 1 and found[Figure.FAILURES] == 0
    assert found[Figure.ITERATIONS] >= 5 and found[Figure.END] == 1.0


def test_names_begin_with_the_prefix_and_little_is_needed(done: Export) -> None:
    """By nm; malloc and the like would be among what is needed."""
    text = subprocess.run(["nm", str(done.directory / "trolley.o")], capture_output=True, text=True, check=True).stdout
    rows = [line.split() for line in text.splitlines()]
    defined = sorted(name for *_, kind, name in rows if kind.isupper() and kind != "U")
    needed = sorted(name for *_, kind, name in rows if kind == "U" and name != "_GLOBAL_OFFSET_TABLE_")
    assert defined == done.symbols.defined and all(name.startswith("trolley_") for name in defined)
    assert needed == done.symbols.undefined and set(needed) <= {
        "sin",
        "cos",
        "sincos",
        "log",
        "pow",
        "fmax",
        "atan2",
        "memcpy",
        "memset",
    }
    assert ", ".join(needed) in (done.directory / "README.md").read_text()


@pytest.mark.parametrize("language", ["c11", "c++17"])
def test_the_header_is_clean(done: Export, language: str) -> None:
    compiler = "cc" if language == "c11" else "c++"
    if shutil.which(compiler) is None:
        pytest.skip(f"no {compiler}")
    strict = ["-Wall", "-Wextra", "-Werror", "-pedantic", "-x", "c" if language == "c11" else "c++"]
    command = [compiler, f"-std={language}", *strict, "-c", "example.c", "-o", "/dev/null"]
    subprocess.run(command, cwd=done.directory, check=True)


def test_the_check_passes_and_finds_another_controller(done: Export) -> None:
    found = checks.check(done, trolley(), updates=15)
    assert found.passed and found.exact and found.largest == 0.0
    other = trolley()
    other.solver.set_weight("state", [11.0, 1.0])
    assert not checks.check(done, other, updates=15).passed


class Cautious(wb.MPC):
    """A subclass that changes what an update is."""

    def update(self, observation: wb.Observation) -> wb.Policy:
        return super().update(wb.Observation(observation.t, 0.5 * observation.x))


def test_errors_name_what_is_wrong(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mpc = trolley()
    for options, text in (
        ({"target": "riscv64"}, r"unknown target 'riscv64'; valid: native, x86-64-v3, aarch64"),
        ({"prefix": "My-Robot"}, r"prefix 'My-Robot' is no beginning of names; valid: a lower-case letter"),
        ({"prefix": "double"}, r"prefix 'double' is a word of C or C..; valid: .*as 'my_robot'$"),
        ({"samples": 0}, r"samples: a whole number from 1 to 100000 is needed, got 0"),
        ({"samples": 10**20}, r"samples: a whole number from 1 to 100000 is needed, got 10000"),
    ):
        with pytest.raises(InputError, match=text):
            wb.export(mpc, tmp_path, **options)  # type: ignore[arg-type]
    mpc.guess = lambda t, x0, trajectory: None
    with pytest.raises(InputError, match=r"the MPC's guess \(function\) is Python and cannot be exported"):
        wb.export(mpc, tmp_path)
    own, mpc.guess = trolley(), None
    own.recover = lambda *_: None  # type: ignore[method-assign]
    for changed, name in ((Cautious(mpc.ocp), "update"), (own, "recover")):
        with pytest.raises(
            InputError, match=rf"(Cautious|MPC) has a '{name}' of its own, which is Python and cannot be exported"
        ):
            wb.export(changed, tmp_path)
    interpreted = wb.MPC(mpc.ocp, wb.SQP.real_time(backend="interpreted"))
    with pytest.raises(InputError, match="this problem runs in CasADi's interpreter"):
        wb.export(interpreted, tmp_path)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("CC", "no-compiler")
    with pytest.raises(InputError, match=r"there is no C compiler .'no-compiler' of the variable CC found"):
        checks.tools("native")
    monkeypatch.delenv("CC")
    with pytest.raises(InputError, match="none of cc, gcc and clang found"):
        checks.tools("native")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "prefix",
    [
        "size_t",
        "printf",
        "test",
        "linux",
        "main",
        "int",
        "errno",
        "stdio",
        "string",
        "example",
        "m",
        "pthread",
        "timer",
        "sin",
        "all",
    ],
)
def test_a_prefix_with_which_nothing_could_be_built_is_an_error(prefix: str) -> None:
    """Truth: ISO C, POSIX (pthread_create, timer_create), CMake's policy CMP0037."""
    with pytest.raises(InputError, match=rf"prefix '{prefix}' .*; valid: a lower-case letter.*as 'my_robot'"):
        check_prefix(prefix, public_names(prefix).values())


def test_enumerators_are_unique_however_names_are_spelled() -> None:
    """Truth: C compares identifiers letter by letter."""
    names = ["a-b", "a_b", "a_b_0", "A.B", "a b_1_", "a_b_1", "c", "", "_"]
    found = re.findall(r"(\w+) = (\d+)", _names("P", "MODE_", names))
    assert [int(number) for _, number in found] == list(range(len(names)))
    assert len({name for name, _ in found}) == len(names)
    assert ("P_MODE_C", "6") in found and ("P_MODE_A_B_1", "5") in found


PROGRAM = "import sys; sys.path.insert(0, {tests!r})\nfrom exported import trolley\nmpc = trolley()\nnumber = 3\n"


def test_the_command_line_reads_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "problem.py"
    program = PROGRAM.format(tests=str(Path(__file__).parents[1])) + "\n\ndef wrong():\n    return 1 / 0\n"
    file.write_text(program)
    line = len(program.splitlines())
    for problem, text in (
        (f"{file}:number", "an MPC is needed, got int"),
        (f"{file}:other", "there is no other"),
        (f"{file}:wrong", f"problem.py, line {line}: wrong() fails: ZeroDivisionError: division by zero"),
        ("a.py", "no file 'a.py'"),
    ):
        assert call("export", problem, "--out", str(tmp_path / "out")) == 2
        assert text in capsys.readouterr().err
    out = tmp_path / "not there" / "out"
    for option in ("--prefix=1", "--target=pdp11", "--samples=0"):
        assert call("export", f"{file}", "--out", str(out), option) == 2
        assert not out.parent.exists(), option


@thorough
def test_two_controllers_in_one_program(done: Export, tmp_path: Path) -> None:
    second = wb.export(trolley(50.0), tmp_path, prefix="second")
    (tmp_path / "main.c").write_text(
        '#include "trolley.h"\n#include "second.h"\nstatic trolley a; static second b;\n'
        "int main(void) { double x[2] = {0}; return trolley_create(&a, sizeof a) + second_create(&b, sizeof b)"
        " + trolley_update(&a, 0.0, x) + second_update(&b, 0.0, x)"
        " + (second_update((second *)&a, 0.0, x) != SECOND_NOT_CREATED); }\n"
    )
    objects = [str(done.directory / "trolley.o"), str(second.directory / "second.o")]
    command = ["cc", "main.c", *objects, f"-I{done.directory}", "-lm", "-o", "main"]
    subprocess.run(command, cwd=tmp_path, check=True)
    assert subprocess.run([str(tmp_path / "main")]).returncode == 0


@thorough
@pytest.mark.parametrize("target", ["x86-64-v3", "aarch64"])
def test_other_targets_agree_with_python(tmp_path: Path, target: str, capsys: pytest.CaptureFixture[str]) -> None:
    try:
        checks.tools(target)
    except InputError as error:
        pytest.skip(str(error))
    file = tmp_path / "problem.py"
    file.write_text(PROGRAM.format(tests=str(Path(__file__).parents[1])))
    assert call("export", f"{file}", "--out", str(tmp_path / "out"), "--target", target, "--check", "--json") == 0
    assert json.loads(capsys.readouterr().out)["check"]["passed"]


@pytest.mark.parametrize("name", ["README.md", "CMakeLists.txt", "example.c", "controller.h"])
def test_a_file_that_is_there_is_not_replaced(tmp_path: Path, name: str) -> None:
    (tmp_path / "problem.py").write_text("from exported import trolley as make_mpc\n")
    (tmp_path / name).write_text("mine")
    assert call("export", str(tmp_path / "problem.py"), "--out", str(tmp_path)) == 2
    assert (tmp_path / name).read_text() == "mine"


def test_a_name_that_is_left_out_after_the_colon_is_an_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "problem.py").write_text("from exported import trolley as make_mpc\n")
    assert call("export", f"{tmp_path / 'problem.py'}:", "--out", str(tmp_path / "out")) == 2
    assert "there is no name after ':'" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "out").exists()


def test_names_of_states_cannot_end_a_comment(tmp_path: Path) -> None:
    names = {"x": ["a */ int evil; /*"]}, {"u": ["b\n*/"]}
    dynamics = wb.Ode(*names, lambda x, u: u)
    ocp = wb.OptimalControlProblem(dynamics, horizon=1.0, intervals=5)
    ocp.add(wb.Cost("effort", wb.residuals.Expression(1, lambda s: s.u), 1.0))
    made = wb.export(wb.MPC(ocp, rate=10.0), tmp_path)
    text = (made.directory / "controller.h").read_text()
    assert "evil;" not in text
    assert text.count("/*") == text.count("*/")
    check_symbols(made)


def check_symbols(done: Export) -> None:
    """Others see the functions of the header and nothing else. The solver's own begin with its modules' names, as with "controller"."""
    text = subprocess.run(["nm", "-g", str(done.directory / f"{done.prefix}.o")], capture_output=True, text=True)
    rows = [line.split() for line in text.stdout.splitlines()]
    functions = re.findall(rf"int ({done.prefix}_\w+)\(", (done.directory / f"{done.prefix}.h").read_text())
    assert sorted(name for *_, kind, name in rows if kind != "U") == sorted(functions) == done.symbols.defined

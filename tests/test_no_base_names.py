"""Generic modules ask the table of base types (:mod:`wbmpc.bases`) and its protocols: none names a base type or a robot."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "src" / "wbmpc"
#: A base type or robot by name, in code or prose. "fixed" and "ball" are words of their own: only as a base they count.
NAMES = re.compile(
    r"swerve|rezero|ballbot|mecanum|omnidirectional"
    r"|\bdifferential[ _-](base|drive|robot)|[\"']differential[\"']"
    r"|\bball[ _-](base|robot|plant|radius)|[\"']ball[\"']|\bBall[A-Z]|\bBALL_"
    r"|\bfixed base|FixedBase|type == [\"']fixed[\"']"
    r"|\bbases\.(ball|fixed|swerve|differential|omnidirectional)\b"
)
#: The built-in robots: names as in their files, whole words.
ROBOTS = re.compile(r"\b(" + "|".join(sorted(p.stem for p in (SOURCE / "robots" / "data").glob("*.yaml"))) + r")\b")
#: "fetch" is an operation of generated code too.
WORDS = re.compile(r"\bfetch\(|\.fetch\b")
PACKAGES = (
    "clearance", "mapping", "embedded", "study", "report", "plots", "tasks", "settings.py", "default_problem.py", "experiment.py", "registry.py",
    "reproduce.py", "result.py", "run_files.py", "run_index.py", "model", "obstacles", "ocp", "kernel", "solver", "mpc", "runtime",
    "simulation", "estimation", "control", "stability", "recording", "view", "ros2", "cli", "robots", "benchmark", "types.py", "compare.py",
)  # fmt: skip
#: Groups of joints that only some bases have, as a literal of its own or before the name of a joint: "steer", "steer.LF".
GROUPS = re.compile(r"(leg|steer|wheel)(\.|$)")
#: The robot with which an experiment of any robot starts, where none is given.
DEFAULT_ROBOT = re.compile(r'robot: (?:str|Robot) = "[a-z0-9-]+"')


def modules() -> list[str]:
    found = (SOURCE / package for package in PACKAGES)
    files = [f for place in found for f in ([place] if place.is_file() else sorted(place.rglob("*.py")))]
    return [f.relative_to(SOURCE).as_posix() for f in files]


def named(module: str) -> list[str]:
    """The lines of a module that name a base type or a robot."""
    lines = (SOURCE / module).read_text().splitlines()
    return [
        f"{module}:{i}: {line.strip()}"
        for i, line in enumerate(lines, start=1)
        if NAMES.search(DEFAULT_ROBOT.sub("", line)) or ROBOTS.search(WORDS.sub("", DEFAULT_ROBOT.sub("", line)))
    ]


def group_literals(source: str) -> list[tuple[int, str]]:
    """Lines and texts of the literals that are groups of a base."""
    found = [n for n in ast.walk(ast.parse(source)) if isinstance(n, ast.Constant) and isinstance(n.value, str)]
    return [(n.lineno, n.value) for n in found if GROUPS.match(n.value)]


def test_generic_modules_know_no_groups_of_a_base() -> None:
    """They ask :class:`wbmpc.bases.base.Base` and its footprint which groups roll, steer and move legs."""
    found = {m: group_literals((SOURCE / m).read_text()) for m in modules()}
    odd = [f"{m}:{i}: '{text}'" for m, own in found.items() for i, text in own]
    assert not odd, "\n".join(odd)


@pytest.mark.parametrize(
    "line", ['x[robot.state["leg"]]', 'name.startswith("steer.")', 'if "wheel" in groups: pass', 'f"leg.{name}"']
)
def test_a_group_is_found(line: str) -> None:
    assert group_literals(line)


@pytest.mark.parametrize("line", ['"""wheels roll"""', '"legs"', '"steering"', '"wheel speeds"', "steer = 1"])
def test_words_that_are_no_group_are_not(line: str) -> None:
    assert not group_literals(line)


def test_generic_modules_name_no_base_type() -> None:
    assert not (lines := [line for module in modules() for line in named(module)]), "\n".join(lines)


@pytest.mark.parametrize(
    "line",
    [
        "from wbmpc.bases.swerve.model import SwerveBase",
        'if description.base.type == "ball":',
        "from wbmpc.bases.ball import residuals",
        "robot = load_robot('rezero')",
        '"""A ball robot has none."""',
    ],
)
def test_a_name_is_found(line: str) -> None:
    assert NAMES.search(line)


@pytest.mark.parametrize("line", ["a robot with two arms, such as pr2", "load_robot('panda')"])
def test_the_name_of_a_robot_is_found(line: str) -> None:
    assert ROBOTS.search(line)


@pytest.mark.parametrize(
    "line",
    ['Kind = Literal["fixed", "revolute"]', "a ball of ``mass`` [kg]", "differential equations", "bases.base_type"],
)
def test_words_that_are_no_base_type_are_not(line: str) -> None:
    assert not NAMES.search(line)

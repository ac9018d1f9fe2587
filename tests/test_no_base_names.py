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
#: Groups of joints that only some bases have, as a literal of its own, before the name of a joint, or among the alternatives of a pattern:
#: "steer", "steer.LF", "(arm|steer)"; and what users call them.
GROUPS = re.compile(r"^(leg|steer|wheel)(\.|$)|(^|[|(])(leg|steer)([|)]|$)|^(legs|steering)$")
#: The same as a part of a name in code: leg_commands, SetLegs; and what a steered wheel with its mount is called there.
PARTS = re.compile(
    r"^module_(?:offset|lag|geometry)|ModuleGeometry|(?:^|_|(?<=[a-z])(?=[A-Z]))(?:[Ll]egs?|[Ss]teer(?:ing|ed)?)(?=_|$|[A-Z])"
)
#: Who asks :class:`wbmpc.bases.footprint.Footprint` and the protocols of bases how feet, legs and steered wheels stand, or finds such joints
#: in a robot's file. The others know no base's parts by their names.
FEET = (
    "bases/",
    "model/wheels.py",
    "robots/",
    "stability/",
    "ocp/residuals.py",
    "tasks/tip_over.py",
)
#: The tables of base types and of robots with which tasks start, the name that :class:`wbmpc.bases.base.Base` gives the group of wheels, and
#: the names of checks.
TABLES = {"bases/__init__.py", "robots/examples.py"}
NAMED = {("bases/base.py", "wheel"), ("robots/model_checks.py", "steering")}


def modules() -> list[str]:
    """All but the folders of base types and the studies."""
    found = (f.relative_to(SOURCE) for f in sorted(SOURCE.rglob("*.py")))
    inside = lambda f: f.parts[0] == "studies" or (f.parts[0] == "bases" and len(f.parts) > 2)
    return [f.as_posix() for f in found if not inside(f) and f.as_posix() not in TABLES]


def named(module: str) -> list[str]:
    """The lines of a module that name a base type or a robot."""
    lines = (SOURCE / module).read_text().splitlines()
    return [
        f"{module}:{i}: {line.strip()}"
        for i, line in enumerate(lines, start=1)
        if NAMES.search(line) or ROBOTS.search(WORDS.sub("", line))
    ]


def group_literals(source: str) -> list[tuple[int, str]]:
    """Lines and texts of the literals that are groups of a base."""
    found = [n for n in ast.walk(ast.parse(source)) if isinstance(n, ast.Constant) and isinstance(n.value, str)]
    return [(n.lineno, n.value) for n in found if GROUPS.search(n.value)]


def parts_named(source: str) -> set[str]:
    """Names in code that have a base's part in them."""
    nodes = list(ast.walk(ast.parse(source)))
    found = {getattr(n, key, None) for n in nodes for key in ("id", "attr", "arg", "name")}
    return {name for name in found if isinstance(name, str) and PARTS.search(name)}


def test_generic_modules_know_no_groups_of_a_base() -> None:
    """They ask :class:`wbmpc.bases.base.Base` and its footprint which groups roll, steer and move legs."""
    found = {m: group_literals((SOURCE / m).read_text()) for m in modules()}
    odd = [f"{m}:{i}: '{text}'" for m, own in found.items() for i, text in own if (m, text) not in NAMED]
    assert not odd, "\n".join(odd)


def test_generic_modules_name_no_parts_of_a_base() -> None:
    found = {m: parts_named((SOURCE / m).read_text()) for m in modules() if not m.startswith(FEET)}
    assert not {m: names for m, names in found.items() if names}


@pytest.mark.parametrize(
    "code",
    ["class SetLegs: ...", "node.leg_commands()", "def f(*, legs): ...", "steering_joints = 1", "draw.module_lag"],
)
def test_a_part_in_a_name_is_found(code: str) -> None:
    assert parts_named(code)


@pytest.mark.parametrize("code", ["legend = 1", "Legend()", "delegate(x)", "legal = illegal"])
def test_names_without_a_part_are_not(code: str) -> None:
    assert not parts_named(code)


@pytest.mark.parametrize(
    "line",
    [
        'x[robot.state["leg"]]',
        'name.startswith("steer.")',
        'if "wheel" in groups: pass',
        'f"leg.{name}"',
        'r"/measured/(arm|wheel|steer|leg)$"',
        'groups["legs"]',
    ],
)
def test_a_group_is_found(line: str) -> None:
    assert group_literals(line)


@pytest.mark.parametrize(
    "line", ['"""wheels roll"""', '"of its legs"', '"wheel speeds"', "steer = 1", '"head|wheel|camera"']
)
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

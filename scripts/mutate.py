"""Mutation testing: small errors are put into a module, one at a time, and its tests have to notice.

    python scripts/mutate.py metrics --count 20 --seed 0
    python scripts/mutate.py src/wbmpc/lie.py --tests tests/test_lie.py --lines 40-80

Targets by name are in :data:`TARGETS`; a file needs --tests. Mutants are drawn by --seed (all without --count). Each is run on a copy of
the source, with ``pytest -x``; one that takes longer than --timeout [s] counts as noticed. The survivors are printed; exit status 1 if
there are any. Kinds: comparisons turned, + and - or * and / exchanged, ``and`` and ``or`` exchanged, conditions negated, numbers
changed, min and max exchanged, arguments and pairs exchanged, endings of names ("base" and "odometry", "_world" and "") exchanged.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
_STUDIES, _PANKERT = "src/wbmpc/studies", "src/wbmpc/studies/pankert2022"
#: By name: files, and the tests that are to notice what is wrong in them.
TARGETS: dict[str, tuple[list[str], list[str]]] = {
    "metrics": (
        [
            *(f"{_PANKERT}/{n}.py" for n in ("metrics", "drive_figures", "fixed_figures", "track_figures")),
            f"{_STUDIES}/minniti2019/metrics.py",
            f"{_STUDIES}/minniti2019/step_figures.py",
        ],
        [f"tests/studies/test_{n}.py" for n in ("metrics", "baselines_that_fall", "swerve_fixed", "smoke")],
    ),
    "perturbation": (
        ["src/wbmpc/simulation/perturbation.py", "src/wbmpc/simulation/localization.py"],
        ["tests/simulation/test_perturbation.py", "tests/simulation/test_swerve_plant.py"],
    ),
    "estimators": (
        [
            *(
                f"src/wbmpc/bases/swerve/{n}.py"
                for n in ("wheel_fit", "wheel_odometry", "odometry_filter", "slip_step", "slipping_wheels")
            ),
            f"{_PANKERT}/release_odometry.py",
        ],
        [
            "tests/estimation/test_odometry.py",
            "tests/estimation/test_fused_odometry.py",
            "tests/control/test_swerve_controller.py",
        ],
    ),
    "residuals": (["src/wbmpc/ocp/frame_residuals.py"], ["tests/ocp", "tests/model/test_balance.py"]),
}
#: What is exchanged.
COMPARISONS = {ast.Lt: ast.GtE, ast.GtE: ast.Lt, ast.Gt: ast.LtE, ast.LtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq}
OPERATORS = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult}
JOINTS = {ast.And: ast.Or, ast.Or: ast.And}
NAMES = {"min": "max", "max": "min", "argmin": "argmax", "argmax": "argmin", "minimum": "maximum", "maximum": "minimum"}
TEXTS = {"base": "odometry", "odometry": "base", "_world": "", "world": "reference", "hand": "hand_odometry"}


@dataclass(frozen=True)
class Mutant:
    """An error on ``line``: what it is, and the whole source with it."""

    line: int
    what: str
    source: str


def changes(node: ast.AST) -> Iterator[Callable[[], None]]:
    """What may be wrong with one node, each as a function that makes it wrong in place."""
    match node:
        case ast.Compare(ops=[first, *_]) if type(first) in COMPARISONS:
            yield lambda: node.ops.__setitem__(0, COMPARISONS[type(first)]())
        case ast.BinOp(op=op) | ast.AugAssign(op=op) if type(op) in OPERATORS:
            yield lambda: setattr(node, "op", OPERATORS[type(op)]())
        case ast.BoolOp(op=op):
            yield lambda: setattr(node, "op", JOINTS[type(op)]())
        case ast.If(test=test) | ast.IfExp(test=test):
            yield lambda: setattr(node, "test", ast.UnaryOp(ast.Not(), test))
        case ast.Constant(value=bool() as value):
            yield lambda: setattr(node, "value", not value)
        case ast.Constant(value=int() | float() as number):
            yield lambda: setattr(node, "value", number * 4 if abs(number) > 1 else number + 1)
        case ast.Constant(value=str() as text) if text in TEXTS:
            yield lambda: setattr(node, "value", TEXTS[text])
        case ast.Name(id=name) if name in NAMES:
            yield lambda: setattr(node, "id", NAMES[name])
        case ast.Attribute(attr=name) if name in NAMES:
            yield lambda: setattr(node, "attr", NAMES[name])
        case ast.Tuple(elts=[_, _] as pair, ctx=ast.Load()) | ast.Call(args=[_, _] as pair):
            yield pair.reverse


def _code(tree: ast.AST) -> Iterator[ast.AST]:
    """Nodes but for annotations and docstrings, which nothing tests."""
    for name, value in ast.iter_fields(tree):
        if name in ("annotation", "returns", "decorator_list"):
            continue
        for child in value if isinstance(value, list) else [value]:
            text = isinstance(child, ast.Expr) and isinstance(child.value, ast.Constant)
            if isinstance(child, ast.AST) and not text and not isinstance(child, (ast.Raise, ast.ImportFrom)):
                yield child
                yield from _code(child)


def mutants(source: str, lines: range | None = None) -> list[Mutant]:
    """All mutants of a ``source``, on ``lines`` only where given."""
    found = []
    for k, sound in enumerate(_code(ast.parse(source))):
        line, many = getattr(sound, "lineno", 0), len(list(changes(sound)))
        if lines is not None and line not in lines:
            continue
        before = ast.unparse(sound).splitlines()[0] if many else ""
        for which in range(many):
            tree = ast.parse(source)
            node = list(_code(tree))[k]
            list(changes(node))[which]()
            after = ast.unparse(ast.fix_missing_locations(node)).splitlines()[0]
            found.append(Mutant(line, f"{before}  ->  {after}", ast.unparse(tree)))
    return found


def noticed(copied: Path, file: Path, mutant: Mutant, tests: list[str], timeout: float) -> bool:
    """Whether ``tests`` fail with a mutant of ``file`` in the ``copied`` sources."""
    place = copied / file.relative_to(ROOT / "src")
    place.write_text(mutant.source)
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *tests]
    environment = os.environ | {"PYTHONPATH": str(copied), "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, timeout=timeout)
    except subprocess.TimeoutExpired:
        return True
    finally:
        shutil.copyfile(file, place)
    if done.returncode not in (0, 1, 2):  # 2: a module that no longer imports
        raise SystemExit(f"mutate: pytest ended with {done.returncode}: {done.stdout.decode()[-500:]}")
    return done.returncode != 0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("target", help=f"a file, or one of: {', '.join(TARGETS)}")
    parser.add_argument("--tests", nargs="+", default=[])
    parser.add_argument("--count", type=int, help="so many of them, drawn")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--lines", help="first-last, of every file")
    parser.add_argument("--timeout", type=float, default=600.0)
    given = parser.parse_args()
    files, tests = TARGETS.get(given.target, ([given.target], []))
    tests = given.tests or tests
    paths = [(ROOT / file).resolve() for file in files]
    if not tests or not all(path.is_file() and path.is_relative_to(ROOT / "src") for path in paths):
        parser.error(f"'{given.target}' must be a file below src, with --tests, or one of: {', '.join(TARGETS)}")
    first, last = (int(n) for n in given.lines.split("-")) if given.lines else (1, 10**9)
    made = [(path, m) for path in paths for m in mutants(path.read_text(), range(first, last + 1))]
    if given.count is not None:
        made = random.Random(given.seed).sample(made, min(given.count, len(made)))
    survived = 0
    with tempfile.TemporaryDirectory() as directory:
        copied = Path(shutil.copytree(ROOT / "src", Path(directory) / "src"))
        for path, mutant in made:
            lives = not noticed(copied, path, mutant, tests, given.timeout)
            survived += lives
            word = "SURVIVED" if lives else "noticed "
            print(f"{word} {path.relative_to(ROOT)}:{mutant.line}: {mutant.what}", flush=True)
    print(f"{survived} of {len(made)} mutants survived")
    return survived > 0


if __name__ == "__main__":
    sys.exit(main())

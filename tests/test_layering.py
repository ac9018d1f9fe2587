"""The order of the packages, read from the source: a module imports only from packages before its own."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "wbmpc"

PACKAGES = (
    "arrays", "constants", "errors", "interrupts", "plugins", "mujoco_start", "checks", "logs", "lie", "output_file", "log", "trajectory", "types",
    "input_file", "yaml_file", "configuration", "settings_table", "units", "plots", "result", "result_checks", "report", "run_files",
    "run_index",
    "bases", "robots", "model", "stability", "obstacles", "ocp", "kernel", "clearance", "mapping", "solver", "mpc", "embedded", "control",
    "runtime", "estimation", "settings", "simulation", "default_problem", "experiment", "registry", "recording", "view", "ros2", "compare",
    "reproduce", "study", "bases/TYPE", "tasks", "benchmark", "cli", "studies", "__main__",
)  # fmt: skip
#: Third-party packages and the only packages that may use them: physics stays out of planning, drawing out of everything.
ONLY_IN = {
    "plotly": {"plots", "report", "study"},
    "distributed": {"study"},
    "optuna": {"study"},
    "pyarrow": {"recording", "study"},
    "rich": {"cli", "benchmark"},
    "typer": {"cli"},
    "mcap": {"recording"},
    "viser": {"view"},
    "llvmlite": {"kernel"},
    "threading": {
        "interrupts",
        "logs",
        "registry",
        "model",
        "obstacles",
        "kernel",
        "solver",
        "runtime",
        "simulation",
        "view",
        "ros2",
        "cli",
        "bases/TYPE",
    },
    "multiprocessing": {"interrupts", "runtime", "benchmark", "view", "studies"},
    "cyclonedds": {"ros2"},
    "rosbags": {"ros2"},
    "rclpy": {"ros2"},
    "mujoco": {"mujoco_start", "bases", "robots", "model", "obstacles", "simulation", "bases/TYPE", "studies"},
}
MODULES = sorted(p for p in SOURCE.rglob("*.py") if p != SOURCE / "__init__.py")


def owner(path: Path) -> str:
    return package_of(path.relative_to(SOURCE).with_suffix("").parts)


def package_of(parts: Sequence[str]) -> str:
    """The package of a module by its name below ``wbmpc``: the folders of base types are one of their own."""
    if parts[0] == "bases" and len(parts) > 1 and (SOURCE / "bases" / parts[1]).is_dir():
        return "bases/TYPE"
    return parts[0]


def imported(tree: ast.AST, package: str) -> set[str]:
    """Full dotted names of everything imported anywhere in the tree, inside functions too."""
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            parts = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            base = ".".join([*parts, *([node.module] if node.module else [])])
            names |= {f"{base}.{alias.name}" for alias in node.names}
    return names


@cache
def imports_of(path: Path) -> frozenset[str]:
    """Full dotted names of everything that a module imports when it runs."""
    package, text = ".".join(("wbmpc", *path.relative_to(SOURCE).parts[:-1])), path.read_text()
    tree = ast.parse(text)
    return frozenset(imported(without_type_checking(tree) if "TYPE_CHECKING" in text else tree, package))


def without_type_checking(tree: ast.Module) -> ast.Module:
    """The module as it runs: blocks for type checkers import nothing."""

    class Cut(ast.NodeTransformer):
        def visit_If(self, node: ast.If) -> ast.AST | None:
            return (
                None
                if ast.unparse(node.test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING")
                else self.generic_visit(node)
            )

    return Cut().visit(tree)  # type: ignore[no-any-return]


def packages_used(path: Path) -> set[str]:
    inside = [n.split(".")[1:] for n in imports_of(path) if n.split(".")[0] == "wbmpc"]
    return {package_of(parts) for parts in inside if parts} - {"__version__"}


def test_every_module_is_in_a_package_of_the_order() -> None:
    assert {owner(p) for p in MODULES} <= set(PACKAGES)


def test_imports_point_upwards() -> None:
    wrong = []
    for path in MODULES:
        own, used = PACKAGES.index(owner(path)), packages_used(path)
        # a public name of the package (``from wbmpc import load_robot``) would hide which package it comes from
        late = sorted(name for name in used if name not in PACKAGES or PACKAGES.index(name) > own)
        if late:
            wrong.append(
                f"{path.relative_to(SOURCE)} is in package '{PACKAGES[own]}' and imports from none or later ones: {late}"
            )
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("library", ONLY_IN)
def test_libraries_are_used_where_they_may(library: str) -> None:
    users = {owner(p) for p in MODULES if library in {n.split(".")[0] for n in imports_of(p)}}
    assert users <= ONLY_IN[library]


def test_protocols_of_bases_name_no_type_of_a_bus_or_a_simulator() -> None:
    """Not even for a type checker: who writes a base type depends on neither."""
    for path in sorted((SOURCE / "bases").glob("*.py")):
        named = imported(ast.parse(path.read_text()), "wbmpc.bases")
        later = {n for n in named if n.startswith(("wbmpc.ros2", "wbmpc.simulation", "wbmpc.view", "wbmpc.cli"))}
        assert not later, f"{path.name}: {sorted(later)}"


def set_in_others(tree: ast.Module) -> list[str]:
    """What a module sets in a module or class that it imports, when it is imported itself: an edge that no import shows."""
    names = {n.rpartition(".")[2] for n in imported(tree, "wbmpc")}
    names |= {
        a.asname for n in ast.walk(tree) if isinstance(n, ast.Import | ast.ImportFrom) for a in n.names if a.asname
    }
    targets = [t for n in tree.body if isinstance(n, ast.Assign) for t in n.targets]
    return [
        ast.unparse(t) for t in targets if isinstance(t, ast.Attribute) and ast.unparse(t).partition(".")[0] in names
    ]


def test_a_module_sets_nothing_in_another() -> None:
    assert not [f"{p.relative_to(SOURCE)}: {t}" for p in MODULES for t in set_in_others(ast.parse(p.read_text()))]


def test_the_check_sees_what_is_set_in_another_module() -> None:
    source = "from wbmpc.bases import base\nfrom a import b as c\nbase.offering = print\nc.d.e = 1\nx = 2\n"
    assert set_in_others(ast.parse(source)) == ["base.offering", "c.d.e"]


def test_an_mpc_knows_no_residual_by_its_class() -> None:
    """What it sets before a solve it finds by protocols of :mod:`wbmpc.ocp.symbols`, so that residuals of users take part."""
    for path in (p for p in MODULES if owner(p) in ("mpc", "solver", "runtime", "embedded")):
        names = {n for n in imports_of(path) if n.startswith("wbmpc.ocp.") and "residuals" in n}
        assert not names, f"{path.relative_to(SOURCE)}: {sorted(names)}"


def commands(tree: ast.Module) -> list[str]:
    """Classes that are controllers: those with a method that makes commands of what is measured or predicted, and what is called so."""
    found = []
    for kind in (n for n in tree.body if isinstance(n, ast.ClassDef)):
        methods = {n.name for n in kind.body if isinstance(n, ast.FunctionDef)}
        if kind.name.endswith("Controller") or ("command" in methods and methods & {"measure", "predict"}):
            found.append(kind.name)
    return found


def test_no_controller_imports_a_simulator() -> None:
    """Those of the studies too: what they know of the simulated world they are given."""
    wrong = {}
    for path in MODULES:
        if commands(ast.parse(path.read_text())):
            used = {n for n in imports_of(path) if re.search(r"^mujoco\b|^wbmpc\.simulation\b|_?plant\b", n)}
            wrong |= {path.relative_to(SOURCE).as_posix(): used} if used else {}
    assert not wrong


def test_the_check_sees_controllers() -> None:
    found = commands(
        ast.parse(
            "class A:\n  def command(self): ...\n  def predict(self): ...\nclass BController(A): ...\nclass C: ..."
        )
    )
    assert found == ["A", "BController"]


def test_only_tests_of_the_solver_know_its_memory() -> None:
    """Who tests something else would hold the solver to today's layout."""
    memory = {"wbmpc.solver.workspace", "wbmpc.solver.memory_layout"}
    tests = Path(__file__).parent
    for path in sorted(p for p in tests.rglob("*.py") if p.parent.name not in ("kernel", "solver")):
        text = path.read_text()
        names = imported(ast.parse(text), "") if re.search("workspace|memory_layout", text) else set()
        assert not {n for n in names if n in memory or n.rpartition(".")[0] in memory}, path.relative_to(tests)


#: Lines of a file and of a function, at most: what a reader takes in at once.
LONGEST_FILE, LONGEST_FUNCTION = 400, 65


def too_long(name: str, text: str) -> list[str]:
    found = [f"{name}: {n} lines"] if (n := text.count("\n")) > LONGEST_FILE else []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            lines = (node.end_lineno or node.lineno) - node.lineno + 1
            found += [f"{name}: {node.name}: {lines} lines"] if lines > LONGEST_FUNCTION else []
    return found


def test_files_and_functions_are_short() -> None:
    assert not [line for p in MODULES for line in too_long(str(p.relative_to(SOURCE)), p.read_text())]


def test_the_check_sees_a_long_file_and_a_long_function() -> None:
    assert too_long("f", "def f():\n" + LONGEST_FUNCTION * "    pass\n") == [f"f: f: {LONGEST_FUNCTION + 1} lines"]
    assert too_long("f", (LONGEST_FILE + 1) * "pass\n") == [f"f: {LONGEST_FILE + 1} lines"]


def test_the_check_sees_a_wrong_import() -> None:
    inside_a_function = (
        "def f():\n    from wbmpc.cli import main\n    import wbmpc.report\n    from ..simulation import world\n"
    )
    assert imported(ast.parse(inside_a_function), "wbmpc.model") == {
        "wbmpc.cli.main",
        "wbmpc.report",
        "wbmpc.simulation.world",
    }


def test_the_architecture_page_lists_the_packages_in_this_order() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text()
    rows = [cells.split("|")[1] for cells in page.splitlines() if re.match(r"\|\s*`[a-z0-9_]+(/TYPE)?(\.py|/)`", cells)]
    listed = [name for row in rows for name in re.findall(r"`([a-z0-9_]+(?:/TYPE)?)(?:\.py|/)`", row)]
    assert listed == [name for name in PACKAGES if name != "__main__"]


CHECK = """
import os, sys
environment, directory = dict(os.environ), set(os.listdir())
import wbmpc, wbmpc.cli, wbmpc.errors, wbmpc.configuration, wbmpc.log, wbmpc.result, wbmpc.report
heavy = [m for m in ('casadi', 'mujoco', 'llvmlite', 'plotly', 'scipy') if m in sys.modules]
assert not heavy, heavy
import wbmpc.experiment, wbmpc.tasks, wbmpc.simulation.lockstep
assert 'scipy' not in sys.modules  # a third of the start of every run
import wbmpc.studies, wbmpc.benchmark
assert dict(os.environ) == environment, set(os.environ.items()) ^ set(environment.items())
assert set(os.listdir()) == directory, os.listdir()
assert 'plotly' not in sys.modules
import threading
assert threading.active_count() == 1
"""


def test_importing_has_no_side_effects(tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "src"), "WBMPC_CACHE_DIR": str(tmp_path / "cache")}
    (tmp_path / "empty").mkdir()
    out = subprocess.run(
        [sys.executable, "-c", CHECK],
        cwd=tmp_path / "empty",
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert (out.returncode, out.stdout, out.stderr) == (0, "", "")
    assert not (tmp_path / "cache").exists()


CONTROLLER = """
import sys
import wbmpc.cli.ros2, wbmpc.ros2.control
from wbmpc.bases import base_type
from wbmpc.model.robot import load_robot
from wbmpc.ros2.settings import settings_of
for name in ('swerve-ur10', 'rezero', 'panda', 'differential-ur10'):
    robot = load_robot(name)
    base_type(robot.description.base.type).ros(robot, settings_of(robot)(), 1.0 / 400.0)
print(*sorted(m for m in sys.modules if m.startswith('wbmpc.simulation') or m == 'wbmpc.experiment'))
"""


def test_a_controller_on_a_bus_loads_no_simulator(tmp_path: Path) -> None:
    """What 'wbmpc ros2 control' imports and makes. MuJoCo itself is there: it reads the robots' files."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "src")}
    out = subprocess.run(
        [sys.executable, "-c", CONTROLLER], env=environment, capture_output=True, text=True, timeout=300
    )
    assert (out.returncode, out.stdout, out.stderr) == (0, "\n", "")


def of_the_machine(text: str) -> list[str]:
    """Functions with a default that is made of the machine when a module is imported: generated pages show it."""
    functions = (n for n in ast.walk(ast.parse(text)) if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef))
    return [
        f.name
        for f in functions
        for default in (*f.args.defaults, *f.args.kw_defaults)
        if default is not None and re.search(r"\b(environ|getenv|cwd|getcwd|home|gettempdir)\b", ast.unparse(default))
    ]


def test_no_default_is_of_the_machine() -> None:
    assert [(p.name, found) for p in MODULES if (found := of_the_machine(p.read_text()))] == []
    assert of_the_machine("def of(a=os.environ, *, b=Path.home()): ...") == ["of", "of"]


def test_every_public_name_exists() -> None:
    import wbmpc

    for name in wbmpc.__all__:
        assert getattr(wbmpc, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        wbmpc.nonsense  # noqa: B018


def test_no_modules_import_each_other_in_a_circle() -> None:
    """Tarjan's strongly connected components of the import graph, imports inside functions included."""
    files = {
        ".".join(("wbmpc", *p.relative_to(SOURCE).with_suffix("").parts)).removesuffix(".__init__"): p for p in MODULES
    }
    graph: dict[str, set[str]] = {}
    for name, path in files.items():
        graph[name] = {n if n in files else n.rpartition(".")[0] for n in imports_of(path)} & set(files)
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    circles: list[list[str]] = []

    def visit(v: str) -> None:
        index[v] = low[v] = len(index)
        stack.append(v)
        for w in graph[v]:
            if w not in index:
                visit(w)
                low[v] = min(low[v], low[w])
            elif w in stack:
                low[v] = min(low[v], index[w])
        if low[v] == index[v]:
            component = stack[stack.index(v) :]
            del stack[stack.index(v) :]
            if len(component) > 1:
                circles.append(sorted(component))

    for name in graph:
        if name not in index:
            visit(name)
    assert not circles

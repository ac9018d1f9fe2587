"""Every metric of every experiment has a definition and its unit. Truth: the names and units in the source of what measures them."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import pytest

from wbmpc.compare import figures_table, table
from wbmpc.experiment import COMMON, defined
from wbmpc.registry import REGISTRY
from wbmpc.result import Metric
from wbmpc.run_files import definition_in
from wbmpc.tasks import EXPERIMENTS as GENERAL
from wbmpc.tasks.definitions import DEFINITIONS

SOURCE = Path(__file__).parents[2] / "src" / "wbmpc"
#: What stands in a name for what is known at run time only.
ANY = "*"
FOLDERS = {"tasks": list(GENERAL), "studies": [name for name in REGISTRY if name not in GENERAL]}
#: Figures of single pushes, which no report shows.
INNER = {"push_once.py"}


def text(node: ast.expr) -> str:
    """A text of the source, with :data:`ANY` for what is filled in."""
    if isinstance(node, ast.JoinedStr):
        return "".join(ANY if isinstance(part, ast.FormattedValue) else text(part) for part in node.values)
    return node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else ANY


def named(tree: ast.AST) -> Iterator[tuple[ast.expr, ast.expr]]:
    """Names with what they stand for: of dicts, of what is put into one."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Dict):
            yield from ((key, value) for key, value in zip(node.keys, node.values, strict=True) if key is not None)
        elif isinstance(node, ast.DictComp):
            yield node.key, node.value
        elif isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Subscript):
            yield node.targets[0].slice, node.value


def metrics_in(path: Path) -> Iterator[tuple[str, str]]:
    """Names and units of the metrics that a file makes."""
    tree = ast.parse(path.read_text())
    for key, value in named(tree):
        if isinstance(value, ast.Call) and isinstance(value.func, ast.Name) and value.func.id == "Metric":
            yield text(key), text(value.args[1])
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "in_both_frames":
            name = text(node.args[0])
            estimated = next((text(word.value) for word in node.keywords if word.arg == "estimated"), "")
            for ending in ("_world", estimated):
                yield (name.format(ending) if "{}" in name else name + ending), text(node.args[3])


def fits(made: str, defined: str) -> bool:
    return fnmatchcase(made, defined) or fnmatchcase(defined, made)


@pytest.mark.parametrize("folder", FOLDERS)
def test_every_metric_has_a_definition_with_its_unit_and_nothing_else_has(folder: str) -> None:
    # studies with a general task have its metrics
    own = [
        REGISTRY[n].definitions for n in FOLDERS[folder] if n in GENERAL or REGISTRY[n].definitions is not DEFINITIONS
    ]
    known = {(n, unit) for definitions in own for n, (unit, _) in definitions.items()}
    made = {
        m
        for p in (SOURCE / folder).rglob("*.py")
        if p.name not in INNER
        for m in metrics_in(p)
        if ANY not in (m[0], m[1])
    }
    assert len(made) > 25
    assert [(n, unit) for n, unit in sorted(made) if not any(fits(n, d) and unit == u for d, u in known)] == []
    general = {(n, unit) for n, (unit, _) in DEFINITIONS.items()} if folder == "studies" else set()
    assert [(d, u) for d, u in sorted(known - general) if not any(fits(n, d) for n, _ in made)] == []


def test_an_experiment_with_definitions_warns_of_a_metric_that_lacks_one() -> None:
    found = {"known": Metric(1.0, "m"), "own": Metric(1.0, "m", definition="its own"), "fell": Metric(0.0, "1")}
    about = {n: m.definition for n, m in defined("task", found, {"kno*": ("m", "what it is")}).items()}
    assert about == {"known": "what it is", "own": "its own", "fell": COMMON["fell"][1]}
    with pytest.warns(UserWarning, match="task: metrics without a definition: other"):
        defined("task", {"other": Metric(1.0, "m")}, {"known": ("m", "what it is")})


def test_tables_of_several_runs_show_the_definition_that_their_files_have() -> None:
    known: dict[str, Any] = {
        "metrics": {"a": {"value": 1.0, "unit": "m"}},
        "targets": {"a": {"definition": "how <far>"}},
    }
    rows = table([{"metrics": known["metrics"]}, known])
    assert 'data-about="how &lt;far&gt;">a<' in figures_table(rows, ["x", "y"], [None, None])
    for broken in ({}, {"targets": 1}, {"targets": {"a": []}}, {"targets": {"a": {"definition": 1}}}):
        assert definition_in(broken, "a") == ""

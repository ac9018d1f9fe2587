"""The mutation command. Truth: a function of two lines, and mutants of it that were written by hand."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

SOURCE = '''
def off(a: float, b: float) -> float:
    """Text."""
    if a < 3.0 and b:
        return max(a - b, 0.0)
    return {"base": a, "odometry": b}["base"]
'''
#: Each of them has to be found.
BY_HAND = ("if a >= 3.0 and b", "if a < 3.0 or b", "if not (a < 3.0 and b)", "max(a + b, 0.0)", "min(a - b, 0.0)",
           "max(0.0, a - b)", "if a < 12.0 and b", "['odometry']")  # fmt: skip


@pytest.fixture(scope="module")
def mutate() -> ModuleType:
    spec = importlib.util.spec_from_file_location("mutate", Path(__file__).parents[1] / "scripts" / "mutate.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["mutate"] = module
    spec.loader.exec_module(module)
    return module


def test_mutants_are_those_by_hand(mutate: ModuleType) -> None:
    found = mutate.mutants(SOURCE)
    for text in BY_HAND:
        assert sum(text in m.source for m in found) >= 1, text
    assert len({m.source for m in found}) == len(found)  # each is another program
    assert all("Text." in m.source and "a: float, b: float" in m.source for m in found)
    assert {m.line for m in mutate.mutants(SOURCE, range(5, 6))} == {5}


def test_targets_are_there(mutate: ModuleType) -> None:
    for files, tests in mutate.TARGETS.values():
        assert all((mutate.ROOT / path).exists() for path in (*files, *tests))

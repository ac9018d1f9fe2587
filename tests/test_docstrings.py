"""What ``help()`` shows of public classes. Truth: their fields, what their methods set, their signatures."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import re
import textwrap
from collections.abc import Iterator

import pytest

import wbmpc as wb

CLASSES = [
    name
    for name in wb.__all__
    if inspect.isclass(getattr(wb, name)) and not issubclass(getattr(wb, name), BaseException)
]


def of_this_package(cls: type) -> list[type]:
    return [c for c in cls.__mro__ if c.__module__.startswith("wbmpc")]


def documentation(cls: type) -> str:
    """Docstrings of a class and of its public bases, which ``help()`` names."""
    return " ".join(c.__doc__ or "" for c in of_this_package(cls) if not c.__name__.startswith("_"))


def attributes(cls: type) -> Iterator[str]:
    """Fields, and what ``__init__`` sets."""
    for c in of_this_package(cls):
        yield from getattr(c, "model_fields", {})
        if dataclasses.is_dataclass(c):
            yield from (f.name for f in dataclasses.fields(c))
        elif "__init__" in vars(c):
            tree = ast.parse(textwrap.dedent(inspect.getsource(c.__init__)))  # type: ignore[misc]
            for node in ast.walk(tree):
                if (
                    isinstance(node, ast.Attribute)
                    and isinstance(node.ctx, ast.Store)
                    and ast.unparse(node.value) == "self"
                ):
                    yield node.attr


def methods(cls: type) -> Iterator[tuple[str, str | None]]:
    """Public methods and properties with their docstrings."""
    for c in of_this_package(cls):
        for name, member in vars(c).items():
            function = (
                getattr(member, "fget", None) or getattr(member, "__func__", None) or getattr(member, "func", member)
            )
            if not name.startswith("_") and inspect.isfunction(function):
                yield name, function.__doc__


@pytest.mark.parametrize("name", CLASSES)
def test_help_shows_every_attribute_and_method(name: str) -> None:
    cls = getattr(wb, name)
    text, properties = documentation(cls), {n for n, _ in methods(cls)}
    named = {a for a in attributes(cls) if not a.startswith("_") and a not in properties}
    assert [a for a in sorted(named) if not re.search(rf"(?<!\w){a}(?!\w)", text)] == []
    assert [n for n, doc in methods(cls) if not doc] == []


@pytest.mark.parametrize("name", [n for n in CLASSES if dataclasses.is_dataclass(getattr(wb, n))])
def test_help_shows_the_shape_of_every_array(name: str) -> None:
    cls = getattr(wb, name)
    arrays = [f.name for f in dataclasses.fields(cls) if re.search(r"ndarray|NDArray|^Array$", str(f.type))]
    assert [a for a in arrays if not re.search(rf"(?<!\w){a}(``)? \(", documentation(cls))] == []

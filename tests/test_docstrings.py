"""What ``help()`` shows of public classes. Truth: their fields, what their methods set, their signatures."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import re
import textwrap
from collections.abc import Iterator

import numpy as np
import pytest

import wbmpc as wb

#: By name, those of public modules as MODULE.NAME.
FOUND = {
    f"{prefix}{name}": thing
    for prefix, module in (
        ("", wb),
        *((f"{n}.", getattr(wb, n)) for n in wb.__all__ if inspect.ismodule(getattr(wb, n))),
    )
    for name, thing in inspect.getmembers(module, inspect.isclass)
    if not name.startswith("_") and name in getattr(module, "__all__", [name])
    if thing.__module__.startswith("wbmpc") and not issubclass(thing, BaseException)
}
CLASSES = list(FOUND)


#: Attributes of residuals whose type says all.
EVIDENT = {"robot", "dynamics"}


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
        for name, member in list(vars(c).items()):
            function = (
                getattr(member, "fget", None) or getattr(member, "__func__", None) or getattr(member, "func", member)
            )
            if not name.startswith("_") and inspect.isfunction(function):
                yield name, function.__doc__


@pytest.mark.parametrize("name", CLASSES)
def test_help_shows_every_attribute_and_method(name: str) -> None:
    cls = FOUND[name]
    text, properties = documentation(cls), {n for n, _ in methods(cls)}
    named = {a for a in attributes(cls) if not a.startswith("_") and a not in properties | EVIDENT}
    assert [a for a in sorted(named) if not re.search(rf"(?<!\w){a}(?!\w)", text)] == []
    assert [n for n, doc in methods(cls) if not doc] == []


@pytest.mark.parametrize("name", [n for n in CLASSES if dataclasses.is_dataclass(FOUND[n])])
def test_help_shows_the_shape_of_every_array(name: str) -> None:
    cls = FOUND[name]
    arrays = [f.name for f in dataclasses.fields(cls) if re.search(r"ndarray|NDArray|^Array$", str(f.type))]
    assert [a for a in arrays if not re.search(rf"(?<!\w){a}(``)? \(", documentation(cls))] == []


#: Numbers without a unit, or with that of what they are of: counts, ratios, tolerances and weights of the solver, figures of any unit.
NO_UNIT = re.compile(
    r"(barrier|cost|equality_bound|feasibility|fraction_to_boundary|gain|goal|high|initial_barrier|initial_state_mismatch|kkt|least|limit_violation|"
    r"limits|max_regularization|min_slack|min_step|mu|paper|rho|scale|delta|slack|softness|tolerance|value|violation|default|share|values|weight)"
)
ARRAY, NUMBER = r"ndarray|NDArray|ArrayLike|\bArray\b", r"^(float|tuple\[float, \.\.\.\])( \| None)?$"
SHAPE, UNIT = r"(``)?\s*\([a-zA-Z0-9 _+*,:`]+\)", r"(``)?(\s*\([^)]*\))?\s*\[[^\]]+\]"


def quantities(cls: type) -> Iterator[tuple[str, str, str]]:
    """Name, annotation and documentation of public attributes and of arguments of public methods."""
    text = documentation(cls)
    for c in of_this_package(cls):
        for name, annotation in inspect.get_annotations(c).items():
            if not name.startswith("_"):
                yield name, str(annotation), text
        for name, member in list(vars(c).items()):
            function = getattr(member, "fget", None) or getattr(member, "__func__", member)
            if not inspect.isfunction(function) or (name.startswith("_") and name != "__init__"):
                continue
            own = f"{function.__doc__} {text}"
            for argument in inspect.signature(function).parameters.values():
                yield argument.name, str(argument.annotation), own


def unsaid(cls: type) -> set[str]:
    """Arrays whose shape, and numbers whose unit, is nowhere in the documentation."""
    found = set()
    for name, annotation, text in quantities(cls):
        after = lambda pattern, name=name, text=text: re.search(rf"(?<!\w){name}{pattern}", text)
        if re.search(ARRAY, annotation) and not annotation.startswith("Mapping") and not after(SHAPE):
            found.add(name)
        if re.search(NUMBER, annotation) and not NO_UNIT.fullmatch(name) and not after(UNIT):
            found.add(name)
    return found


@pytest.mark.parametrize("name", CLASSES)
def test_help_says_shapes_and_units(name: str) -> None:
    assert unsaid(FOUND[name]) == set()


def test_a_missing_shape_or_unit_is_found() -> None:
    class Silent(wb.Log):
        """``speed`` (n,) [m/s], ``mass``, ``force`` [N]; ``torque`` [N m]."""

        speed: np.ndarray
        mass: float
        force: np.ndarray
        torque: float

    Silent.__module__ = "wbmpc.silent"
    assert unsaid(Silent) == {"mass", "force"}

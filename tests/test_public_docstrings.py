"""Docstrings of public names say what every argument is, and every public method has one. Truth: the signatures."""

from __future__ import annotations

import enum
import inspect
from typing import Any

import pytest

import wbmpc as wb

#: Arguments whose type says all.
PLAIN = {"robot", "dynamics", "ocp", "mpc", "timing", "group", "groups", "other", "args", "kwargs"}
NAMES = [name for name in wb.__all__ if inspect.isclass(getattr(wb, name)) or inspect.isfunction(getattr(wb, name))]


def lacking(thing: Any) -> list[str]:
    """Arguments that no docstring of a function or class (and of those it derives from) names; methods without a docstring."""
    methods = (
        []
        if inspect.isfunction(thing)
        else [k for k in vars(thing) if not k.startswith("_") and _undocumented(vars(thing)[k])]
    )
    if inspect.isclass(thing) and issubclass(thing, (Exception, enum.Enum)):
        return methods
    owners = [c for c in thing.__mro__ if c is not object] if inspect.isclass(thing) else [thing]
    text = " ".join(f"{o.__doc__} {o.__init__.__doc__ if inspect.isclass(o) else ''}" for o in owners)
    return [*methods, *(p for p in inspect.signature(thing).parameters if p not in PLAIN and p not in text)]


def _undocumented(member: Any) -> bool:
    function = member.fget if isinstance(member, property) else getattr(member, "__func__", member)
    return inspect.isfunction(function) and not function.__doc__


@pytest.mark.parametrize("name", NAMES)
def test_a_public_name_says_what_its_arguments_are(name: str) -> None:
    assert not lacking(getattr(wb, name))


def test_what_is_not_said_is_found() -> None:
    def undocumented(weight: float) -> None:
        """Nothing of its argument."""

    class Silent:
        """A class."""

        def method(self) -> None: ...

    assert lacking(undocumented) == ["weight"] and lacking(Silent) == ["method"]

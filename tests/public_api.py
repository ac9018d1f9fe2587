"""The public names of ``wbmpc`` with their signatures, as tests/public_api.txt keeps them.

After a change that is meant: ``python tests/public_api.py`` rewrites the file.
"""

from __future__ import annotations

import inspect
import re
from pathlib import Path
from types import ModuleType
from typing import Any

import wbmpc as wb

FILE = Path(__file__).with_suffix(".txt")


def listing() -> str:
    """Every name of ``wb.__all__`` in order, with what can be called, read or set on it."""
    return "".join(_entry(name, getattr(wb, name)) for name in sorted(wb.__all__) if name != "__version__")


def _entry(name: str, thing: Any) -> str:
    if isinstance(thing, ModuleType):
        members = {
            n: t
            for n, t in vars(thing).items()
            if getattr(t, "__module__", "").startswith(thing.__name__.rpartition(".")[0])
        }
        own = {
            n: t for n, t in members.items() if not n.startswith("_") and (inspect.isclass(t) or inspect.isfunction(t))
        }
        return "".join(f"{name}.{n}{_signature(t)}\n" for n, t in sorted(own.items()))
    lines = [f"{name}{_signature(thing)}"]
    if inspect.isclass(thing) and not issubclass(thing, BaseException):
        lines += [f"    {n}{_member(m)}" for n, m in sorted(_members(thing).items())]
    return "\n".join(lines) + "\n"


def _members(cls: type) -> dict[str, Any]:
    """Public methods and properties, and those of base classes of this package."""
    own = [c for c in reversed(cls.__mro__) if c.__module__.startswith("wbmpc")]
    found = {n: m for c in own for n, m in vars(c).items() if not n.startswith("_") or n == "__call__"}
    kinds = (staticmethod, classmethod, property)
    return {n: m for n, m in found.items() if inspect.isfunction(m) or isinstance(m, kinds)}


def _member(member: Any) -> str:
    if isinstance(member, property):
        return f" -> {inspect.signature(member.fget).return_annotation}" if member.fget else ""
    return _signature(getattr(member, "__func__", member))


def _signature(thing: Any) -> str:
    try:
        text = re.sub(r" at 0x[0-9a-f]+", "", str(inspect.signature(thing)).replace("'", ""))
        return re.sub(
            r"\b(ge|gt|le|lt)=(-?\d+)\.0\)", r"\1=\2)", text
        )  # 1 or 1.0: as the first of equal types was written
    except ValueError:
        return ""


if __name__ == "__main__":
    FILE.write_text(listing())

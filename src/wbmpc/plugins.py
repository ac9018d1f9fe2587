"""What installed packages offer by entry points, so that nothing here has to name them."""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import entry_points
from typing import Any

from wbmpc.errors import InputError

#: The distribution whose names others cannot take.
OWN = "wbmpc"


def offered(group: str) -> dict[str, str]:
    """Name -> "module:attribute" of the entry points of a group: those of this distribution by name, then those of others by name. Nothing
    is imported."""
    points = sorted(entry_points(group=group), key=lambda p: (p.dist is None or p.dist.name != OWN, p.name))
    found: dict[str, str] = {}
    for point in points:
        found.setdefault(point.name, point.value)
    return found


def load(value: str, what: str) -> Any:
    """The attribute of "module:attribute". Raises :class:`InputError` that begins with ``what`` if it cannot be imported."""
    module, _, attribute = value.partition(":")
    try:
        return getattr(import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        raise InputError(f"{what} {value} cannot be imported: {error}") from error

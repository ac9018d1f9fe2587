"""Base types: one table of plug-ins. A base type is a folder here, or another package with an entry point.

``base_type(name)`` gives the plug-in of a robot file's ``base.type``. What generic code may ask of it is in
:mod:`wbmpc.bases.base`. A package adds a base type through the entry-point group ``wbmpc.bases``::

    [project.entry-points."wbmpc.bases"]
    tracked = "my_package.tracked:TrackedBaseType"
"""

from __future__ import annotations

from functools import cache, partial
from typing import Any

import wbmpc.mujoco_start  # noqa: F401  (before others import MuJoCo)
from wbmpc import plugins
from wbmpc.bases.base import PARTS, BaseType, MissingPart
from wbmpc.errors import InputError, unknown_name

GROUP = "wbmpc.bases"
#: Name in a robot file -> "module:attribute" of its plug-in, imported when it is first asked for.
TABLE: dict[str, str] = {
    "fixed": "wbmpc.bases.fixed.plugin:FixedBaseType",
    "differential": "wbmpc.bases.differential.plugin:DifferentialBaseType",
    "omnidirectional": "wbmpc.bases.omnidirectional.plugin:OmnidirectionalBaseType",
    "wheels": "wbmpc.bases.wheels.plugin:WheelsBaseType", "planar": "wbmpc.bases.planar.plugin:MobileBaseType",
    "swerve": "wbmpc.bases.swerve.plugin:SwerveBaseType", "ball": "wbmpc.bases.ball.plugin:BallBaseType",
}  # fmt: skip


@cache
def _locations() -> dict[str, str]:
    """The table and the entry points of installed packages. A built-in name cannot be replaced."""
    return {**plugins.offered(GROUP), **TABLE}


def available_base_types() -> list[str]:
    """Names that ``base.type`` of a robot file may have."""
    return sorted(_locations())


@cache
def base_type(name: str) -> BaseType:
    """The plug-in of a base type. Raises :class:`InputError` for a name that no table has, or a plug-in that cannot be imported.

    A part that a plug-in leaves out raises :class:`InputError` when it is called, as in :class:`wbmpc.bases.base.BaseType`.
    """
    locations = _locations()
    if name not in locations:
        raise unknown_name("base type", name, sorted(locations))
    plug_in = plugins.load(locations[name], f"base type '{name}': its plug-in")
    with plugins.mistakes_of(f"base type '{name}': its plug-in {locations[name]} cannot be made"):
        made: BaseType = plug_in()
    for part in PARTS:
        if not _defines(type(made), part):
            object.__setattr__(made, part, partial(_inherited, made, part))  # a frozen plug-in too
    return made


def _inherited(plug_in: BaseType, part: str, *args: Any, **named: Any) -> Any:
    """What a plug-in that leaves a part out does. The error names the base types that define the part."""
    try:
        return getattr(BaseType, part)(plug_in, *args, **named)
    except MissingPart as error:
        raise InputError(f"{error}; valid: {', '.join(offering(part)) or 'no base type that is installed'}") from None


def offering(part: str) -> list[str]:
    """Names of the base types that define a part of the plug-in; those of packages that cannot be imported are left out."""
    found = []
    for name in available_base_types():
        try:
            found += [name] if offers(name, part) else []
        except InputError:
            continue
    return found


def offers(name: str, part: str) -> bool:
    """Whether the base type ``name`` defines a ``part`` of the plug-in (:data:`wbmpc.bases.base.PARTS`). Raises :class:`InputError` as
    :func:`base_type`."""
    return _defines(type(base_type(name)), part)


def _defines(kind: type[BaseType], part: str) -> bool:
    return getattr(kind, part, None) not in (None, getattr(BaseType, part))

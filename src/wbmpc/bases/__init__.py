"""Base types: one table of plug-ins. A base type is a folder here, or another package with an entry point.

``base_type(name)`` gives the plug-in of a robot file's ``base.type``. What generic code may ask of it is in
:mod:`wbmpc.bases.base`. A package adds a base type through the entry-point group ``wbmpc.bases``::

    [project.entry-points."wbmpc.bases"]
    tracked = "my_package.tracked:TrackedBaseType"
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import cache, partial
from typing import Any, TypeVar

import wbmpc.mujoco_start  # noqa: F401  (before others import MuJoCo)
from wbmpc import plugins
from wbmpc.bases.base import PARTS, BaseDescription, BaseType, MissingPart
from wbmpc.errors import InputError, unknown_name

GROUP = "wbmpc.bases"
_LOG = logging.getLogger("wbmpc")
_Answer = TypeVar("_Answer")
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
        if not (isinstance(made.Description, type) and issubclass(made.Description, BaseDescription)):
            raise InputError("its 'Description' is no wb.BaseDescription")
    for part in PARTS:
        if not _defines(type(made), part):
            object.__setattr__(made, part, partial(_inherited, made, part))  # a frozen plug-in too
    return made


def base_type_in_use(name: str) -> BaseType:
    """:func:`base_type`, of a robot that what runs is made of: what fails from then on may be the plug-in's mistake."""
    made = base_type(name)
    plugins.note_use(f"base type '{name}'", _locations()[name])
    return made


def answers(ask: Callable[[str], _Answer]) -> dict[str, _Answer]:
    """``ask(name)`` for all base types. Those of packages that cannot be imported are left out; one of another package that fails is left
    out with a warning: it does not concern the robots of others."""
    found = {}
    for name in available_base_types():
        try:
            base_type(name)
        except InputError:
            continue
        if plugins.is_own(_locations()[name]):
            found[name] = ask(name)
            continue
        try:
            with plugins.mistakes_of(_locations()[name]):
                found[name] = ask(name)
        except InputError as error:
            _LOG.warning("base type '%s' of another package is left out: %s", name, error)
    return found


def _inherited(plug_in: BaseType, part: str, *args: Any, **named: Any) -> Any:
    """What a plug-in that leaves a part out does. The error names the base types that define the part."""
    try:
        return getattr(BaseType, part)(plug_in, *args, **named)
    except MissingPart as error:
        raise InputError(f"{error}; valid: {', '.join(offering(part)) or 'no base type that is installed'}") from None


def offering(part: str) -> list[str]:
    """Names of the base types that define a part of the plug-in; those of packages that cannot be imported are left out."""
    return [name for name, offered in answers(lambda name: offers(name, part)).items() if offered]


def offers(name: str, part: str) -> bool:
    """Whether the base type ``name`` defines a ``part`` of the plug-in (:data:`wbmpc.bases.base.PARTS`). Raises :class:`InputError` as
    :func:`base_type`."""
    return _defines(type(base_type(name)), part)


def _defines(kind: type[BaseType], part: str) -> bool:
    return getattr(kind, part, None) not in (None, getattr(BaseType, part))

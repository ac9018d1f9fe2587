"""Settings models as tables: keys, types with their ranges, defaults and what each key means."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic_core import PydanticUndefined


@dataclass(frozen=True)
class Row:
    """A setting: its dotted ``key``, ``kind`` (type and range), ``default``, the ``unit`` and ``help`` that the docstring of its model
    has for it ("" where it has none), and the ``choice`` that it belongs to ("" for all): a key may be there once for each choice."""

    key: str
    kind: str
    default: str
    unit: str = ""
    help: str = ""
    choice: str = ""


def rows(model: type[BaseModel], prefix: str = "", values: BaseModel | None = None) -> Iterator[Row]:
    """Every field but a kind that is the only one; ``values``: an instance whose values are the defaults."""
    texts = _texts(model)
    for name, info in model.model_fields.items():
        value = info.get_default(call_default_factory=True) if values is None else getattr(values, name)
        kinds = _kinds(info.annotation)
        if kinds:
            # the chosen one last: its values are the defaults of keys that several have
            ordered = [*(m for m in kinds if m is not type(value)), *(m for m in kinds if m is type(value))]
            chosen = ", ".join(f"`{k}`" for m in kinds for k in _kind_names(m))
            yield Row(f"{prefix}{name}.kind", chosen, f"`{value.kind}`", *texts.get(name, ("", "")))
            yield from _of_kinds(f"{prefix}{name}", ordered, value)
        elif name == "kind" and len(get_args(info.annotation)) == 1:
            continue
        elif isinstance(value, BaseModel):
            yield from rows(type(value), f"{prefix}{name}.", value)
        else:
            bounds = ", ".join(_bound(m) for m in info.metadata if _bound(m))
            kind = _kind(info.annotation) + (f", {bounds}" if bounds else "")
            yield Row(prefix + name, kind, _default(value), *texts.get(name, ("", "")))


def _of_kinds(section: str, models: list[type[BaseModel]], value: BaseModel) -> Iterator[Row]:
    """The settings of a section that is one of several models, of which the last one is chosen."""
    found: dict[Row, list[type[BaseModel]]] = {}
    for model in models:
        for row in rows(model, f"{section}.", value if type(value) is model else None):
            if row.key != f"{section}.kind":
                found.setdefault(row, []).append(model)
    for row, owners in sorted(found.items(), key=lambda item: models[-1] in item[1]):
        names = ", ".join(k for m in owners for k in _kind_names(m))
        yield row if row.choice or len(owners) == len(models) else replace(row, choice=f"{section}={names}")


def _texts(model: type[BaseModel]) -> dict[str, tuple[str, str]]:
    """(unit, help) of fields by what the docstrings of the model and its bases say of ````name`` [unit]: text;``."""
    found: dict[str, tuple[str, str]] = {}
    kinds = [kind for kind in model.__mro__ if kind is not BaseModel]
    # what a colon follows explains it; else a text that mentions it has to do
    for colon, kind in product((":", ""), kinds):
        text = " ".join((kind.__doc__ or "").split())
        for name in model.model_fields:
            place = re.search(rf"``{name}``(?:\s*\[(?P<unit>[^\]]*)\])?{colon}", text)
            if place and name not in found:
                # what stands before a name with a colon is of other settings
                said = _clause(text[place.end() :], 0).strip() if colon else _clause(text, place.start())
                found[name] = (place["unit"] or "", re.sub(rf"^{name}( \[[^\]]*\])? (?=\w)", "", said))
    return found


def _clause(text: str, place: int) -> str:
    """The clause around a place: from the last end of one to the next, by semicolons and full stops."""
    begin = max([m.end() for m in re.finditer(r"[.;]\s", text[:place])], default=0)
    end = re.search(r"[.;](\s|$)", text[place:])
    clause = text[begin : place + end.start()] if end else text[begin:]
    return re.sub(r":\w+:`~?([^`]*)`", r"\1", clause).replace("``", "")


def _kinds(annotation: Any) -> list[type[BaseModel]]:
    """The models of a setting that is one of several, selected by their ``kind``."""
    inner = get_args(get_args(annotation)[0]) if get_origin(annotation) is Annotated else get_args(annotation)
    models = [m for m in inner if isinstance(m, type) and issubclass(m, BaseModel)]
    return models if len(models) > 1 else []


def _kind_names(model: type[BaseModel]) -> tuple[str, ...]:
    return get_args(model.model_fields["kind"].annotation)


def _kind(annotation: Any) -> str:
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        bounds = ", ".join(filter(None, (_bound(m) for m in inner[1:])))
        return _kind(inner[0]) + (f", {bounds}" if bounds else "")
    if origin is Literal:
        return ", ".join(f"`{v}`" for v in inner)
    if origin in (Union, UnionType):
        return " or ".join(dict.fromkeys(_kind(a) for a in inner))
    if origin is dict:
        return f"by name (KEY.NAME): {_kind(inner[1])}"
    if origin is not None:
        return f"{origin.__name__} of " + ", ".join(dict.fromkeys(_kind(a) for a in inner if a is not Ellipsis))
    return {"NoneType": "none", "str": "text", "float": "number", "int": "integer", "bool": "true, false"}.get(
        getattr(annotation, "__name__", ""), getattr(annotation, "__name__", "any")
    )


def _bound(meta: Any) -> str:
    signs = {"ge": "≥", "gt": ">", "le": "≤", "lt": "<"}
    found = [f"{sign} {getattr(meta, key):g}" for key, sign in signs.items() if getattr(meta, key, None) is not None]
    inner = [_bound(m) for m in getattr(meta, "metadata", ())]
    return ", ".join(filter(None, found + inner))


def _default(value: Any) -> str:
    if value is PydanticUndefined:
        return "required"
    shown = str(value)
    return f"`{shown}`" if len(shown) <= 60 and shown else "empty" if not shown else "see the model"

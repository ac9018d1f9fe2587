"""What is wrong in a robot file, in words that name its keys. ``root``: the model of the whole file."""

from __future__ import annotations

from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from wbmpc.bases import base_type
from wbmpc.errors import InputError, unknown_name


def first_fault(error: ValidationError, data: dict[str, Any], root: type[BaseModel]) -> str:
    """The first fault of a validation in plain words, without web links, and how many more there are.

    A key that is not known comes before one that is missing: it is usually that key, mistyped.
    """
    faults = error.errors(include_url=False)
    fault = min(faults, key=lambda f: f["type"] != "extra_forbidden")
    path = _section(fault["loc"], data, root)[0] or ["?"]
    more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
    key = ".".join(path)
    if fault["type"] == "extra_forbidden":
        model = _section(fault["loc"][:-1], data, root)[1]
        reason = getattr(model, "not_applicable", {}).get(path[-1])
        if reason:
            return f"key '{key}': {reason}{more}"
        return str(unknown_name("key", key, keys(model, ".".join(path[:-1])))) + more
    if not fault["loc"]:  # of keys together: the message names them
        return fault["msg"].removeprefix("Value error, ") + more
    if fault["type"] == "base_type":
        return f"key '{key}.type': {fault['msg']}{more}"
    if fault["type"] == "union_tag_invalid":
        valid = fault["ctx"]["expected_tags"].replace("'", "")
        return f"key '{key}.kind': valid: {valid}, got '{fault['ctx']['tag']}'{more}"
    if fault["type"] == "union_tag_not_found":
        return f"key '{key}.kind': field required{more}"
    got = "" if fault["type"] == "missing" or isinstance(fault["input"], dict) else f", got {fault['input']!r:.80}"
    text = fault["msg"].removeprefix("Value error, ")
    return f"key '{key}': {text[0].lower()}{text[1:]}{got}{more}"


def reject_truths(
    value: Any, where: Path, data: dict[str, Any], root: type[BaseModel], location: tuple[int | str, ...] = ()
) -> None:
    """Raise :class:`InputError` for true or false (YAML: yes, on, no, off) where a file needs a number or a name: Python takes them
    for 1 and 0."""
    if isinstance(value, bool):
        field = _section(location[:-1], data, root)[1].model_fields.get(str(location[-1]))
        if field is None or field.annotation is not bool:
            key = ".".join(str(k) for k in location)
            raise InputError(f"{where}: key '{key}': a number or text is needed, not true or false")
    inside = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for name, inner in inside:
        reject_truths(inner, where, data, root, (*location, name))


def _section(
    location: tuple[int | str, ...], data: dict[str, Any], root: type[BaseModel]
) -> tuple[list[str], type[BaseModel]]:
    """The keys of a location of a robot file, without the kinds that pydantic puts between them, and the model of the last mapping that
    is known."""
    path, model, kinds = list[str](), root, dict[str, type[BaseModel]]()
    for key in location:
        if key in kinds:
            model, kinds = kinds[key], {}
            continue
        path.append(str(key))
        if isinstance(key, str):
            field = model.model_fields.get(key)
            found = [_base_model(data)] if model is root and key == "base" else _models_of(field and field.annotation)
            model = found[0] if found else model
            several = [m for m in found if "kind" in m.model_fields] if len(found) > 1 else []
            kinds = {k: m for m in several for k in get_args(m.model_fields["kind"].annotation)}
    return path, model


def _base_model(data: dict[str, Any]) -> type[BaseModel]:
    """The model of the base, before its own check: YAML's ``yes`` is no type."""
    try:
        return base_type(str(data["base"]["type"])).Description
    except (KeyError, TypeError, InputError):
        return BaseModel


def _models_of(annotation: Any) -> list[type[BaseModel]]:
    """The models that a field holds, itself or in a tuple; none of plain values."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [m for part in get_args(annotation) for m in _models_of(part)]


def keys(model: type[BaseModel], prefix: str) -> list[str]:
    """The valid keys of a section, with its dotted prefix."""
    names = [n for n in model.model_fields if n != "source"]
    return [f"{prefix}.{n}" if prefix else n for n in names]

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
    path = [str(k) for k in fault["loc"]] or ["?"]
    more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
    key = ".".join(path)
    if fault["type"] == "extra_forbidden":
        model = _section(fault["loc"][:-1], data, root)
        reason = getattr(model, "not_applicable", {}).get(path[-1])
        if reason:
            return f"key '{key}': {reason}{more}"
        return str(unknown_name("key", key, keys(model, ".".join(path[:-1])))) + more
    if not fault["loc"]:  # of keys together: the message names them
        return fault["msg"].removeprefix("Value error, ") + more
    if fault["type"] == "base_type":
        return f"key '{key}.type': {fault['msg']}{more}"
    got = "" if fault["type"] == "missing" or isinstance(fault["input"], dict) else f", got {fault['input']!r:.80}"
    text = fault["msg"].removeprefix("Value error, ")
    return f"key '{key}': {text[0].lower()}{text[1:]}{got}{more}"


def reject_truths(
    value: Any, where: Path, data: dict[str, Any], root: type[BaseModel], location: tuple[int | str, ...] = ()
) -> None:
    """Raise :class:`InputError` for true or false (YAML: yes, on, no, off) where a file needs a number or a name: Python takes them
    for 1 and 0."""
    if isinstance(value, bool):
        try:
            field = _section(location[:-1], data, root).model_fields.get(str(location[-1]))
        except (KeyError, TypeError, InputError):  # beside keys that are not known either
            field = None
        if field is None or field.annotation is not bool:
            key = ".".join(str(k) for k in location)
            raise InputError(f"{where}: key '{key}': a number or text is needed, not true or false")
    inside = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for name, inner in inside:
        reject_truths(inner, where, data, root, (*location, name))


def _section(location: tuple[int | str, ...], data: dict[str, Any], root: type[BaseModel]) -> type[BaseModel]:
    """The model of the mapping at a location of a robot file."""
    model = root
    for key in location:
        if not isinstance(key, str):
            continue
        if model is root and key == "base":
            model = base_type(str(data["base"]["type"])).Description  # before its own check: YAML's ``yes`` is none
        else:
            model = _model_of(model.model_fields[key].annotation) or model
    return model


def _model_of(annotation: Any) -> type[BaseModel] | None:
    """The model that a field holds, itself or in a tuple; None for plain values."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((m for m in map(_model_of, get_args(annotation)) if m is not None), None)


def keys(model: type[BaseModel], prefix: str) -> list[str]:
    """The valid keys of a section, with its dotted prefix."""
    names = [n for n in model.model_fields if n != "source"]
    return [f"{prefix}.{n}" if prefix else n for n in names]

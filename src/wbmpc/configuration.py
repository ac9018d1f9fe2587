"""Settings from dotted keys: ``mpc.rate=100`` onto a nested pydantic model, one clear sentence for each fault."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, get_args

import yaml
from pydantic import BaseModel, ValidationError

from wbmpc.errors import InputError, unknown_name


def _model_of(annotation: Any) -> type[BaseModel] | None:
    for candidate in (annotation, *get_args(annotation)):
        if isinstance(candidate, type) and issubclass(candidate, BaseModel):
            return candidate
    return None


def keys(model: type[BaseModel], prefix: str = "") -> list[str]:
    """All dotted keys of a nested model."""
    out = []
    for name, info in model.model_fields.items():
        inner = _model_of(info.annotation)
        out += keys(inner, f"{prefix}{name}.") if inner else [f"{prefix}{name}"]
    return out


def _parse(assignment: str) -> tuple[str, Any]:
    key, equals, text = assignment.partition("=")
    if not equals or not key.strip():
        raise InputError(f"--set {assignment}: the form is key=value, e.g. mpc.rate=100")
    try:
        return key.strip(), yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise InputError(f"--set {key}: the value '{text}' cannot be read") from error


def _insert(tree: dict[str, Any], key: str, value: Any) -> None:
    *parents, last = key.split(".")
    for parent in parents:
        tree = tree.setdefault(parent, {})
    tree[last] = value


def describe(error: ValidationError) -> str:
    """All faults of a validation as one sentence, without web links."""
    faults = []
    for fault in error.errors(include_url=False):
        key = ".".join(str(k) for k in fault["loc"])
        faults.append(f"{key}={fault['input']!r}: {fault['msg'][0].lower()}{fault['msg'][1:]}")
    return "; ".join(faults)


def configure(model: type[BaseModel], assignments: Iterable[str], where: str) -> Any:
    """An instance of ``model`` with its defaults and the given ``key=value`` assignments.

    Raises :class:`InputError` naming ``where`` (the experiment), the key and the valid choices.
    """
    valid, defaults = keys(model), model().model_dump()
    for assignment in assignments:
        key, value = _parse(assignment)
        if key not in valid:
            raise unknown_name("key", key, valid, where=f"{where}: --set")
        _insert(defaults, key, value)
    try:
        return model.model_validate(defaults)
    except ValidationError as error:
        raise InputError(f"{where}: --set {describe(error)}") from error

"""Settings from dotted keys: ``mpc.rate=100`` onto a nested pydantic model, one clear message for each fault."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from contextlib import suppress
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from wbmpc.errors import InputError, did_you_mean
from wbmpc.yaml_file import parse_yaml


class OnlyWith:
    """Beside a setting's type: which choices of other settings read it, one of them is enough. Changed without any of them, the
    setting is an error (:func:`reject_unread`)::

        amplitude: Annotated[float, OnlyWith(variant=("horizontal", "vertical"))] = 0.5
    """

    def __init__(self, **choices: Any) -> None:
        self.choices = {name: value if isinstance(value, tuple) else (value,) for name, value in choices.items()}

    def reads(self, settings: BaseModel) -> bool:
        """Whether one of the choices is made."""
        return any(getattr(settings, name) in values for name, values in self.choices.items())

    def __str__(self) -> str:
        text = lambda value: str(value).lower() if isinstance(value, bool) else str(value)
        return " or ".join(f"{name}={text(value)}" for name, values in self.choices.items() for value in values)


def reject_unread(settings: BaseModel) -> None:
    """Raise :class:`ValueError` for the first setting that is not its default and that nothing reads, see :class:`OnlyWith`."""
    for name, info in type(settings).model_fields.items():
        for rule in (m for m in info.metadata if isinstance(m, OnlyWith)):
            if getattr(settings, name) != info.default and not rule.reads(settings):
                raise ValueError(f"{name}: nothing uses it without {rule}")


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


def _unknown(key: str, valid: list[str], where: str) -> InputError:
    """The error for a key that does not exist: lists the section that was meant, not all fifty keys."""
    section = key
    while section and not any(k.startswith(f"{section}.") for k in valid):
        section = section.rpartition(".")[0]
    inside = [k[len(section) + 1 :] if section else k for k in valid if not section or k.startswith(f"{section}.")]
    choices = dict.fromkeys(f"{k.split('.')[0]}.…" if "." in k else k for k in inside)
    place = f"valid in {section}" if section else "valid"
    if key == section:
        return InputError(f"{where}: --set: '{key}' is a section and takes no value; {place}: {', '.join(choices)}")
    # a key of the right name in the wrong section is nearer than its letters say
    elsewhere = [k for k in valid if k.split(".")[-1] == key.split(".")[-1]]
    hint = f" (did you mean '{elsewhere[0]}'?)" if elsewhere else did_you_mean(key, valid)
    return InputError(f"{where}: --set: unknown key '{key}'{hint}; {place}: {', '.join(choices)}")


def _finite(value: Any) -> bool:
    if isinstance(value, Mapping):
        return all(map(_finite, value.values()))
    if isinstance(value, (list, tuple)):
        return all(map(_finite, value))
    if isinstance(value, str):
        # YAML reads nan, inf and 1e3 as text; pydantic would make numbers of them
        try:
            value = float(value)
        except ValueError:
            return True
    return not isinstance(value, float) or math.isfinite(value)


def _parse(assignment: str, where: str) -> tuple[str, Any]:
    key, equals, text = assignment.partition("=")
    if not equals or not key.strip() or not text.strip():
        raise InputError(f"{where}: --set '{assignment}': the form is key=value, e.g. mpc.rate=100")
    value = parse_yaml(text, f"{where}: --set {key.strip()}={text.strip()[:80]}")
    if not _finite(value):
        raise InputError(f"{where}: --set {key.strip()}={text.strip()}: the value must be a finite number")
    return key.strip(), _numbers(value)


def _numbers(value: Any) -> Any:
    """Text that is a number as that number: YAML 1.1 reads 8e-1 as text."""
    if isinstance(value, list):
        return [_numbers(v) for v in value]
    if isinstance(value, str):
        with suppress(ValueError):
            return float(value)
    return value


def _types(model: type[BaseModel], key: str) -> tuple[Any, ...]:
    """The types in the annotation of a dotted key."""
    *parents, last = key.split(".")
    for parent in parents:
        model = _model_of(model.model_fields[parent].annotation) or model
    annotation = model.model_fields[last].annotation
    return (annotation, *get_args(annotation))


def _truths(value: Any) -> bool:
    """Whether a value is, or holds, true or false."""
    return any(map(_truths, value)) if isinstance(value, list) else isinstance(value, bool)


def _insert(tree: dict[str, Any], key: str, value: Any) -> None:
    """Put ``value`` in its place. A section that is left out by default begins empty: its model knows what else is in it."""
    *parents, last = key.split(".")
    for parent in parents:
        if tree.get(parent) is None:
            tree[parent] = {}
        tree = tree[parent]
    tree[last] = value


def describe(error: ValidationError) -> str:
    """All faults of a validation as one message, without web links: ``key=value: what is wrong; ...``."""
    faults, found = [], error.errors(include_url=False, include_context=False)
    for fault in found:
        place = fault["loc"]
        if fault["type"] == "too_short" and any(f["loc"][: len(place)] == place != f["loc"] for f in found):
            continue  # what is left when its bad entries are taken away
        key = ".".join(str(k) for k in fault["loc"])
        # a fault between several settings carries its whole section, and a missing one has no value of its own
        shown = (
            ""
            if isinstance(fault["input"], (Mapping, BaseModel)) or fault["type"] == "missing"
            else f"={fault['input']!r}"
        )
        if fault["type"] == "tuple_type":
            example = "names in brackets are needed, e.g. [one, other]"
            if not isinstance(fault["input"], str):
                example = "numbers in brackets are needed, e.g. [0.6, 0.9]"
            faults.append(f"{key}{shown}: several {example}")
            continue
        text = fault["msg"].removeprefix("Value error, ").removeprefix("Assertion failed, ")
        faults.append(f"{key}{shown}: {text[:1].lower()}{text[1:]}".removeprefix(": "))
    return "; ".join(faults)


def configure(model: type[BaseModel], assignments: Iterable[str], where: str) -> Any:
    """An instance of ``model`` with its defaults and the given ``key=value`` assignments (a later one wins).

    Values are written as in YAML: ``100``, ``true``, ``[0.6, 0.9]``.
    Raises :class:`InputError` naming ``where`` (the experiment), the key and the valid choices.
    """
    valid, settings = keys(model), model().model_dump()
    for assignment in assignments:
        key, value = _parse(assignment, where)
        if key not in valid:
            raise _unknown(key, valid, where)
        if _truths(value) and bool not in _types(model, key):
            raise InputError(f"{where}: --set {assignment.strip()}: a number or text is needed, not true or false")
        _insert(settings, key, value)
    try:
        return model.model_validate(settings)
    except ValidationError as error:
        raise InputError(f"{where}: --set {describe(error)}") from error


def reject_truths(model: type[BaseModel], data: Any) -> Any:
    """``data`` of a model, unless it has true or false (YAML: yes, on, no, off) where a field needs a number or a text: Python
    takes them for 1 and 0. Raises ``ValueError`` with the field. Models inside check themselves."""
    for name, value in data.items() if isinstance(data, dict) else ():
        field = model.model_fields.get(name)
        kinds = () if field is None else (field.annotation, *get_args(field.annotation))
        checked = any(k in (bool, Any) or (isinstance(k, type) and issubclass(k, BaseModel)) for k in kinds)
        if field is not None and not checked and _has_truth(value):
            raise ValueError(f"{name}: a number or text is needed, not true or false")
    return data


def _has_truth(value: Any) -> bool:
    inside = value.values() if isinstance(value, dict) else value if isinstance(value, list | tuple) else ()
    return isinstance(value, bool) or any(_has_truth(inner) for inner in inside)

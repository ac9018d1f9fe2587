"""Settings from dotted keys: ``mpc.rate=100`` onto a nested pydantic model, one clear message for each fault."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from contextlib import AbstractContextManager, nullcontext, suppress
from functools import reduce
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args, get_origin

from pydantic import BaseModel, BeforeValidator, Field, ValidationError

from wbmpc import plugins
from wbmpc.checks import parse_number
from wbmpc.errors import InputError, ProgramError, did_you_mean
from wbmpc.yaml_file import load_yaml, parse_yaml

#: The discriminator of settings that are one of several models.
KIND = "kind"
#: Faults of one validation that a message names.
MAX_FAULTS = 10


def _kind_alone(value: Any) -> Any:
    return {KIND: value} if isinstance(value, str) else value


T = TypeVar("T")
#: ``OneOf[A | B]``: settings that are one of several models, which their ``kind`` selects; it alone will do: ``legs: support`` for
#: ``legs: {kind: support}``.
OneOf = Annotated[T, Field(discriminator=KIND), BeforeValidator(_kind_alone)]


def _models_of(annotation: Any) -> list[type[BaseModel]]:
    """The models that a field may hold: one, or several that its ``kind`` selects."""
    found = [c for c in (annotation, *get_args(annotation)) if isinstance(c, type) and issubclass(c, BaseModel)]
    return found if len(found) < 2 or all(KIND in m.model_fields for m in found) else found[:1]


def _by_kind(models: Iterable[type[BaseModel]]) -> dict[str, type[BaseModel]]:
    """The models that a ``kind`` selects, by it."""
    return {k: m for m in models if KIND in m.model_fields for k in get_args(m.model_fields[KIND].annotation)}


def keys(model: type[BaseModel], prefix: str = "") -> list[str]:
    """All dotted keys of a nested model; where a setting is one of several models, those of all."""
    out = []
    for name, info in model.model_fields.items():
        inner = [key for m in _models_of(info.annotation) for key in keys(m, f"{prefix}{name}.")]
        out += inner or [f"{prefix}{name}"]
    return list(dict.fromkeys(out))


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


#: No setting has a number beyond this: the largest are counts of encoders (2^40).
LARGEST = 2.0**41


def _largest(value: Any) -> float:
    """The largest absolute number in a value; infinite if one is not finite."""
    if isinstance(value, Mapping):
        return max(map(_largest, value.values()), default=0.0)
    if isinstance(value, (list, tuple)):
        return max(map(_largest, value), default=0.0)
    if isinstance(value, str):
        # YAML reads nan, inf and 1e3 as text; pydantic would make numbers of them
        try:
            value = parse_number(value)
        except ValueError:
            return 0.0
    if not isinstance(value, int | float):
        return 0.0
    # no comparison holds of NaN; a whole number may be beyond all floats
    return float(abs(value)) if abs(value) <= LARGEST else math.inf


def _parse(assignment: str, where: str) -> tuple[str, Any]:
    key, equals, text = assignment.partition("=")
    if not equals or not key.strip() or not text.strip():
        raise InputError(f"{where}: --set '{assignment}': the form is key=value, e.g. mpc.rate=100")
    # in a file YAML takes these for its own: a mark of the encoding and ends of lines
    if hidden := next((c for c in text if c in "\ufeff\u0085\u2028\u2029"), ""):
        shown = f"{key.strip()}={text.strip()[:80]}"
        raise InputError(f"{where}: --set {shown!r}: U+{ord(hidden):04X} is a character that cannot be printed")
    value = parse_yaml(text, f"{where}: --set {key.strip()}={text.strip()[:80]}")
    if math.isinf(_largest(value)):
        shown = f"{key.strip()}={text.strip()[:80]}"
        raise InputError(f"{where}: --set {shown}: the value must be a finite number, at most {LARGEST:.3g}")
    return key.strip(), _numbers(value)


def _numbers(value: Any) -> Any:
    """Text that is a number as that number: YAML 1.1 reads 8e-1 as text."""
    if isinstance(value, list):
        return [_numbers(v) for v in value]
    if isinstance(value, str):
        with suppress(ValueError):
            return parse_number(value)
    return value


def _types(model: type[BaseModel], key: str) -> list[Any]:
    first, _, rest = key.partition(".")
    info = model.model_fields.get(first)
    if info is None:
        return []  # of another one of several models
    if rest:
        return [kind for inner in _models_of(info.annotation) for kind in _types(inner, rest)]
    return [info.annotation, *get_args(info.annotation)]


def _kinds(model: type[BaseModel], key: str) -> dict[str, type[BaseModel]]:
    """The models by kind that a setting is one of; empty for other settings."""
    return _by_kind(m for kind in _types(model, key) for m in _models_of(kind))


def _choices(model: type[BaseModel], settings: Mapping[str, Any], section: list[str]) -> dict[str, type[BaseModel]]:
    """The models by kind that a section is one of, inside of what ``settings`` chose above it; empty for other settings."""
    models = [model]
    for part in section:
        chosen = _by_kind(models).get(str(settings.get(KIND))) or next(iter(models), None)
        info = chosen.model_fields.get(part) if chosen else None
        models, settings = _models_of(info.annotation) if info else [], settings.get(part) or {}
    return _by_kind(models)


def _reads(model: type[BaseModel], key: str) -> bool:
    """Whether a model has a dotted key, or a mapping of which it is an entry."""
    return bool(_types(model, key)) or any(get_origin(kind) is dict for kind in _types(model, key.rpartition(".")[0]))


def _known(model: type[BaseModel], key: str, value: Any, valid: list[str]) -> str | None:
    """The key that is meant: itself, an entry of a mapping (``weights.NAME``), the kind of a section; None: there is none."""
    mapping, _, entry = key.rpartition(".")
    if key in valid or (entry and any(get_origin(kind) is dict for kind in _types(model, mapping))):
        return key
    return f"{key}.{KIND}" if isinstance(value, str) and _kinds(model, key) else None


def has_truths(value: Any) -> bool:
    """Whether a value is, or holds, true or false."""
    inside = value.values() if isinstance(value, Mapping) else value
    return isinstance(value, bool) or (isinstance(value, Mapping | list | tuple) and any(map(has_truths, inside)))


def _insert(model: type[BaseModel], settings: dict[str, Any], key: str, value: Any) -> None:
    """Put ``value`` in its place. A section that is left out by default begins empty: its model knows what else is in it."""
    *parents, last = key.split(".")
    tree = settings
    for parent in parents:
        if tree.get(parent) is None:
            tree[parent] = {}
        tree = tree[parent]
    if last == KIND and tree.get(KIND) != value:
        tree.clear()  # what is there is of another kind
        kind = _choices(model, settings, parents).get(str(value))
        usual: Any = model()
        for parent in parents:
            usual = getattr(usual, parent, None)
        if kind is not None:  # as by default, or as any of its kind
            tree |= (
                usual if type(usual) is kind and getattr(usual, KIND) == value else kind.model_construct()
            ).model_dump()
    tree[last] = value


def _check_kind(model: type[BaseModel], key: str, settings: Mapping[str, Any], where: str) -> None:
    """Raise :class:`InputError` for a key of a section that is of another kind."""
    parts = key.split(".")
    for depth in range(1, len(parts)):
        section, rest = ".".join(parts[:depth]), ".".join(parts[depth:])
        kinds = _choices(model, settings, parts[:depth])
        kind = reduce(lambda tree, part: tree[part], parts[:depth], settings).get(KIND) if kinds else None
        if isinstance(kind, str) and kind in kinds and not _reads(kinds[kind], rest):
            owners = " or ".join(f"{section}={k}" for k, m in kinds.items() if _reads(m, rest))
            valid = ", ".join(n for n in kinds[kind].model_fields if n != KIND) or "nothing else"
            raise InputError(f"{where} {key}: nothing uses it without {owners}; valid in {section}={kind}: {valid}")


def _kinds_first(pairs: list[tuple[str, Any]]) -> list[tuple[str, Any]]:
    """Keys and values, those of kinds first, outer ones before inner ones: the keys of a section depend on it."""
    return sorted(pairs, key=lambda pair: pair[0].count(".") if pair[0].rpartition(".")[2] == KIND else math.inf)


def _pairs(model: type[BaseModel], assignments: Iterable[str], where: str) -> list[tuple[str, Any]]:
    valid, pairs = keys(model), []
    for assignment in assignments:
        given, value = _parse(assignment, where)
        if (key := _known(model, given, value, valid)) is None:
            raise _unknown(given, valid, where)
        if has_truths(value) and bool not in _types(model, key):
            raise InputError(f"{where}: --set {assignment.strip()}: a number or text is needed, not true or false")
        pairs.append((key, value))
    return _kinds_first(pairs)


def keys_of(place: tuple[int | str, ...], model: type[BaseModel] | None) -> tuple[int | str, ...]:
    """The keys of a fault's place: pydantic puts the kind of a section that is one of several models among them."""
    keys_, models = [], [] if model is None else [model]
    for part in place:
        kinds = _by_kind(models)
        if len(models) > 1 and part in kinds:
            models = [kinds[str(part)]]
            continue
        keys_.append(part)
        models = [
            inner
            for m in models
            if part in m.model_fields
            for inner in _models_of(m.model_fields[str(part)].annotation)
        ]
    return tuple(keys_)


def describe(error: ValidationError, model: type[BaseModel] | None = None) -> str:
    """All faults of a validation as one message, without web links: ``key=value: what is wrong; ...``. ``model``: what was
    validated, where it has sections that are one of several models."""
    faults, found = [], error.errors(include_url=False)
    for fault in found:
        place = fault["loc"]
        names = keys_of(place, model)
        context = fault.get("ctx", {})
        if fault["type"] == "union_tag_invalid":
            expected = context["expected_tags"].replace("'", "")
            faults.append(".".join(map(str, (*names, KIND))) + f"={context['tag']!r}: valid: {expected}")
            continue
        if fault["type"] == "too_short" and any(f["loc"][: len(place)] == place != f["loc"] for f in found):
            continue  # what is left when its bad entries are taken away
        key = ".".join(map(str, names))
        # a fault between several settings carries its whole section, and a missing one has no value of its own
        shown = (
            ""
            if isinstance(fault["input"], (Mapping, BaseModel)) or fault["type"] == "missing"
            else f"={fault['input']!r:.80}"
        )
        if fault["type"] == "tuple_type":
            example = "names in brackets are needed, e.g. [one, other]"
            if not isinstance(fault["input"], str):
                example = "numbers in brackets are needed, e.g. [0.6, 0.9]"
            faults.append(f"{key}{shown}: several {example}")
            continue
        if fault["type"] == "path_type":
            faults.append(f"{key}: the name of a file is needed")
            continue
        text = fault["msg"].removeprefix("Value error, ").removeprefix("Assertion failed, ")
        faults.append(f"{key}{shown}: {text[:1].lower()}{text[1:]}".removeprefix(": "))
    more = [f"and {len(faults) - MAX_FAULTS} more"] if len(faults) > MAX_FAULTS else []
    return "; ".join(faults[:MAX_FAULTS] + more)


def _of_file(model: type[BaseModel], path: Path, where: str) -> list[tuple[str, Any]]:
    """Keys and values of a settings file: sections as mappings, or dotted keys. Raises :class:`InputError` naming file and key."""
    data = load_yaml(path)
    if data is not None and not isinstance(data, dict):
        raise InputError(f"{path}: a mapping of settings is needed")
    valid, found = keys(model), list[tuple[str, Any]]()

    def walk(section: Mapping[Any, Any], prefix: str) -> None:
        for name, value in section.items():
            given = f"{prefix}{name}"
            if isinstance(value, dict) and given not in valid and any(k.startswith(f"{given}.") for k in valid):
                walk(value, f"{given}.")
                continue
            if (key := _known(model, given, value, valid)) is None:
                raise InputError(str(_unknown(given, valid, where)).replace(f"{where}: --set", str(path), 1))
            if math.isinf(_largest(value)):
                raise InputError(f"{path}: key '{key}': numbers must be finite, at most {LARGEST:.3g}")
            if has_truths(value) and bool not in _types(model, key):
                raise InputError(f"{path}: key '{key}': a number or text is needed, not true or false")
            if any(k in (key, key.rpartition(".")[0]) or k.startswith(f"{key}.") for k, _ in found):
                raise InputError(f"{path}: key '{key}' appears twice, in its section and with dots")
            found.append((key, _numbers(value)))

    walk(data or {}, "")
    return _kinds_first(found)


def configure(model: type[BaseModel], assignments: Iterable[str], where: str, file: Path | None = None) -> Any:
    """An instance of ``model`` with its defaults, the settings of a YAML ``file``, and ``key=value`` assignments (a later one wins).

    Values are written as in YAML: ``100``, ``true``, ``[0.6, 0.9]``.
    Raises :class:`InputError` naming ``where`` (the experiment) or the file, the key and the valid choices, and :class:`ProgramError` for a
    model of other people that cannot be made of its defaults, checked, or written as JSON.
    """
    with mistakes_of_model(model, where):
        found = _configured(model, assignments, where, file)
        if not plugins.is_own(model.__module__):
            found.model_dump_json()  # files of a run have it
    return found


def mistakes_of_model(model: type[BaseModel], where: str) -> AbstractContextManager[None]:
    """Whatever is wrong with a model of other people is an error that begins with ``where``."""
    own = plugins.is_own(model.__module__)
    return nullcontext() if own else plugins.mistakes_of(f"{where}: its settings", kind=ProgramError)


def _configured(model: type[BaseModel], assignments: Iterable[str], where: str, file: Path | None) -> Any:
    settings = model().model_dump()
    of_file = [] if file is None else _of_file(model, file, where)
    pairs = [*of_file, *_pairs(model, assignments, where)]
    for key, value in pairs:
        _insert(model, settings, key, value)
    for k, (key, _) in enumerate(pairs):
        _check_kind(model, key, settings, f"{where}: --set" if k >= len(of_file) else f"{file}: key")
    try:
        return model.model_validate(settings)
    except ValidationError as error:
        source = "--set" if file is None else f"settings of {file} and --set:"
        raise InputError(f"{where}: {source} {describe(error, model)}") from error


def usual_kinds(model: type[BaseModel], data: Any) -> Any:
    """``data`` of a model with the kinds that it leaves out: those of the defaults."""
    if not isinstance(data, Mapping):
        return data
    usual = {n: getattr(info.default, KIND, None) for n, info in model.model_fields.items()}
    return {n: {KIND: usual[n], **v} if usual.get(n) and isinstance(v, Mapping) else v for n, v in data.items()}


def reject_booleans(model: type[BaseModel], data: Any) -> Any:
    """``data`` of a model, unless it has true or false (YAML: yes, on, no, off) where a field needs a number or a text: Python
    takes them for 1 and 0. Raises ``ValueError`` with the field. Models inside check themselves."""
    for name, value in data.items() if isinstance(data, dict) else ():
        field = model.model_fields.get(name)
        kinds = () if field is None else (field.annotation, *get_args(field.annotation))
        checked = any(k in (bool, Any) or (isinstance(k, type) and issubclass(k, BaseModel)) for k in kinds)
        if field is not None and not checked and has_truths(value):
            raise ValueError(f"{name}: a number or text is needed, not true or false")
    return data

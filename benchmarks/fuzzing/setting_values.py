"""Values of ``--set``: read by themselves, and with experiments that are really built."""

from __future__ import annotations

import json
import random
from itertools import pairwise
from pathlib import Path
from typing import Any, get_args

from annotated_types import Ge, Gt, Le, Lt
from pydantic import BaseModel

from fuzzing.case import INVALID, NEVER, NOT_FINITE, OPEN, STRANGE, VALID, Case, soup
from wbmpc.configuration import keys
from wbmpc.registry import REGISTRY

#: What no length, time, weight or limit of a robot is [SI].
BEYOND = ("1e300", "-1e300", "1e30", "1" + "0" * 40, "-1e15", "[1e300]", "[1e300, 1e300]")
TRUTHS = ("yes", "no", "on", "off", "true", "False", "[yes, no]", "{a: yes}")


def _default(model: type[BaseModel], key: str) -> Any:
    value: Any = model().model_dump(mode="json")
    for part in key.split("."):
        value = None if value is None else value.get(part)
    return value


def _field(model: type[BaseModel], key: str) -> Any:
    """The field of a dotted key; of several models that a section may have, of one that has the key."""
    parts = key.split(".")
    for parent, inside in pairwise(parts):
        models = _models(model.model_fields[parent].annotation)
        model = next(m for m in models if inside in m.model_fields)
    return model.model_fields[parts[-1]]


def _models(annotation: Any) -> list[type[BaseModel]]:
    """The models of an annotation, also in a union."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models(part)]


def settings(rng: random.Random, folder: Path) -> Case:
    """One setting, with a stand-in for the experiment."""
    name = rng.choice(list(REGISTRY))
    model = REGISTRY[name].config_type
    key = rng.choice(keys(model))
    value = _default(model, key)
    number = isinstance(value, int | float) and not isinstance(value, bool)
    kinds = ["default", "never", "soup", "unknown", "not finite", "number", "long"]
    kind = rng.choice([*kinds, "beyond", "truth", "strange"] if number else kinds)
    expected, text = INVALID, json.dumps(value)
    if kind == "default":
        expected = VALID if value is not None else OPEN
    elif kind == "unknown":
        key += rng.choice(("x", ".a", "-", " b", "\u00e9", "\x1b[31m", "\nb", "\u0661"))
    elif kind in ("soup", "number"):
        text = soup(rng) if kind == "soup" else repr(rng.uniform(-1, 1) * 10.0 ** rng.randint(-320, 300))
        expected = OPEN
    elif kind == "long":
        text = rng.choice(
            ("[" + "1, " * 40_000 + "1]", "[" * 30 + "]" * 30, "1" * 4000, "{" + "a: 1, " * 300 + "b: 2}")
        )
        expected = OPEN if len(text) < 1000 else INVALID
    else:
        choices = {"never": NEVER, "not finite": NOT_FINITE, "beyond": BEYOND, "truth": TRUTHS, "strange": STRANGE}
        text = rng.choice(choices[kind])
    return Case(f"{name}: {kind}: {key}={text[:60]}", expected, ["run", name, "--set", f"{key}={text}"])


#: Experiments that are built for real: with an MPC, and without a drive for calibration before it.
BUILT = ("swerve-unified", "rezero-circle", "rezero-steps", "rezero-wholebody", "rezero-taskspace")


def problems(rng: random.Random, folder: Path) -> Case:
    """One setting at an end of what it may be, with the experiment built and run for a few ticks."""
    name = rng.choice(BUILT)
    model = REGISTRY[name].config_type
    key = rng.choice(keys(model))
    field, value = _field(model, key), _default(model, key)
    whole = isinstance(value, int)
    ends = [end for end in _ends(field.metadata, whole) if end is not None]
    ends += [_scaled(value, f, whole) for f in (0.1, 10.0)] if isinstance(value, int | float) else [value]
    kind = "default" if isinstance(value, bool) or value is None else rng.choice(("default", "end", "end", "end"))
    text = json.dumps(value if kind == "default" else rng.choice(ends))
    if kind == "default" and value is None:
        key, text = "mpc.rate", json.dumps(_default(model, "mpc.rate"))
    out = ["--out", str(folder / "run"), "--json"]
    return Case(f"{name}: {kind}: {key}={text}", VALID if kind == "default" else OPEN,
                ["run", name, "--set", f"{key}={text}", *out], real=True)  # fmt: skip


def _scaled(value: float, factor: float, whole: bool) -> float:
    return int(value * factor) if whole else value * factor


def _ends(metadata: list[Any], whole: bool) -> list[float | None]:
    """The smallest and the largest value that a field takes by itself."""
    found: list[float | None] = []
    for rule in metadata:
        if isinstance(rule, Ge | Le):
            found.append(rule.ge if isinstance(rule, Ge) else rule.le)  # type: ignore[arg-type]
        elif isinstance(rule, Gt | Lt):
            bound = float(rule.gt if isinstance(rule, Gt) else rule.lt)  # type: ignore[arg-type]
            sign = 1 if isinstance(rule, Gt) else -1
            found.append(int(bound) + sign if whole else bound + sign * 1e-6 * max(abs(bound), 1.0))
    return found

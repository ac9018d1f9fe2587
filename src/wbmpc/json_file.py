"""JSON from files and recordings: what is broken, nested too deep or too large is one clear error."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from wbmpc.errors import InputError
from wbmpc.input_file import read_file

#: Bytes of a file and levels of nesting, at most.
LARGEST, DEEPEST = 64 * 1024 * 1024, 64


def load_json(path: Path) -> Any:
    """What a JSON file says. Raises :class:`InputError` naming the file."""
    return parse_json(read_file(path, LARGEST), str(path))


def parse_json(text: str | bytes, where: str) -> Any:
    """What a JSON text says; ``where``: what messages begin with.

    Raises :class:`InputError`, also for NaN, infinity, numbers that are too large and keys that appear twice.
    """
    try:
        value = json.loads(
            text, parse_constant=_no_number, parse_float=_finite, parse_int=_whole, object_pairs_hook=_once
        )
    except RecursionError as error:
        raise InputError(f"{where}: nested deeper than {DEEPEST} levels") from error
    except ValueError as error:
        raise InputError(f"{where}: is not JSON: {error}") from error
    level = [value]
    for _ in range(DEEPEST):
        level = [inner for outer in level for inner in _inside(outer)]
        if not level:
            return value
    raise InputError(f"{where}: nested deeper than {DEEPEST} levels")


def _no_number(text: str) -> None:
    raise ValueError(f"{text} is not a number in JSON")


def _finite(text: str) -> float:
    value = float(text)
    if math.isinf(value):
        raise ValueError(f"{text[:40]} is too large for a number")
    return value


def _whole(text: str) -> int:
    _finite(text)
    return int(text)


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"key '{twice[:80]}' appears twice")
    return found


def _inside(value: Any) -> list[Any]:
    found = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return [v for v in found if isinstance(v, (dict, list))]

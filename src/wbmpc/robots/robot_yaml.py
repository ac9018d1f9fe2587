"""A robot's YAML with comments, as a person would write it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from wbmpc.errors import printable

#: Lists and mappings that fit into so many characters stand on one line.
_WIDTH = 110


def write_yaml(data: Mapping[str, Any], comments: Mapping[str, str]) -> str:
    """The text of ``data``; ``comments`` by dotted key stand above it, that of "" on top."""
    lines = _comment(comments.get("", ""), 0)
    for key, value in data.items():
        lines += _entry(str(key), value, comments, str(key), 0)
    return "\n".join(lines) + "\n"


def _entry(key: str, value: Any, comments: Mapping[str, str], path: str, depth: int) -> list[str]:
    indent = "  " * depth
    lines = _comment(comments.get(path, ""), depth)
    nested = isinstance(value, Mapping) and any(f"{path}.{k}" in comments for k in value)
    flat = f"{indent}{_scalar(key)}: {flow(value)}"
    if nested or (isinstance(value, Mapping) and (len(flat) > _WIDTH or depth == 0)):
        lines.append(f"{indent}{_scalar(key)}:")
        for name, inner in value.items():
            lines += _entry(str(name), inner, comments, f"{path}.{name}", depth + 1)
        return lines
    if isinstance(value, list) and len(flat) > _WIDTH:
        return [*lines, f"{indent}{_scalar(key)}:", *(f"{indent}  - {flow(v)}" for v in value)]
    return [*lines, flat]


def flow(value: Any) -> str:
    """On one line."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_scalar(str(k))}: {flow(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(flow(v) for v in value) + "]"
    return _scalar(value)


def _scalar(value: Any) -> str:
    """Numbers as they are; text in quotes where YAML could read it otherwise."""
    if isinstance(value, int | float):
        return f"{value:.10g}"
    plain = value.replace("_", "a").replace("-", "a").replace("/", "a").replace(".", "a")
    words = ("y", "n", "yes", "no", "on", "off", "true", "false", "null", "inf", "nan")
    if plain.isascii() and plain.isalnum() and value[0].isalpha() and value.lower() not in words:
        return str(value)
    return json.dumps(value, ensure_ascii=not value.isprintable())


def _comment(text: str, depth: int) -> list[str]:
    return [f"{'  ' * depth}# {printable(line)}".rstrip() for line in text.splitlines()]

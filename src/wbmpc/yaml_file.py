"""The one reader of YAML: files of robots, calibrations and buses, and the values of settings.

YAML 1.1 as PyYAML reads it, without what a settings file does not need and what a reader may take otherwise than its writer:
equal keys, tags, anchors and aliases, octal (``010``), binary (``0b11``) and sexagesimal (``1:30``) numbers. Dates are text.
Size and depth are limited.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any, Never

import yaml

from wbmpc.errors import InputError
from wbmpc.input_file import read_file

#: Bytes of a text, levels of nesting, keys and values, and digits of a whole number, at most.
LARGEST, DEEPEST, MAX_VALUES, MAX_DIGITS = 256 * 1024, 32, 8_000, 300
#: Numbers as in YAML 1.2, which takes 1e-3 without a point, too.
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_OCTAL = re.compile(r"[-+]?0[0-9_]+")
_BINARY = re.compile(r"[-+]?0b[01_]+")
_SEXAGESIMAL = re.compile(r"[-+]?[0-9][0-9_]*(:[0-9]+)+(\.[0-9_]*)?")
#: Underscores separate thousands; elsewhere one is a slip (1_0 for 1.0).
_THOUSANDS = re.compile(r"[-+]?[0-9]{1,3}(_[0-9]{3})+(\.[0-9]*)?")
#: Control characters and halves of surrogate pairs, which no file name and no terminal takes.
_UNPRINTABLE = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f\ud800-\udfff]")
#: What PyYAML raises for texts that are not YAML, beside its own errors.
_BROKEN = (yaml.YAMLError, ValueError, OverflowError, LookupError, AttributeError, TypeError)


def load_yaml(path: Path) -> Any:
    """What a YAML file says, None of an empty one. Raises :class:`InputError` naming the file, the line and the key."""
    try:
        text = read_file(path, LARGEST).decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not a text file in UTF-8 ({error.reason} at byte {error.start})") from error
    return _read(text, str(path), lines=True)


def parse_yaml(text: str, where: str) -> Any:
    """What a YAML text says, None of an empty one; ``where``: what messages begin with.

    Raises :class:`InputError` naming the key, and the line of a text that has several.
    """
    return _read(text, where, lines="\n" in text)


def _read(text: str, where: str, lines: bool) -> Any:
    if len(text) > LARGEST:
        raise InputError(f"{where}: has {len(text)} characters; at most {LARGEST} are read")
    try:
        return _Reader(text, where, lines).document()
    except _BROKEN as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{where}: not valid YAML: {_describe(error, lines)}") from error


def _describe(error: Exception, lines: bool) -> str:
    if not isinstance(error, yaml.MarkedYAMLError):
        return " ".join(str(error).replace(' in "<unicode string>",', "").split()) or type(error).__name__
    text = ", ".join(part for part in (error.context, error.problem) if part)
    mark = error.problem_mark or error.context_mark
    return f"line {mark.line + 1}: {text}" if lines and mark else text


class _Reader:
    """Values straight from the parser's events, so that nothing grows of what is not allowed."""

    def __init__(self, text: str, where: str, lines: bool) -> None:
        self._loader, self._where, self._lines, self._count = yaml.SafeLoader(text), where, lines, 0

    def document(self) -> Any:
        """The text's only document."""
        self._loader.get_event()  # the stream's start
        if self._loader.check_event(yaml.StreamEndEvent):
            return None
        self._loader.get_event()  # the document's start
        value = self._value(())
        self._loader.get_event()  # the document's end
        if not self._loader.check_event(yaml.StreamEndEvent):
            self._fail(self._loader.peek_event(), (), "a second document (---) begins; one is allowed")
        return value

    def _value(self, path: tuple[str, ...]) -> Any:
        event = self._loader.get_event()
        self._check(event, path)
        if isinstance(event, yaml.ScalarEvent):
            return self._scalar(event, path)
        if len(path) >= DEEPEST:
            self._fail(event, path[:3], f"nested deeper than {DEEPEST} levels")
        if isinstance(event, yaml.SequenceStartEvent):
            return self._sequence(path)
        return self._mapping(path)

    def _sequence(self, path: tuple[str, ...]) -> list[Any]:
        out: list[Any] = []
        while not self._loader.check_event(yaml.SequenceEndEvent):
            out.append(self._value((*path, str(len(out)))))
        self._loader.get_event()
        return out

    def _mapping(self, path: tuple[str, ...]) -> dict[Any, Any]:
        out: dict[Any, Any] = {}
        while not self._loader.check_event(yaml.MappingEndEvent):
            event = self._loader.get_event()
            inside = (*path, str(getattr(event, "value", "?")))
            self._check(event, inside)
            if not isinstance(event, yaml.ScalarEvent):
                self._fail(event, path, "a list or a mapping is no key; a name is needed")
            if event.implicit[0] and event.value == "<<":
                self._fail(event, inside, "merging of mappings (<<) is not allowed")
            key = self._scalar(event, inside)
            if key in out:
                self._fail(event, inside, "appears twice")
            out[key] = self._value(inside)
        self._loader.get_event()
        return out

    def _check(self, event: Any, path: tuple[str, ...]) -> None:
        self._count += 1
        if self._count > MAX_VALUES:  # each takes the parser a fraction of a millisecond
            self._fail(event, path[:3], f"more than {MAX_VALUES} keys and values; at most so many are read")
        if isinstance(event, yaml.AliasEvent):
            self._fail(event, path, f"an alias (*{event.anchor}) is not allowed; write the value once more")
        if event.anchor is not None:
            self._fail(event, path, f"an anchor (&{event.anchor}) is not allowed")
        if event.tag is not None:
            self._fail(event, path, f"a tag ({event.tag}) is not allowed")

    def _scalar(self, event: yaml.ScalarEvent, path: tuple[str, ...]) -> Any:
        text = event.value
        if _UNPRINTABLE.search(text):
            self._fail(event, path, f"{text[:40]!r} has a character that cannot be printed")
        if _foreign_number(text):
            self._fail(event, path, f"'{text[:40]}' is a number in other digits than 0 to 9")
        if not event.implicit[0]:  # quoted
            return text
        kind = self._loader.resolve(yaml.ScalarNode, text, event.implicit).rpartition(":")[2]
        if _OCTAL.fullmatch(text):
            digits = text.lstrip("+-").lstrip("0_") or "0"
            sign = "-" if text.startswith("-") else ""
            self._fail(event, path, f"'{text}' may be read as an octal number; write {sign}{digits}, or quote a text")
        if _BINARY.fullmatch(text):
            self._fail(event, path, f"'{text[:40]}' may be read as a binary number; write its digits, or quote a text")
        if _SEXAGESIMAL.fullmatch(text):
            self._fail(
                event, path, f"'{text}' may be read as a number to the base of 60; write it out, or quote a text"
            )
        if kind in ("int", "float") and len(text) > MAX_DIGITS:
            self._fail(event, path, f"a number of {len(text)} characters; at most {MAX_DIGITS} are read")
        if kind in ("int", "float") and "_" in text and not _THOUSANDS.fullmatch(text):
            self._fail(
                event, path, f"'{text}' has an underscore that separates no thousands; write digits, or quote a text"
            )
        value = _plain(kind, text)
        if isinstance(value, float) and math.isinf(value) and "inf" not in text.lower():
            self._fail(event, path, f"{text} is too large for a number")
        return value

    def _fail(self, event: yaml.Event, path: tuple[str, ...], text: str) -> Never:
        key = ".".join(part[:80] for part in path)
        place = [f"line {event.start_mark.line + 1}"] if self._lines and event.start_mark is not None else []
        place += [f"key '{key}'"] if key else []
        raise InputError(": ".join(part for part in (self._where, ", ".join(place), text) if part))


def _foreign_number(text: str) -> bool:
    """Whether Python takes a text for a number, and pydantic does then, that YAML takes for a text."""
    if text.isascii():
        return False
    try:
        float(text)
    except ValueError:
        return False
    return True


def _plain(kind: str, text: str) -> Any:
    """The value of an unquoted scalar; kinds that are not known here (dates, ``=``) are text."""
    bare = text.replace("_", "").lower()
    if kind == "null":
        return None
    if kind == "bool":
        return bare in ("yes", "true", "on")
    if kind == "int":
        return int(bare, 0)
    if kind == "float" or _FLOAT.fullmatch(text):
        return float(bare.replace(".inf", "inf").replace(".nan", "nan"))
    return text

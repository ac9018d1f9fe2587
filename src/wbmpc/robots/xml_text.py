"""The text of a robot's XML as MuJoCo's parser takes it, made fit for a strict parser."""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterator
from xml.parsers import expat

#: Encodings in which tags look as in ASCII, which is what MuJoCo's parser reads.
ENCODINGS = ("utf-8", "ascii", "iso8859-1", "cp1252")
#: Tags and comments that a file may have.
MAX_TAGS = 100_000
_IN_TAG = re.compile(rb"[\"'>]")


def tokens(data: bytes) -> Iterator[tuple[int, int, bool]]:
    """Start and end of what begins with < in turn, and whether it is a comment: not what looks so inside of quotes or CDATA.

    Raises ValueError for a file of more than :data:`MAX_TAGS`. What has no end is the last one.
    """
    if data.count(b"<") > MAX_TAGS:
        raise ValueError(f"more than {MAX_TAGS} tags; at most so many are read")
    start = data.find(b"<")
    while start >= 0:
        end = _end(data, start)
        yield start, end, data.startswith(b"<!--", start)
        start = data.find(b"<", end)


def _end(data: bytes, start: int) -> int:
    for opening, closing in ((b"<!--", b"-->"), (b"<![CDATA[", b"]]>"), (b"<?", b"?>")):
        if data.startswith(opening, start):
            found = data.find(closing, start + len(opening))
            return len(data) if found < 0 else found + len(closing)
    at: int | None = start + 1
    while at is not None and (mark := _IN_TAG.search(data, at)):
        if mark[0] == b">":
            return mark.end()
        closing_quote = data.find(mark[0], mark.end())
        at = None if closing_quote < 0 else closing_quote + 1
    return len(data)


def without_comments(data: bytes) -> bytes:
    """The same lines without comments: MuJoCo's parser takes some that XML does not (with -- inside)."""
    kept, at = list[bytes](), 0
    for start, end, comment in tokens(data):
        if comment:
            kept += [data[at:start], b"\n" * data.count(b"\n", start, end)]
            at = end
    return b"".join([*kept, data[at:]])


def check_encoding(encoding: str | None) -> None:
    """Raise ValueError for an encoding in which two parsers would read other tags than each other."""
    try:
        known = encoding is None or codecs.lookup(encoding).name in ENCODINGS
    except LookupError:
        known = False
    if not known:
        raise ValueError(f"encoding '{encoding}'; UTF-8 is needed")


def _no_doctype(*_: object) -> None:
    raise ValueError("a document type (<!DOCTYPE) with entities is not allowed")


def strict_parser() -> expat.XMLParserType:
    """A parser that takes no document types, hence no entities, and no encodings but :data:`ENCODINGS`. It raises :class:`ValueError`."""
    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = _no_doctype
    parser.XmlDeclHandler = lambda version, encoding, standalone: check_encoding(encoding)
    return parser

"""Files that are written as a whole or not at all."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from wbmpc.errors import NotWritten

#: Bytes of a file's name that the name of its beginnings has, at most: file systems count bytes, and take 255.
_LONGEST_STEM = 200


@contextmanager
def whole_file(path: Path, follow: bool = True) -> Iterator[Path]:
    """Where to write what then becomes ``path``: a file beside it with the same ending, which takes its place at the end.

    Where that fails or is interrupted, ``path`` stays as it was and nothing is left. A full disk raises :class:`NotWritten`
    naming ``path``, and so does a pipe with a name, which would wait for its reader. What else is there and no regular file (a
    device, an open pipe of the shell's) is written itself. A link stays one, and what it leads to is written; not ``follow``: it is
    replaced, as where the name is the program's own, and the link somebody else's.
    """
    replaced = not follow and path.is_symlink()
    if not replaced:
        if is_named_pipe(path):
            raise NotWritten(f"{path}: cannot be written (is a pipe)")
        if path.exists() and not path.is_file():
            with _named(path):
                yield path
            return
    target = Path(os.path.realpath(path)) if follow else path
    # a name that nobody guesses: what stands there, or a link that another user puts there, would be written
    shown = os.fsdecode(os.fsencode(target.stem)[:_LONGEST_STEM])
    partial = target.with_name(f"{shown}.part{secrets.token_hex(8)}{target.suffix}")
    try:
        with _named(path):
            yield partial
            if target.exists() and not target.is_symlink():
                partial.chmod(target.stat().st_mode & 0o777)
            partial.replace(target)
    finally:
        with suppress(OSError):
            partial.unlink(missing_ok=True)


def is_named_pipe(path: Path) -> bool:
    """Whether there is a pipe in the file system; those that a shell opens (/dev/stdout) have no place there."""
    return Path(os.path.realpath(path)).is_fifo()


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """What the system says of a file, as an error that names it."""
    try:
        yield
    except OSError as error:
        raise NotWritten(f"{path}: cannot be written ({error.strerror or error})") from error


def write_text(path: Path, text: str, follow: bool = True) -> None:
    """A text file in UTF-8, as :func:`whole_file` has it; raises :class:`NotWritten`."""
    with whole_file(path, follow) as partial:
        partial.write_text(text, "utf-8", "backslashreplace")  # names of files may be no text

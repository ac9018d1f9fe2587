"""Object code on disk: found by the hash of the problem, checked before use, replaced atomically."""

from __future__ import annotations

import hashlib
import json
import logging
import os
import tempfile
from functools import cache
from pathlib import Path

_LOG = logging.getLogger("wbmpc")
_ROOMS = (".", "kernel", "ocp", "model")


def cache_directory() -> Path:
    """Where compiled code is kept: $WBMPC_CACHE_DIR, else $XDG_CACHE_HOME/wbmpc, else ~/.cache/wbmpc."""
    given = os.environ.get("WBMPC_CACHE_DIR")
    if given:
        return Path(given).expanduser()
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "wbmpc"


def source_fingerprint(rooms: tuple[str, ...] = _ROOMS) -> str:
    """Hash of the code that generates code: a change of it makes a new entry."""
    digest = hashlib.sha256()
    package = Path(__file__).parents[1]
    for path in sorted(p for room in rooms for p in (package / room).glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _digest(key: str, body: bytes) -> bytes:
    """With the key: a whole entry under the name of another one does not pass."""
    return hashlib.sha256(key.encode() + body).digest()


def load(key: str) -> tuple[bytes, dict] | None:
    """Object code and its description, or None when there is no valid entry."""
    path = cache_directory() / f"{key}.bin"
    try:
        if not path.is_file():  # reading anything else might never end
            return None
        raw = path.read_bytes()
    except OSError:
        return None
    digest, rest = raw[:32], raw[32:]
    if _digest(key, rest) != digest:
        _LOG.warning("compiled code in %s is damaged or of another problem: it is built again", path)
        return None
    size = int.from_bytes(rest[:8], "little")
    return rest[8 + size :], json.loads(rest[8 : 8 + size])


def save(key: str, code: bytes, description: dict) -> None:
    """Store an entry; a directory that cannot be written is not an error, but told once."""
    text = json.dumps(description).encode()
    body = len(text).to_bytes(8, "little") + text + code
    try:
        cache_directory().mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=cache_directory())
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(_digest(key, body) + body)
            os.replace(name, cache_directory() / f"{key}.bin")
        except OSError:
            os.unlink(name)
            raise
    except OSError as error:
        _tell(str(cache_directory()), str(error))


@cache
def _tell(directory: str, why: str) -> None:
    """Once for each reason: every start will compile anew."""
    _LOG.warning("compiled code cannot be kept in %s, every start will build it again: %s", directory, why)

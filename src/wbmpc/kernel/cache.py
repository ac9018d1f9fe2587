"""Object code on disk: found by the hash of the problem, checked before use, replaced atomically.

What is loaded from here runs. So directory and files count only where they belong to the user of this process and no other user
may write to them, nor put others in their place from a directory above; otherwise everything is compiled in memory.
"""

from __future__ import annotations

import errno
import hashlib
import json
import logging
import os
import secrets
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from wbmpc.errors import KernelError, shell_command
from wbmpc.input_file import expanded

_LOG = logging.getLogger("wbmpc")
_PACKAGES = (".", "kernel", "ocp", "model")
#: Who else may write.
_OTHERS = stat.S_IWGRP | stat.S_IWOTH
#: A directory that others are looked up in: to search it is enough, it need not be readable.
_DIRECTORY = os.O_PATH | os.O_DIRECTORY | os.O_CLOEXEC
#: As the system follows at most.
_MOST_LINKS = 40
#: The largest entry [bytes]: code of the largest problems is a hundredth of it. More is damage, and may be more than the memory holds.
_LARGEST = 2**28


class UntrustedCache(KernelError):
    """A directory or file of the cache that others can change, or that is not the user's; the message names it and says why."""


def cache_directory() -> Path:
    """Where compiled code is kept: $WBMPC_CACHE_DIR, else $XDG_CACHE_HOME/wbmpc, else ~/.cache/wbmpc; for a user without a home
    directory, a folder of temporary files. Raises :class:`wbmpc.errors.InputError` for a ``~`` that stands for no directory."""
    directory = os.environ.get("WBMPC_CACHE_DIR")
    if directory:
        return expanded(Path(directory))
    base = os.environ.get("XDG_CACHE_HOME")
    if base:
        return Path(base) / "wbmpc"
    try:
        return Path.home() / ".cache" / "wbmpc"
    except RuntimeError:
        return Path(tempfile.gettempdir()) / f"wbmpc-{os.geteuid()}"


@cache
def source_fingerprint(packages: tuple[str, ...] = _PACKAGES) -> str:
    """Hash of the Python files in ``packages``, files and folders relative to wbmpc or absolute, at the first call: changed code makes a
    new entry."""
    digest = hashlib.sha256()
    root = Path(__file__).resolve().parents[1]
    places = [root / package for package in packages]
    for path in sorted({p for place in places for p in ([place] if place.is_file() else place.glob("*.py"))}):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _digest(key: str, body: bytes) -> bytes:
    """With the key: a whole entry under the name of another one does not pass."""
    return hashlib.sha256(key.encode() + body).digest()


def _distrust(path: Path, found: os.stat_result) -> str:
    """Why what is at ``path`` may have been put there by others; empty if only the user can have."""
    if found.st_uid != os.geteuid():
        return f"{path} belongs to the user with number {found.st_uid}, not to this one ({os.geteuid()})"
    if found.st_mode & _OTHERS:
        mode = f"{stat.S_IMODE(found.st_mode):04o}"
        return f"{path} can be changed by others (mode {mode}; '{shell_command('chmod', 'go-w', path)}' if its content is yours)"
    return ""


def _distrust_holder(folder: Path, above: Path, found: os.stat_result) -> str:
    """Why others may put something else in the place of what is in the directory ``above``, on the way to ``folder``: it is neither root's
    nor the user's, or others may write to it, and so rename what is in it. With the sticky bit, as /tmp has it, they may not."""
    if found.st_uid not in (0, os.geteuid()):
        return f"{folder} is in {above}, which belongs to the user with number {found.st_uid}"
    if found.st_mode & _OTHERS and not found.st_mode & stat.S_ISVTX:
        mode = f"{stat.S_IMODE(found.st_mode):04o}"
        return f"{folder} is in {above}, which can be changed by others (mode {mode}; '{shell_command('chmod', 'go-w', above)}' keeps them out)"
    return ""


@dataclass
class _Way:
    """The way to a directory, one name after the other as the system resolves them, links too: every directory on it is held open, so that
    what was checked is what the next name is looked up in."""

    folder: Path
    create: bool
    held: list[tuple[int, Path]] = field(default_factory=list)
    links: int = 0

    def follow(self, path: Path) -> None:
        """Go on along a path, from where the way has led unless it is absolute."""
        if path.is_absolute():
            self.close()
            self._enter(os.open("/", _DIRECTORY), Path("/"))
        for name in path.parts[1:] if path.is_absolute() else path.parts:
            self._step(name)

    def _step(self, name: str) -> None:
        holder, above = self.held[-1]
        if name == "..":
            if len(self.held) > 1:
                os.close(self.held.pop()[0])
            return
        why = _distrust_holder(self.folder, above, os.fstat(holder))
        if why:
            raise UntrustedCache(why)
        try:
            found = os.lstat(name, dir_fd=holder)
        except FileNotFoundError:
            if not self.create:
                raise
            with suppress(
                FileExistsError
            ):  # another process of the user was faster; if it was of another one, its owner says so
                os.mkdir(name, 0o700, dir_fd=holder)
            found = os.lstat(name, dir_fd=holder)
        if not stat.S_ISLNK(found.st_mode):
            self._enter(os.open(name, _DIRECTORY | os.O_NOFOLLOW, dir_fd=holder), above / name)
            return
        if found.st_uid not in (0, os.geteuid()):
            raise UntrustedCache(
                f"{self.folder}: the link {above / name} belongs to the user with number {found.st_uid}"
            )
        self.links += 1
        if self.links > _MOST_LINKS:
            raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(self.folder))
        self.follow(Path(os.readlink(name, dir_fd=holder)))

    def _enter(self, descriptor: int, path: Path) -> None:
        self.held.append((descriptor, path))

    def close(self) -> None:
        """Leave all directories."""
        while self.held:
            os.close(self.held.pop()[0])


@contextmanager
def _opened(folder: Path, create: bool) -> Iterator[tuple[int, Path]]:
    """A descriptor of a directory that is the user's alone, and where it is, without links. All files are then reached through the
    descriptor, whatever becomes of the path. ``create``: make it, and all above it that are missing, as the user's alone.

    Raises :class:`UntrustedCache`, or OSError where there is none.
    """
    way = _Way(folder, create)
    try:
        way.follow(folder if folder.is_absolute() else Path.cwd() / folder)
        descriptor, place = way.held[-1]
        why = _distrust(folder, os.fstat(descriptor))
        if why:
            raise UntrustedCache(why)
        yield descriptor, place
    finally:
        way.close()


def trusted_folder(name: str) -> Path:
    """The folder ``name`` of the cache, made if need be: the user's alone, as is the cache itself.

    Raises :class:`UntrustedCache`, or OSError where it cannot be made.
    """
    with _opened(cache_directory(), create=True), _opened(cache_directory() / name, create=True) as (_, place):
        return place


def trusted_file(path: Path) -> bool:
    """Whether there is a regular file, no link, that only the user can have written; a warning says why one is not used."""
    try:
        found = path.lstat()
    except OSError:
        return False
    if not stat.S_ISREG(found.st_mode):
        return False
    why = _distrust(path, found)
    if why:
        _warn(why)
    return not why


def _read(folder: int, path: Path) -> bytes | None:
    """The content of an entry, nothing of one that is too large to be one; None where there is no regular file that only the user can
    have written."""
    try:  # not waiting for pipes, not following links
        descriptor = os.open(path.name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, dir_fd=folder)
    except OSError as error:
        if error.errno == errno.ELOOP:
            _warn(f"{path} is a link")
        return None
    with os.fdopen(descriptor, "rb") as file:
        found = os.fstat(descriptor)
        if not stat.S_ISREG(found.st_mode):
            return None
        why = _distrust(path, found)
        if why:
            _warn(why)
            return None
        return file.read(found.st_size) if found.st_size <= _LARGEST else b""


def load(key: str, **expected: str) -> tuple[bytes, dict] | None:
    """Object code and its description, or None when there is no valid entry that only the user can have written. ``expected``: what the
    description has to say; a warning names an entry that is damaged, or says something else."""
    path = cache_directory() / f"{key}.bin"
    try:
        with _opened(path.parent, create=False) as (folder, _):
            raw = _read(folder, path)
    except UntrustedCache as error:
        _warn(str(error))
        return None
    except OSError:
        return None
    if raw is None:
        return None
    digest, rest = raw[:32], raw[32:]
    size = int.from_bytes(rest[:8], "little")
    description = _described(rest[8 : 8 + size]) if _digest(key, rest) == digest else None
    if description is None or any(description.get(name) != value for name, value in expected.items()):
        report_damaged(key)
        return None
    return rest[8 + size :], description


def report_damaged(key: str) -> None:
    """Say that an entry is not what it has to be, and is made anew."""
    _LOG.warning(
        "compiled code in %s is damaged or of another problem: it is built again", cache_directory() / f"{key}.bin"
    )


def _described(text: bytes) -> dict | None:
    """The description of an entry; None where it is none."""
    try:
        description = json.loads(text)
    except (ValueError, RecursionError):
        return None
    return description if isinstance(description, dict) else None


def save(key: str, code: bytes, description: dict) -> None:
    """Store an entry (mode 0600); where that is impossible, or the directory is not the user's alone: a warning, once."""
    text = json.dumps(description).encode()
    body = len(text).to_bytes(8, "little") + text + code
    try:
        with _opened(cache_directory(), create=True) as (folder, _):
            _replace(folder, f"{key}.bin", _digest(key, body) + body)
    except UntrustedCache as error:
        _warn(str(error))
    except OSError as error:
        _report_unwritable(str(cache_directory()), str(error))


def _replace(folder: int, name: str, content: bytes) -> None:
    """A file of the directory, whole or not at all."""
    partial = f"tmp{secrets.token_hex(8)}"
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    descriptor = os.open(partial, flags, 0o600, dir_fd=folder)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(content)
        os.replace(partial, name, src_dir_fd=folder, dst_dir_fd=folder)
    except BaseException:
        os.unlink(partial, dir_fd=folder)
        raise


@cache
def _warn(why: str) -> None:
    """Once for each reason."""
    _LOG.warning("cached machine code is not used, it is compiled in memory: %s", why)


@cache
def _report_unwritable(directory: str, why: str) -> None:
    """Once for each reason: every start will compile again."""
    _LOG.warning("compiled code cannot be kept in %s, every start will build it again: %s", directory, why)

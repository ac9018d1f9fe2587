"""Where files of a run go: a run never overwrites another one."""

from __future__ import annotations

import os
from itertools import count
from pathlib import Path

from wbmpc.errors import InputError


def _reserve(base: Path) -> Path:
    """Make ``base``, or ``base-2``, ``base-3`` … when it is there: a run never overwrites another one."""
    for k in count(1):
        path = base if k == 1 else base.with_name(f"{base.name}-{k}")
        try:
            path.mkdir(parents=True)
        except FileExistsError:
            continue
        return path
    raise AssertionError("unreachable")


def run_directory(out: Path | None, name: str, seed: int) -> Path:
    """Where the files go: a directory without another run. Made before the run, so that a bad path is found at once."""
    from wbmpc.report import RUN_FILES

    if out is None:
        return _reserve(Path("runs") / f"{name}-seed{seed}")
    if out.exists() and not out.is_dir():
        raise InputError(f"--out: '{out}' is a file; give a directory")
    out.mkdir(parents=True, exist_ok=True)
    if not os.access(out, os.W_OK | os.X_OK):
        raise InputError(f"--out: cannot write into '{out}'")
    if any((out / file).exists() for file in RUN_FILES):
        return _reserve(out)
    return out

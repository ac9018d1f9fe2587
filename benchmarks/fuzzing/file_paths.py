"""Names of files: what is there is no file, cannot be read, or has a name that a terminal must not get to see."""

from __future__ import annotations

import os
import random
from collections.abc import Callable
from pathlib import Path

from fuzzing.case import INVALID, Case

ODD_NAMES = ("a\nb", "\x1b[2J\x1b[31mred", "\u202egnp", "x" * 300, "a/" * 2500 + "b", "\x00", "\ud800", "~root", "-", "--out", " ",
             "\u0661\u0662", "a\\b", "%s%n", "$(id)", "file:///etc/passwd", "http://127.0.0.1:1/x")  # fmt: skip


def _fresh(path: Path, make: Callable[[Path], object]) -> Path:
    if path.is_dir() and not path.is_symlink():
        for inside in path.iterdir():
            inside.unlink()
        path.rmdir()
    path.unlink(missing_ok=True)
    make(path)
    return path


#: What is no file that could be read, by kind: from a folder and an ending.
PLACES: dict[str, Callable[[Path, str], object]] = {
    "missing": lambda folder, end: folder / f"missing{end}",
    "directory": lambda folder, end: _fresh(folder / f"directory{end}", os.mkdir),
    "fifo": lambda folder, end: _fresh(folder / f"fifo{end}", os.mkfifo),
    "loop": lambda folder, end: _fresh(folder / f"loop{end}", lambda p: os.symlink(p.name, p)),
    "endless": lambda folder, end: _fresh(folder / f"endless{end}", lambda p: os.symlink("/dev/zero", p)),
    "terminal": lambda folder, end: _fresh(folder / f"tty{end}", lambda p: os.symlink("/dev/tty", p)),
    "process": lambda folder, end: _fresh(folder / f"memory{end}", lambda p: os.symlink("/proc/self/mem", p)),
    "empty": lambda folder, end: _fresh(folder / f"empty{end}", Path.touch),
    "noise": lambda folder, end: _fresh(folder / f"noise{end}", lambda p: p.write_bytes(bytes(range(256)) * 9)),
    "zeros": lambda folder, end: _fresh(folder / f"zeros{end}", lambda p: p.write_bytes(bytes(500_000))),
    "inside a file": lambda folder, end: _fresh(folder / "file", Path.touch) / f"x{end}",
    "no mode": lambda folder, end: _fresh(folder / f"closed{end}", lambda p: (p.write_text("{}"), p.chmod(0))),
}


def files(rng: random.Random, folder: Path) -> Case:
    """One command that reads a file, with something else in its place."""
    end = rng.choice((".yaml", ".mcap", ".json", ".npz", ".py", ".urdf", ""))
    kind = rng.choice([*PLACES, "odd name"])
    odd = rng.choice(ODD_NAMES)
    path = odd + end if kind == "odd name" else str(PLACES[kind](folder, end))
    html, page = str(folder / "page.html"), str(folder / "picture.png")
    command = rng.choice((
        ["stability", path], ["calibrate", path], ["calibrate", path, "--robot", path], ["log", "info", path],
        ["log", "plot", path, "--out", html, "--force"], ["log", "export", path, "--out", str(folder / "export"), "--force"],
        ["compare", path, path, "--out", html, "--force"], ["replay", path, "--html", html, "--force"],
        ["render", path, "--png", page, "--force"], ["run", f"{path}.py" if end != ".py" else path], ["view", path],
        ["view", path, "--realtime"], ["ros2", "run", path], ["ros2", "sim", path],
        ["log", "plot", str(folder / "none"), "--out", path],
    ))  # fmt: skip
    return Case(f"{command[0]}: {kind}: {path[:60]!r}", INVALID, command)

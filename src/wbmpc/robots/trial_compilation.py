"""A trial of models that may take long to compile, before this process compiles them.

MuJoCo's parser and compiler cannot be interrupted. Models of plain elements take some milliseconds, whatever is in them (what repeats
or attaches parts, meshes, pictures, fields and what is soft is not plain), and those of the package are known. Any other is compiled
in a process of its own with limits of time and memory. One that has passed is not tried again: by the hash of all its files.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from functools import lru_cache
from itertools import islice
from pathlib import Path

from wbmpc.errors import InputError
from wbmpc.input_file import read_file
from wbmpc.robots.limited_process import OutOfTime, run_limited
from wbmpc.robots.xml_text import MAX_TAGS

_OWN = Path(__file__).with_name("data").resolve()
_TAG = re.compile(rb"<\s*/?\s*([^\s/>]*)")
#: Bytes of one file that a model names, at most.
LARGEST = 256 * 1024 * 1024
#: Elements that are compiled in no time, of MJCF and URDF.
_PLAIN = frozenset(
    b"""?xml mujoco mujocoinclude include compiler option flag size statistic default worldbody body frame inertial joint freejoint geom
    site camera light actuator motor position velocity general damper sensor jointpos jointvel framepos framequat accelerometer gyro
    force torque touch contact exclude pair equality connect weld keyframe key visual global quality headlight map scale rgba
    robot link origin mass inertia collision geometry box cylinder sphere capsule material color parent child axis limit dynamics
    mimic calibration safety_controller""".split()
)


def try_model(path: Path, files: Iterable[Path], text: str | None = None) -> None:
    """Raise :class:`InputError` for a model that takes too long to compile, or too much memory. ``files``: the model, and all that it
    names; ``text``: of the model, where it is not in the file itself."""
    if _OWN in path.resolve().parents:
        return
    key = tuple((str(f), f.stat().st_mtime_ns, f.stat().st_size) for f in files)
    _try(str(path), key, text)


@lru_cache(maxsize=32)
def _try(path: str, files: tuple[tuple[str, int, int], ...], text: str | None) -> None:
    if all(
        map(
            _is_plain, [text.encode()] if text is not None else (read_file(Path(name), LARGEST) for name, _, _ in files)
        )
    ):
        return
    order = {"path": path} if text is None else {"text": text}
    try:
        answer = run_limited(order)
    except OutOfTime as limit:
        raise InputError(
            f"{path}: MuJoCo does not compile it within {limit}; smaller or fewer meshes, fields, pictures and flexible bodies are needed"
        ) from None
    if "error" in answer:
        raise InputError(f"{path}: MuJoCo cannot compile it: {' '.join(str(answer['error']).split())[:300]}")


def _is_plain(content: bytes) -> bool:
    """By its bytes, however a parser understands them: every < begins a plain element, an end or a comment."""
    names = (tag[1] for tag in islice(_TAG.finditer(content), MAX_TAGS))
    return all(n in _PLAIN or n.startswith(b"!--") for n in names)

"""An MPC as an object file with a C header, an example, and a file for CMake."""

from __future__ import annotations

import hashlib
import platform
from pathlib import Path

from wbmpc.checks import whole_number
from wbmpc.embedded.image import Export, Image, check_exportable, make_image
from wbmpc.embedded.interface import interface, public_names
from wbmpc.embedded.prefix import check_prefix
from wbmpc.embedded.texts import write_texts
from wbmpc.errors import InputError, KernelError
from wbmpc.kernel.codegen_target import Target, find_target, generating_for, register_width
from wbmpc.kernel.compiled import emit_problem
from wbmpc.kernel.object_file import Symbols, link, symbols
from wbmpc.mpc.mpc import MPC
from wbmpc.output_file import whole_file
from wbmpc.solver import compilation, controller, feedback

#: All that the object file may need from elsewhere: the C library's mathematics, and copies and zeros of memory.
ALLOWED = frozenset(
    {
        "sin",
        "cos",
        "tan",
        "sincos",
        "asin",
        "acos",
        "atan",
        "atan2",
        "sinh",
        "cosh",
        "tanh",
        "asinh",
        "acosh",
        "atanh",
        "exp",
        "log",
    }
    | {"log1p", "expm1", "pow", "fmax", "fmin", "floor", "ceil", "round", "trunc", "fmod", "hypot", "copysign", "erf"}
    | {"memcpy", "memset", "memmove"}
)


#: Samples of a reference at most: the block of memory has room for all of them.
MAX_SAMPLES = 100_000


def export(
    mpc: MPC, directory: str | Path, *, prefix: str = "controller", target: str = "native", samples: int = 100
) -> Export:
    """Write the controller of ``mpc``, as it is now, into ``directory``, for programs without Python.

    The files: ``PREFIX.o`` and ``PREFIX.h``, ``example.c``, ``CMakeLists.txt``, ``README.md``. The object file has everything from
    observation to input: :meth:`MPC.update` and :class:`Policy`, weights, references and the mode schedule as they are in ``mpc``,
    and the trajectories of :meth:`MPC.reset` to start from. It allocates nothing and keeps its state in one block of the caller's.
    Its only symbols are the functions of the header, which begin with ``prefix``. ``target``: "native", "x86-64-v3" or
    "aarch64". ``samples`` (1 to 100 000): of each reference, and events, that there is room for.

    Raises :class:`InputError` for another target or prefix, and for an MPC of which a part runs in Python alone.
    """
    check_prefix(prefix, public_names(prefix).values())
    check_exportable(mpc)
    whole_number("export: samples", samples, 1, MAX_SAMPLES)
    chosen, folder = find_target(target), Path(directory)
    image = make_image(mpc, samples)
    code = _object(mpc, image, chosen, prefix)
    found = _checked(code, prefix)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"export: '{folder}' cannot be made ({error.strerror})") from error
    with whole_file(folder / f"{prefix}.o") as path:
        path.write_bytes(code)
    done = Export(folder, prefix, target, len(code), found, image)
    write_texts(done, mpc, chosen)
    return done


def files(prefix: str, checked: bool = False) -> tuple[str, ...]:
    """Names of all files that an export writes; ``checked``: with those of :func:`wbmpc.embedded.check.check`."""
    records = ("observations.txt", "expected.txt") if checked else ()
    return (f"{prefix}.o", f"{prefix}.h", "example.c", "CMakeLists.txt", "README.md", *records)


def _object(mpc: MPC, image: Image, target: Target, prefix: str) -> bytes:
    with generating_for(target):
        problem, _ = emit_problem(mpc.solver.problem)
        features = _features(target, register_width())
        libraries = [library.optimized() for library in (compilation.LIBRARY, feedback.LIBRARY, controller.LIBRARY)]
    magic = int.from_bytes(
        hashlib.sha256(problem.encode() + image.words().tobytes()).digest()[:8], "little", signed=True
    )
    return link([interface(image, prefix, magic, features), problem, *libraries], target, public_names(prefix))


def _features(target: Target, width: int) -> tuple[str, ...] | None:
    """What a processor of the x86 family is searched for; None for others, and where this machine cannot write such code."""
    if not target.triple.startswith("x86_64") or platform.machine() not in ("x86_64", "AMD64"):
        return None
    if width == 2:
        return ()
    wide = ("avx512f", "avx512dq", "avx512bw", "avx512vl") if width == 8 else ()
    return ("fma", "avx", "bmi1", "avx2", "bmi2", *wide)


def _checked(code: bytes, prefix: str) -> Symbols:
    found = symbols(code)
    foreign = set(found.defined) ^ set(public_names(prefix).values())
    unknown = [name for name in found.undefined if name not in ALLOWED]
    if foreign or unknown:
        raise KernelError(f"export: the object file defines {sorted(foreign)} and needs {unknown}")
    return found

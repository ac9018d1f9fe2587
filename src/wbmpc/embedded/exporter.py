"""An MPC as an object file with a C header, an example, and a file for CMake."""

from __future__ import annotations

import ctypes
import hashlib
import platform
import re
from collections.abc import Iterable
from pathlib import Path

from wbmpc.checks import whole_number
from wbmpc.clearance import compilation as nearest_points
from wbmpc.embedded import keeps_clear
from wbmpc.embedded.image import Export, Image, check_exportable, make_image
from wbmpc.embedded.interface import POSES, interface, public_names
from wbmpc.embedded.texts import write_texts
from wbmpc.errors import InputError, KernelError
from wbmpc.kernel.codegen_target import Target, find_target, generating_for, register_width
from wbmpc.kernel.compiled import emit_problem
from wbmpc.kernel.object_file import Symbols, largest_frame, link, symbols
from wbmpc.kernel.scalar import DECLARATIONS, emit_function
from wbmpc.mpc.mpc import MPC
from wbmpc.output_file import whole_file
from wbmpc.solver import compilation, controller, feedback

#: Of C and C++, as far as a prefix could be one.
KEYWORDS = frozenset(
    """alignas alignof and and_eq asm auto bitand bitor bool break case catch char class compl concept const const_cast consteval
    constexpr constinit continue co_await co_return co_yield decltype default delete do double dynamic_cast else enum explicit export
    extern false float for friend goto if inline int long mutable namespace new noexcept not not_eq nullptr operator or or_eq private
    protected public register reinterpret_cast requires restrict return short signed sizeof static static_assert static_cast struct
    switch template this thread_local throw true try typedef typeid typename typeof union unsigned using virtual void volatile wchar_t
    while xor xor_eq main""".split()  # noqa: SIM905
)
#: Macros of compilers and of C's library, which no name may be.
_MACROS = frozenset(
    """linux unix i386 assert errno stdin stdout stderr offsetof complex imaginary isnan isinf isfinite isnormal signbit fpclassify
    va_start va_arg va_end va_copy setjmp thread_local""".split()  # noqa: SIM905
)
#: Headers of C's library: ``PREFIX.h`` would be found in their place.
_HEADERS = frozenset(
    """assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal stdalign stdarg stdatomic stdbool stdbit
    stdckdint stddef stdint stdio stdlib stdnoreturn string tgmath threads time uchar wchar wctype unistd""".split()  # noqa: SIM905
)
#: Targets that CMake makes, the example's, and the library of mathematics.
_TARGETS = frozenset(
    """all clean depend edit_cache example help install list_install_components m package package_source preinstall rebuild_cache
    test""".split()  # noqa: SIM905
)
_LONGEST = 64


def check_prefix(prefix: str, functions: Iterable[str]) -> None:
    """Raise :class:`InputError` for a prefix with which a program in C could not be built; ``functions``: names that begin with it."""
    reason = _reason(prefix, functions)
    if reason:
        raise InputError(
            f"export: prefix '{prefix}' {reason}; valid: a lower-case letter, then lower-case letters, digits and '_', at most "
            f"{_LONGEST} characters, no name of C, C++, CMake or C's library, as 'my_robot'"
        )


def _reason(prefix: str, functions: Iterable[str]) -> str | None:
    if not re.fullmatch("[a-z][a-z0-9_]*", prefix) or len(prefix) > _LONGEST:
        return "is no beginning of names"
    for names, what in (
        (KEYWORDS, "a word of C or C++"),
        (_MACROS, "a macro of C"),
        (_HEADERS, "a header of C's library"),
        (_TARGETS, "a target of CMake"),
    ):
        if prefix in names:
            return f"is {what}"
    if prefix.endswith("_t"):
        return "ends in '_t' as types of C's library do"
    taken = next((name for name in (prefix, *functions) if _in_the_library(name)), None)
    return None if taken is None else f"makes the name '{taken}', a function of C's library"


def _in_the_library(name: str) -> bool:
    """Python has C's library, and its mathematics, with it."""
    return hasattr(ctypes.CDLL(None), name)


#: All that the object file may need from elsewhere: the C library's mathematics, and copies and zeros of memory.
ALLOWED = frozenset(
    {
        "sin", "cos", "tan", "sincos", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "asinh", "acosh",
        "atanh", "exp", "log",
    }
    | {"log1p", "expm1", "pow", "fmax", "fmin", "floor", "ceil", "round", "trunc", "fmod", "hypot", "copysign", "erf"}
    | {"memcpy", "memset", "memmove"}
)  # fmt: skip


#: Stack [bytes] of all functions that call each other down to the problem's, measured and rounded up; and what is asked for at least.
ROW_OF_CALLS, SMALLEST_STACK = 24576, 65536
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
    with whole_file(folder / f"{prefix}.o", follow=False) as path:
        path.write_bytes(code)
    done = Export(folder, prefix, target, len(code), found, image, stack_needed(code))
    write_texts(done, mpc, chosen)
    return done


def files(prefix: str, checked: bool = False) -> tuple[str, ...]:
    """Names of all files that an export writes; ``checked``: with those of :func:`wbmpc.embedded.check.check`."""
    records = ("observations.txt", "expected.txt") if checked else ()
    return (f"{prefix}.o", f"{prefix}.h", "example.c", "CMakeLists.txt", "README.md", *records)


def stack_needed(code: bytes) -> int:
    """Stack [bytes] of the thread that calls the functions of an object: a row of functions of ours, then the problem's largest one."""
    return max(SMALLEST_STACK, -(-(ROW_OF_CALLS + largest_frame(code)) // 16384) * 16384)


def _object(mpc: MPC, image: Image, target: Target, prefix: str) -> bytes:
    with generating_for(target):
        problem, _ = emit_problem(mpc.solver.problem)
        features = _features(target, register_width())
        used = [compilation.LIBRARY, feedback.LIBRARY, controller.LIBRARY]
        if image.poses is not None:
            used += [nearest_points.LIBRARY, keeps_clear.LIBRARY]
        libraries: list[str | bytes] = [library.optimized() for library in used]
        if image.poses is not None:
            libraries.append("\n".join([DECLARATIONS, emit_function(image.poses, POSES)]))
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

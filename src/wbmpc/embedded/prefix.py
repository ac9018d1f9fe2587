"""What names in C may begin with: a prefix is a type, the beginning of functions, the name of files and a target of CMake."""

from __future__ import annotations

import ctypes
import re
from collections.abc import Iterable

from wbmpc.errors import InputError

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

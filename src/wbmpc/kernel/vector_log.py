"""The natural logarithm of eight numbers at a time, as LLVM IR that needs no library."""

from __future__ import annotations

from wbmpc.kernel.ir import LANES, Lines

_T, _INTEGERS, _TRUTHS = (f"<{LANES} x {t}>" for t in ("double", "i64", "i1"))
#: log 2 in two parts: the first has zeros at its end, so that its product with an exponent is exact.
_LN2 = 6.93147180369123816490e-01, 1.90821492927058770002e-10
#: Of FreeBSD msun, e_log.c: log((1 + s) / (1 − s)) = 2 s + s R(s²).
_EVEN = (3.999999999940941908e-01, 2.222219843214978396e-01, 1.531383769920937332e-01)
_ODD = (6.666666666666735130e-01, 2.857142874366239149e-01, 1.818357216161805012e-01, 1.479819860511658591e-01)
#: The high word of √½, where mantissas begin; and what aligns them with powers of two.
_ROOT, _ONE = 0x3FE6A09E << 32, 0x3FF00000 << 32
#: 2⁵²: added to the bits of a small integer, they are those of their sum as a double.
_MAGIC = 4503599627370496.0


class _Log(Lines):
    def __init__(self) -> None:
        self.lines, self.count = list[str](), 0

    def op(self, word: str, a: str, b: str | float) -> str:
        right = b if isinstance(b, str) else f"splat (double {b!r})"
        return self.new(f"{word} {_T} {a}, {right}")

    def integer(self, word: str, a: str, b: int) -> str:
        return self.new(f"{word} {_INTEGERS} {a}, splat (i64 {b})")

    def cast(self, value: str, of: str, to: str) -> str:
        return self.new(f"bitcast {of} {value} to {to}")

    def choose(self, comparison: str, bound: float | str, yes: str, no: str) -> str:
        """``yes`` where %x compares so, else ``no``."""
        where = self.op(f"fcmp {comparison}", "%x", bound)
        return self.new(f"select {_TRUTHS} {where}, {_T} {yes}, {_T} {no}")

    def polynomial(self, w: str, coefficients: tuple[float, ...]) -> str:
        total = f"splat (double {coefficients[-1]!r})"
        for c in reversed(coefficients[:-1]):
            total = self.op("fadd contract", self.op("fmul contract", total, w), c)
        return total


def emit_log() -> str:
    """``vector_log``: error below one unit in the last place; −∞ of zero, NaN of negative numbers."""
    o, tiny = _Log(), 2.2250738585072014e-308
    value = o.choose("olt", tiny, o.op("fmul", "%x", 2.0**54), "%x")
    bits = o.integer("add", o.cast(value, _T, _INTEGERS), _ONE - _ROOT)
    exponent = o.integer("or", o.integer("lshr", bits, 52), 0x433 << 52)
    k = o.op("fsub", o.cast(exponent, _INTEGERS, _T), _MAGIC + 1023.0)
    k = o.op("fsub", k, o.choose("olt", tiny, "splat (double 54.0)", "zeroinitializer"))
    mantissa = o.integer("add", o.integer("and", bits, (1 << 52) - 1), _ROOT)
    f = o.op("fsub", o.cast(mantissa, _INTEGERS, _T), 1.0)
    half = o.op("fmul", o.op("fmul", f, 0.5), f)
    s = o.op("fdiv", f, o.op("fadd", f, 2.0))
    z = o.op("fmul", s, s)
    w = o.op("fmul", z, z)
    even, odd = o.op("fmul", w, o.polynomial(w, _EVEN)), o.op("fmul", z, o.polynomial(w, _ODD))
    rest = o.op("fmul", s, o.op("fadd", half, o.op("fadd", even, odd)))
    low = o.op("fsub", o.op("fadd", rest, o.op("fmul", k, _LN2[1])), half)
    found = o.op("fadd", o.op("fadd", low, f), o.op("fmul", k, _LN2[0]))
    infinity = "splat (double 0x7FF0000000000000)"
    found = o.choose("oeq", infinity, infinity, found)
    found = o.choose("oeq", 0.0, "splat (double 0xFFF0000000000000)", found)
    found = o.choose("uge", 0.0, found, "splat (double 0x7FF8000000000000)")
    found = o.choose("uno", 0.0, "%x", found)
    head = f"define internal {_T} @vector_log({_T} %x) nounwind memory(none) {{"
    return "\n".join([head, *o.lines, f"ret {_T} {found}", "}"])

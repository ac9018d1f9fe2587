"""Fixed-size dense kernels as LLVM IR with vectors of eight doubles.

Storage of a matrix: contiguous vectors ("columns") of padded length, one after the other; ``ld`` is their distance
[doubles]. Eight lanes are split by LLVM into what the target has.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from wbmpc.kernel.ir import LANES, Lines

V = "<8 x double>"
FMA = f"declare {V} @llvm.fmuladd.v8f64({V}, {V}, {V})"
ABSOLUTE = f"declare {V} @llvm.fabs.v8f64({V})"
ALIGN = 64
#: A vector of memory: array and offset [doubles].
Place = tuple[str, int]
#: A vector of a column: array and number.
Part = tuple[str, int]

#: Where eight vectors of a square meet: even and odd entries, then pairs, then halves.
_MIXES = (
    ((0, 8, 2, 10, 4, 12, 6, 14), (1, 9, 3, 11, 5, 13, 7, 15), 1),
    ((0, 1, 8, 9, 4, 5, 12, 13), (2, 3, 10, 11, 6, 7, 14, 15), 2),
    ((0, 1, 2, 3, 8, 9, 10, 11), (4, 5, 6, 7, 12, 13, 14, 15), 4),
)


def pad(n: int) -> int:
    """The next multiple of eight."""
    return (n + 7) // 8 * 8


def transposed(names: Sequence[str], lines: list[str], prefix: str = "t") -> list[str]:
    """Eight vectors as the columns of a square, transposed; what it names begins with ``prefix``."""
    found = list(names)
    for number, (low, high, distance) in enumerate(_MIXES):
        result = list(found)
        for i in (i for i in range(LANES) if not i & distance):
            for target, order in ((i, low), (i + distance, high)):
                indices = ", ".join(f"i32 {q}" for q in order)
                pair = f"{V} {found[i]}, {V} {found[i + distance]}"
                result[target] = f"%{prefix}.{number}.{target}"
                lines.append(f"{result[target]} = shufflevector {pair}, <8 x i32> <{indices}>")
        found = result
    return found


class Body(Lines):
    """Straight-line vector code of one function with pointer arguments."""

    def __init__(self, name: str, arguments: str) -> None:
        parameters = ", ".join(f"ptr noalias %{a}" for a in arguments.split())
        self.lines = [f"define void @{name}({parameters}) nounwind {{"]
        self.count = 0

    def load(self, array: str, offset: int) -> str:
        return self.new(f"load {V}, ptr {self.address(array, offset)}, align {ALIGN}")

    def load_unaligned(self, array: str, offset: int) -> str:
        return self.new(f"load {V}, ptr {self.address(array, offset)}, align 8")

    def load_scalar(self, array: str, offset: int) -> str:
        return self.new(f"load double, ptr {self.address(array, offset)}")

    def store(self, value: str, array: str, offset: int) -> None:
        self.lines.append(f"store {V} {value}, ptr {self.address(array, offset)}, align {ALIGN}")

    def store_scalar(self, value: str, array: str, offset: int) -> None:
        self.lines.append(f"store double {value}, ptr {self.address(array, offset)}")

    def store_some(self, value: str, count: int, array: str, offset: int) -> None:
        """The first numbers of a vector, to anywhere."""
        part, address = f"<{count} x double>", self.address(array, offset)
        lanes = ", ".join(f"i32 {q}" for q in range(count))
        some = self.new(f"shufflevector {V} {value}, {V} poison, <{count} x i32> <{lanes}>")
        self.lines.append(f"store {part} {some}, ptr {address}, align 8")

    def splat(self, scalar: str) -> str:
        one = self.new(f"insertelement {V} poison, double {scalar}, i32 0")
        return self.new(f"shufflevector {V} {one}, {V} poison, <8 x i32> zeroinitializer")

    def spread(self, a: str, lane: int) -> str:
        """One lane of a vector in all lanes."""
        return self.shuffle(a, "poison", [lane] * LANES)

    def spread_from(self, array: str, offset: int) -> str:
        """A number of memory in all lanes."""
        return self.splat(self.load_scalar(array, offset))

    def negate(self, a: str) -> str:
        return self.new(f"fneg {V} {a}")

    def fma(self, a: str, b: str, c: str) -> str:
        return self.new(f"call {V} @llvm.fmuladd.v8f64({V} {a}, {V} {b}, {V} {c})")

    def scale(self, a: str, b: str) -> str:
        return self.new(f"fmul {V} {a}, {b}")

    def extract(self, a: str, lane: int) -> str:
        return self.new(f"extractelement {V} {a}, i32 {lane}")

    def inverse(self, d: str) -> str:
        return self.new(f"fdiv double 1.0, {d}")

    def root(self, d: str) -> str:
        return self.new(f"call double @llvm.sqrt.f64(double {d})")

    def transpose(self, names: Sequence[str]) -> list[str]:
        """Eight vectors as the columns of a square, transposed."""
        self.count += 1
        return transposed(names, self.lines, f"t{self.count}")

    def add(self, a: str, b: str) -> str:
        return self.new(f"fadd {V} {a}, {b}")

    def subtract(self, a: str, b: str) -> str:
        return self.new(f"fsub {V} {a}, {b}")

    def larger(self, a: str, b: str) -> str:
        """Lane by lane the larger number, that of ``a`` where b is none."""
        mask = self.new(f"fcmp ogt {V} {b}, {a}")
        return self.new(f"select <8 x i1> {mask}, {V} {b}, {V} {a}")

    def absolute(self, a: str) -> str:
        return self.new(f"call {V} @llvm.fabs.v8f64({V} {a})")

    def sums(self, names: Sequence[str]) -> str:
        """The sum of each of eight vectors, fewer with zeros behind, in one vector."""
        found = [*names, *["zeroinitializer"] * (LANES - len(names))]
        for low, high, _ in _MIXES:
            pairs, found = list(zip(found[::2], found[1::2], strict=True)), []
            for a, b in pairs:
                parts = [self.shuffle(a, b, order) for order in (low, high)]
                found.append(self.add(*parts))
        return found[0]

    def shuffle(self, a: str, b: str, order: Sequence[int]) -> str:
        return self.new(f"shufflevector {V} {a}, {V} {b}, <8 x i32> <{', '.join(f'i32 {q}' for q in order)}>")

    def text(self) -> str:
        return "\n".join([*self.lines, "ret void", "}"])


def eliminate(
    b: Body, order: Sequence[int], parts: Sequence[Mapping[Part, int]], row: Callable[[int], tuple[Part, int]],
    budget: int, origin: Mapping[str, str], prepare: Callable[[int, dict[Part, str]], None] = lambda c, column: None,
) -> None:  # fmt: skip
    """Columns c of a symmetric matrix in ``order``: L Lᵀ = M in place, and the inverse of the diagonal into D[c].

    ``parts[c]``: where the column's vectors are; ``row(c)``: vector and lane of row c in every column; ``origin``: of arrays that are not
    changed in place, where columns come from; ``prepare``: what is done to a column first.
    A panel of columns stays in registers: it takes what all columns before it contribute, then its own. What the next column waits for is
    one division; the root that scales the column is found meanwhile.
    """
    wide = max(1, budget // max(len(part) for part in parts))
    for start in range(0, len(order), wide):
        panel = order[start : start + wide]
        held = {c: {p: b.load(origin.get(p[0], p[0]), offset) for p, offset in parts[c].items()} for c in panel}
        for c in panel:
            prepare(c, held[c])
        needed = {part for column in held.values() for part in column}
        for k in order[:start]:
            column = {part: b.load(part[0], offset) for part, offset in parts[k].items() if part in needed}
            for c in panel:
                part, lane = row(c)
                factor = b.negate(b.spread_from(part[0], parts[k][part] + lane))
                _subtract(b, held[c], column, factor)
        for number, c in enumerate(panel):
            part, lane = row(c)
            inverse = b.inverse(b.extract(held[c][part], lane))
            spread = b.negate(b.splat(inverse))
            for later in panel[number + 1 :]:
                part, lane = row(later)
                _subtract(b, held[later], held[c], b.scale(b.spread(held[c][part], lane), spread))
            root = b.root(inverse)
            b.store_scalar(root, "D", c)
            spread = b.splat(root)
            for part, offset in parts[c].items():
                b.store(b.scale(held[c][part], spread), part[0], offset)


def _subtract(b: Body, held: dict[Part, str], column: Mapping[Part, str], minus: str) -> None:
    """A multiple of a finished column from one that is held."""
    for part in held:
        if part in column:
            held[part] = b.fma(column[part], minus, held[part])


def reverse_cholesky(
    name: str, n: int, first: int, ld: int, touched: int = 0, blocks: int = 0, ldr: int = 8, budget: int = 24
) -> str:
    """Eliminate the last of n columns first: M_uu = U Uᵀ in place, the rows above (state and gradient) with it.

    Column j has its diagonal in row ``first + j``. Arguments L (columns), D (1 / diagonal of U), I, R: more rows, the first ``touched`` of
    n vectors (``blocks`` eights each, ``ldr`` apart) of I: R = U⁻¹ I.
    """
    b = Body(name, "L D I R")
    parts: list[dict[Part, int]] = []
    for j in range(n):
        parts.append({("L", i): j * ld + 8 * i for i in range((first + j) // 8 + 1)})
        if j < touched:
            parts[j] |= {("R", i): j * ldr + 8 * i for i in range(blocks)}
    eliminate(b, range(n - 1, -1, -1), parts, lambda j: (("L", (first + j) // 8), (first + j) % 8), budget, {"R": "I"})
    return b.text()


def schur_factor(name: str, n: int, lds: int, ldz: int, relative: float, budget: int = 24) -> str:
    """S + diag(relative S_qq + E_q) = L Lᵀ in place, Z ← Z L⁻ᵀ column by column, and the inverse diagonal in D.

    Arguments S (n columns), Z (n columns), E (n), D (n).
    """
    b = Body(name, "S Z E D")
    parts = [
        {("S", i): j * lds + 8 * i for i in range(j // 8, lds // 8)}
        | {("Z", i): j * ldz + 8 * i for i in range(ldz // 8)}
        for j in range(n)
    ]

    def soften_diagonal(j: int, column: dict[Part, str]) -> None:
        part = ("S", j // 8)
        more = b.new(f"fmul double {b.load_scalar('S', j * lds + j)}, {1.0 + relative!r}")
        more = b.new(f"fadd double {more}, {b.load_scalar('E', j)}")
        column[part] = b.new(f"insertelement {V} {column[part]}, double {more}, i32 {j % 8}")

    eliminate(b, range(n), parts, lambda j: (("S", j // 8), j % 8), budget, {}, soften_diagonal)
    return b.text()


def substitute(
    b: Body, order: Sequence[int], blocks: int, given: Callable[[int], Place], found: Place, ld: int,
    factor: Callable[[int, int], Place], negative: bool, budget: int,
) -> None:  # fmt: skip
    """X[j] = ± D[j] (T[j] ∓ Σ_k f(j, k) X[k]) over all k before j in ``order``, minus below where ``negative``.

    ``given(j)``: where T[j] is; ``found``: where X begins, ``ld`` apart; ``factor``: where f(j, k) is. Several rows at a time: they share
    the rows before them.
    """
    sign = (lambda a: a) if negative else b.negate
    wide, rows = max(1, budget // 2 // blocks), range(blocks)
    at = lambda j, i: (found[0], found[1] + j * ld + 8 * i)
    for start in range(0, len(order), wide):
        panel = order[start : start + wide]
        held = {j: [b.load(given(j)[0], given(j)[1] + 8 * i) for i in rows] for j in panel}
        for k in order[:start]:
            before = [b.load(*at(k, i)) for i in rows]
            for j in panel:
                by = sign(b.spread_from(*factor(j, k)))
                held[j] = [b.fma(before[i], by, held[j][i]) for i in rows]
        for number, j in enumerate(panel):
            for k in panel[:number]:
                by = sign(b.spread_from(*factor(j, k)))
                held[j] = [b.fma(held[k][i], by, held[j][i]) for i in rows]
            spread = b.spread_from("D", j)
            spread = b.negate(spread) if negative else spread
            held[j] = [b.scale(held[j][i], spread) for i in rows]
            for i in rows:
                b.store(held[j][i], *at(j, i))


def schur_forward(name: str, n: int, lds: int, ldz: int, budget: int = 24) -> str:
    """Z ← Z L⁻ᵀ column by column, from the first; arguments S (holds L), D, Z."""
    b = Body(name, "S D Z")
    substitute(
        b, range(n), ldz // 8, lambda j: ("Z", j * ldz), ("Z", 0), ldz, lambda j, q: ("S", q * lds + j), False, budget
    )
    return b.text()


def schur_back(name: str, n: int, lds: int, ldz: int, budget: int = 24) -> str:
    """Z ← Z L⁻¹, from the last column; arguments S (holds L), D, Z."""
    b, order = Body(name, "S D Z"), range(n - 1, -1, -1)
    substitute(
        b, order, ldz // 8, lambda j: ("Z", j * ldz), ("Z", 0), ldz, lambda j, q: ("S", j * lds + q), False, budget
    )
    return b.text()


def gains(
    name: str, n: int, first: int, ld: int, blocks: int, ldk: int, touched: int = 0, ldt: int = 8, budget: int = 24
) -> str:
    """K = −U⁻ᵀ T row by row; arguments L, D, T (the first ``touched`` rows of T, ``ldt`` apart; the others are in L), K."""
    b = Body(name, "L D T K")
    given = lambda j: ("T", j * ldt) if j < touched else ("L", j * ld)
    substitute(b, range(n), blocks, given, ("K", 0), ldk, lambda j, k: ("L", j * ld + first + k), True, budget)
    return b.text()


def soften(name: str, n: int, ld: int) -> str:
    """Y[q] ← Y[q] − E_q Z[q]; arguments Y, Z (n vectors each), E (n)."""
    b = Body(name, "Y Z E")
    for q in range(n):
        factor = b.negate(b.spread_from("E", q))
        for i in range(0, ld, 8):
            b.store(b.fma(b.load("Z", q * ld + i), factor, b.load("Y", q * ld + i)), "Y", q * ld + i)
    return b.text()


def mirror(name: str, n: int, ld: int) -> str:
    """The upper triangle of a symmetric matrix of n columns onto the lower one; argument P."""
    b = Body(name, "P")
    for i in range(0, n, 8):
        for j in range(i, n, 8):
            columns = range(j, min(j + 8, n))
            upper = [b.load("P", c * ld + i) for c in columns]
            lower = b.transpose([*upper, *["zeroinitializer"] * (8 - len(columns))])
            for c in range(i, min(i + 8, n)):
                value = lower[c - i]
                if i == j:
                    value = b.shuffle(upper[c - i], value, [q if q <= c - i else 8 + q for q in range(8)])
                b.store(value, "P", c * ld + j)
    return b.text()

"""Fixed-size dense kernels as LLVM IR with vectors of eight doubles.

Storage of a matrix: contiguous vectors ("columns") of padded length, one after the other; ``ld`` is their distance
[doubles]. Eight lanes are split by LLVM into what the target has.
"""

from __future__ import annotations

from wbmpc.kernel.ir import Lines

V = "<8 x double>"
FMA = f"declare {V} @llvm.fmuladd.v8f64({V}, {V}, {V})"
ALIGN = 64


def pad(n: int) -> int:
    """The next multiple of eight."""
    return (n + 7) // 8 * 8


class Body(Lines):
    """Straight-line vector code of one function with pointer arguments."""

    def __init__(self, name: str, arguments: str) -> None:
        parameters = ", ".join(f"ptr noalias %{a}" for a in arguments.split())
        self.lines = [f"define void @{name}({parameters}) nounwind {{"]
        self.count = 0

    def load(self, array: str, offset: int) -> str:
        return self.new(f"load {V}, ptr {self.address(array, offset)}, align {ALIGN}")

    def load_scalar(self, array: str, offset: int) -> str:
        return self.new(f"load double, ptr {self.address(array, offset)}")

    def store(self, value: str, array: str, offset: int) -> None:
        self.lines.append(f"store {V} {value}, ptr {self.address(array, offset)}, align {ALIGN}")

    def store_scalar(self, value: str, array: str, offset: int) -> None:
        self.lines.append(f"store double {value}, ptr {self.address(array, offset)}")

    def splat(self, scalar: str) -> str:
        one = self.new(f"insertelement {V} poison, double {scalar}, i32 0")
        return self.new(f"shufflevector {V} {one}, {V} poison, <8 x i32> zeroinitializer")

    def negate(self, scalar: str) -> str:
        return self.new(f"fneg double {scalar}")

    def fma(self, a: str, b: str, c: str) -> str:
        return self.new(f"call {V} @llvm.fmuladd.v8f64({V} {a}, {V} {b}, {V} {c})")

    def scale(self, a: str, b: str) -> str:
        return self.new(f"fmul {V} {a}, {b}")

    def extract(self, a: str, lane: int) -> str:
        return self.new(f"extractelement {V} {a}, i32 {lane}")

    def inverse_root(self, d: str) -> str:
        root = self.new(f"call double @llvm.sqrt.f64(double {d})")
        return self.new(f"fdiv double 1.0, {root}")

    def text(self) -> str:
        return "\n".join([*self.lines, "ret void", "}"])


def matrix_product(
    name: str, blocks: int, n: int, inner: int, lda: int, bj: int, bk: int, ldc: int, ldi: int | None, negative: bool,
    budget: int = 24,
) -> str:  # fmt: skip
    """C[:, j] = I[:, j] ± Σ_k A[:, k] B[j bj + k bk] for j < n, k < inner; arguments A, B, C, I.

    ``blocks``: vectors of eight per column; ``ldi`` None: no I; ``budget``: vectors of eight that the registers can add up.
    """
    if n == 0 or inner == 0:
        raise ValueError("empty product")
    tall = min(blocks, budget)
    width = max(1, min(8, budget // tall))
    o = [f"define void @{name}(ptr %A, ptr %B, ptr %C, ptr %I) nounwind {{", "entry:", "br label %b0"]
    tiles = [(row, j) for row in range(0, blocks, tall) for j in range(0, n, width)]
    for number, (row, j) in enumerate(tiles):
        rows = range(row, min(row + tall, blocks))
        columns = range(min(width, n - j))
        o += _tile(f"b{number}", rows, columns, j, inner, (lda, bj, bk, ldc, ldi), negative)
        o.append(f"br label %b{number + 1}" if number + 1 < len(tiles) else "ret void")
    return "\n".join([*o, "}"])


def _tile(
    p: str, rows: range, columns: range, j: int, inner: int, strides: tuple[int, int, int, int, int | None],
    negative: bool,
) -> list[str]:  # fmt: skip
    """One tile of a product: all of its sums stay in registers."""
    lda, bj, bk, ldc, ldi = strides
    cells = [(q, i) for q in columns for i in rows]
    o = [f"{p}:"]
    initial = {}
    for q, i in cells:
        if ldi is None:
            initial[q, i] = "zeroinitializer"
            continue
        o.append(f"%{p}.pi{q}.{i} = getelementptr double, ptr %I, i64 {(j + q) * ldi + 8 * i}")
        o.append(f"%{p}.i{q}.{i} = load {V}, ptr %{p}.pi{q}.{i}, align {ALIGN}")
        initial[q, i] = f"%{p}.i{q}.{i}"
    o += [f"br label %{p}l", f"{p}l:", f"%{p}.k = phi i64 [0, %{p}], [%{p}.k1, %{p}l]"]
    o += [f"%{p}.a{q}.{i} = phi {V} [{initial[q, i]}, %{p}], [%{p}.n{q}.{i}, %{p}l]" for q, i in cells]
    o.append(f"%{p}.ka = mul i64 %{p}.k, {lda}")
    for i in rows:
        o.append(f"%{p}.oa{i} = add i64 %{p}.ka, {8 * i}")
        o.append(f"%{p}.pa{i} = getelementptr double, ptr %A, i64 %{p}.oa{i}")
        o.append(f"%{p}.av{i} = load {V}, ptr %{p}.pa{i}, align {ALIGN}")
    o.append(f"%{p}.kb = mul i64 %{p}.k, {bk}")
    for q in columns:
        o.append(f"%{p}.ob{q} = add i64 %{p}.kb, {(j + q) * bj}")
        o.append(f"%{p}.pb{q} = getelementptr double, ptr %B, i64 %{p}.ob{q}")
        o.append(f"%{p}.s{q} = load double, ptr %{p}.pb{q}")
        if negative:
            o.append(f"%{p}.t{q} = fneg double %{p}.s{q}")
        scalar = f"%{p}.{'t' if negative else 's'}{q}"
        o.append(f"%{p}.e{q} = insertelement {V} poison, double {scalar}, i32 0")
        o.append(f"%{p}.v{q} = shufflevector {V} %{p}.e{q}, {V} poison, <8 x i32> zeroinitializer")
        for i in rows:
            operands = f"{V} %{p}.av{i}, {V} %{p}.v{q}, {V} %{p}.a{q}.{i}"
            o.append(f"%{p}.n{q}.{i} = call {V} @llvm.fmuladd.v8f64({operands})")
    o += [f"%{p}.k1 = add i64 %{p}.k, 1", f"%{p}.c = icmp eq i64 %{p}.k1, {inner}"]
    o += [f"br i1 %{p}.c, label %{p}x, label %{p}l", f"{p}x:"]
    for q, i in cells:
        o.append(f"%{p}.po{q}.{i} = getelementptr double, ptr %C, i64 {(j + q) * ldc + 8 * i}")
        o.append(f"store {V} %{p}.n{q}.{i}, ptr %{p}.po{q}.{i}, align {ALIGN}")
    return o


def reverse_cholesky(name: str, n: int, first: int, ld: int) -> str:
    """Eliminate the last of n columns first: M_uu = U Uᵀ in place, the rows above (state and gradient) with it.

    Column j has its diagonal in row ``first + j``. Arguments L (columns), D (1 / diagonal of U).
    """
    b = Body(name, "L D")
    for j in reversed(range(n)):
        blocks = (first + j) // 8 + 1
        acc = [b.load("L", j * ld + 8 * i) for i in range(blocks)]
        for k in range(j + 1, n):
            factor = b.splat(b.negate(b.load_scalar("L", k * ld + first + j)))
            acc = [b.fma(b.load("L", k * ld + 8 * i), factor, acc[i]) for i in range(blocks)]
        inverse = b.inverse_root(b.extract(acc[(first + j) // 8], (first + j) % 8))
        b.store_scalar(inverse, "D", j)
        spread = b.splat(inverse)
        for i in range(blocks):
            b.store(b.scale(acc[i], spread), "L", j * ld + 8 * i)
    return b.text()


def solve_transposed_rows(name: str, n: int, first: int, ld: int, blocks: int, ldr: int) -> str:
    """R[j] = (I[j] − Σ_{q>j} U[j, q] R[q]) / U[j, j], i.e. U⁻¹ applied to the rows of I; arguments L, D, I, R."""
    b = Body(name, "L D I R")
    for j in reversed(range(n)):
        acc = [b.load("I", j * ldr + 8 * i) for i in range(blocks)]
        for q in range(j + 1, n):
            factor = b.splat(b.negate(b.load_scalar("L", q * ld + first + j)))
            acc = [b.fma(b.load("R", q * ldr + 8 * i), factor, acc[i]) for i in range(blocks)]
        spread = b.splat(b.load_scalar("D", j))
        for i in range(blocks):
            b.store(b.scale(acc[i], spread), "R", j * ldr + 8 * i)
    return b.text()


def schur_factor(name: str, n: int, lds: int, ldz: int, relative: float) -> str:
    """S + diag(relative S_qq + E_q) = L Lᵀ in place, Z ← Z L⁻ᵀ column by column, and the inverse diagonal in D.

    Arguments S (n columns), Z (n columns), E (n), D (n).
    """
    b = Body(name, "S Z E D")
    sb, zb = lds // 8, ldz // 8
    for j in range(n):
        diagonal = b.load_scalar("S", j * lds + j)
        more = b.new(f"fmul double {diagonal}, {1.0 + relative!r}")
        more = b.new(f"fadd double {more}, {b.load_scalar('E', j)}")
        b.store_scalar(more, "S", j * lds + j)
        acc = [b.load("S", j * lds + 8 * i) for i in range(sb)]
        rhs = [b.load("Z", j * ldz + 8 * i) for i in range(zb)]
        for q in range(j):
            factor = b.splat(b.negate(b.load_scalar("S", q * lds + j)))
            acc = [b.fma(b.load("S", q * lds + 8 * i), factor, acc[i]) for i in range(sb)]
            rhs = [b.fma(b.load("Z", q * ldz + 8 * i), factor, rhs[i]) for i in range(zb)]
        inverse = b.inverse_root(b.extract(acc[j // 8], j % 8))
        b.store_scalar(inverse, "D", j)
        spread = b.splat(inverse)
        for i in range(sb):
            b.store(b.scale(acc[i], spread), "S", j * lds + 8 * i)
        for i in range(zb):
            b.store(b.scale(rhs[i], spread), "Z", j * ldz + 8 * i)
    return b.text()


def schur_forward(name: str, n: int, lds: int, ldz: int) -> str:
    """Z ← Z L⁻ᵀ column by column, from the first; arguments S (holds L), D, Z."""
    b = Body(name, "S D Z")
    zb = ldz // 8
    for j in range(n):
        acc = [b.load("Z", j * ldz + 8 * i) for i in range(zb)]
        for q in range(j):
            factor = b.splat(b.negate(b.load_scalar("S", q * lds + j)))
            acc = [b.fma(b.load("Z", q * ldz + 8 * i), factor, acc[i]) for i in range(zb)]
        spread = b.splat(b.load_scalar("D", j))
        for i in range(zb):
            b.store(b.scale(acc[i], spread), "Z", j * ldz + 8 * i)
    return b.text()


def soften(name: str, n: int, ld: int) -> str:
    """Y[q] ← Y[q] − E_q Z[q]; arguments Y, Z (n vectors each), E (n)."""
    b = Body(name, "Y Z E")
    for q in range(n):
        factor = b.splat(b.negate(b.load_scalar("E", q)))
        for i in range(0, ld, 8):
            b.store(b.fma(b.load("Z", q * ld + i), factor, b.load("Y", q * ld + i)), "Y", q * ld + i)
    return b.text()


def schur_back(name: str, n: int, lds: int, ldz: int) -> str:
    """Z ← Z L⁻¹, from the last column; arguments S (holds L), D, Z."""
    b = Body(name, "S D Z")
    zb = ldz // 8
    for j in reversed(range(n)):
        acc = [b.load("Z", j * ldz + 8 * i) for i in range(zb)]
        for k in range(j + 1, n):
            factor = b.splat(b.negate(b.load_scalar("S", j * lds + k)))
            acc = [b.fma(b.load("Z", k * ldz + 8 * i), factor, acc[i]) for i in range(zb)]
        spread = b.splat(b.load_scalar("D", j))
        for i in range(zb):
            b.store(b.scale(acc[i], spread), "Z", j * ldz + 8 * i)
    return b.text()


def gains(name: str, n: int, first: int, ld: int, ldl: int, blocks: int, ldk: int) -> str:
    """K = −U⁻ᵀ T row by row (T: n vectors, distance ``ldl``); arguments L, D, T, K."""
    b = Body(name, "L D T K")
    for j in range(n):
        acc = [b.load("T", j * ldl + 8 * i) for i in range(blocks)]
        for k in range(j):
            factor = b.splat(b.load_scalar("L", j * ld + first + k))
            acc = [b.fma(b.load("K", k * ldk + 8 * i), factor, acc[i]) for i in range(blocks)]
        spread = b.splat(b.negate(b.load_scalar("D", j)))
        for i in range(blocks):
            b.store(b.scale(acc[i], spread), "K", j * ldk + 8 * i)
    return b.text()

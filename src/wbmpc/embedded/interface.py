"""The functions that an exported controller offers: LLVM code that finds their arguments in the caller's block, and what C calls them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from wbmpc.embedded import keeps_clear
from wbmpc.embedded.image import Image
from wbmpc.kernel.compiled import SYMBOLS
from wbmpc.kernel.ir import INTS, NUM, NUMS
from wbmpc.kernel.scalar import literal
from wbmpc.solver import controller, controller_data
from wbmpc.solver.controller import Result
from wbmpc.solver.memory_layout import BASE
from wbmpc.solver.workspace import ADDRESSES

_LLVM = {"double": "double", "int": "i32"}
_PUBLIC = "public."
#: The function that gives the poses of a robot's frames.
POSES, POSES_ADDRESS = "poses", "w.own.parts.address"


@dataclass(frozen=True)
class Call:
    """A function of the interface: its name behind the prefix, the compiled function behind it, parameters after the block (type
    and name in C, and where it is not the same the name in the compiled function), what it does. ``solves``: it calls the
    problem's own functions."""

    name: str
    function: Any
    parameters: tuple[tuple[str, ...], ...]
    text: str
    solves: bool = False


_T = ("double", "t")
CALLS = (
    Call(
        "reset", controller.reset, (("const double", "x[NX]"), ("const double", "u[NU]")),
        "Forget the plan; the next update starts from a state and an input that are held over the horizon.",
    ),
    Call(
        "update", controller.update, (_T, ("const double", "x[NX]")),
        "A new plan from the state x at time t [s]. OK, KEPT (no usable plan came of it, the last one stays active), or an error.",
        solves=True,
    ),
    Call(
        "policy", controller.policy, (_T, ("const double", "x[NX]"), ("double", "u[NU]")),
        "The input at time t [s] in the state x: the plan with feedback, within the hard limits of the inputs.",
    ),
    Call(
        "planned", controller.planned, (_T, ("double", "x[NX]"), ("double", "u[NU]")),
        "The planned state and input at time t [s], without feedback.",
    ),
    Call(
        "set_reference", controller_data.set_reference,
        (("int", "reference", "slot"), ("int", "kind"), ("int", "samples"), ("const double *", "t"), ("const double *", "values", "v")),
        "What a term compares with from the next update on: samples at times t [s, absolute, not decreasing], values row by row.\n"
        "Before the first and after the last sample the end values hold.",
    ),
    Call(
        "set_schedule", controller_data.set_schedule, (("int", "events"), ("const double *", "t"), ("const int64_t *", "mode")),
        "Modes over absolute time: mode[0] up to t[0] [s], mode[i] from t[i - 1] on; events + 1 of them.",
    ),
    Call(
        "set_constants", controller_data.set_constants, (("int", "group"), ("const double *", "values", "v")),
        "The model's parameters, or the weights of a cost, from the next update on.",
    ),
    Call("figures", controller_data.figures, (("double", "out[FIGURES]"),), "What the controller reports: see the FIGURE enumeration."),
)  # fmt: skip


def calls(image: Image) -> list[Call]:
    """The functions of a controller: where a robot keeps its own parts apart, an update sees to that."""
    if image.poses is None:
        return list(CALLS)
    return [replace(call, function=keeps_clear.update) if call.name == "update" else call for call in CALLS]


def _c_name(parameter: Sequence[str]) -> str:
    return parameter[1].split("[")[0]


def _llvm_type(parameter: Sequence[str]) -> str:
    return "ptr" if "[" in parameter[1] or "*" in parameter[0] else _LLVM[parameter[0]]


def declaration(call: Call, prefix: str) -> str:
    """In C, without a semicolon."""
    own = [f"{p[0]}{'' if p[0].endswith('*') else ' '}{p[1]}" for p in call.parameters]
    upper = prefix.upper()
    text = ", ".join([f"{prefix} *controller", *own])
    for size in ("NX", "NU", "FIGURES"):
        text = text.replace(f"[{size}]", f"[{upper}_{size}]")
    return f"int {prefix}_{call.name}({text})"


def public_names(prefix: str) -> dict[str, str]:
    """Names of the functions in C, by those in the LLVM module."""
    return {f"{_PUBLIC}{name}": f"{prefix}_{name}" for name in ("create", *(call.name for call in CALLS))}


def interface(image: Image, prefix: str, magic: int, features: Sequence[str] | None) -> str:
    """The LLVM module. ``magic``: the first word of a block of this controller; ``features``: what of a processor of the x86 family
    is looked at (None: nothing)."""
    size = image.offsets()["end"]
    lines = [_data(f"@{prefix}.{name}", content) for name, content in image.constants.items()]
    lines += _declarations(prefix, calls(image))
    lines += _create(image, prefix, magic, size, features)
    if image.poses is not None:
        lines.append(f"declare void @{POSES}(ptr, ptr)")
    for call in calls(image):
        lines += _wrapper(call, image, prefix, magic)
    return "\n".join(lines)


def _data(name: str, content: np.ndarray) -> str:
    whole = content.dtype == np.int64
    kind = "i64" if whole else "double"
    items = ", ".join(f"{kind} {v if whole else literal(v)}" for v in content.ravel().tolist())
    return f"{name} = internal constant [{content.size} x {kind}] [{items}], align 64"


def _declarations(prefix: str, offered: Sequence[Call]) -> list[str]:
    functions = [call.function for call in offered] + [controller_data.fill]
    lines = []
    for f in functions:
        kinds = ["double" if k == NUM else "ptr" if k in (NUMS, INTS) else "i64" for k in f.signature.arguments]
        lines.append(f"declare void @{f.signature.symbol}.entry({', '.join([*kinds, 'ptr'])})")
    lines += [f"declare void @{name}()" for name in SYMBOLS]
    lines.append(f"define internal void @{prefix}.bind(ptr %b, ptr %o) nounwind {{")
    lines += [f"%p = getelementptr i64, ptr %o, i64 {BASE}", "%m = ptrtoint ptr %b to i64", "store i64 %m, ptr %p"]
    for i, name in enumerate(SYMBOLS):
        lines += [f"%p{i} = getelementptr i64, ptr %o, i64 {ADDRESSES + i}"]
        lines += [f"store i64 ptrtoint (ptr @{name} to i64), ptr %p{i}"]
    return [*lines, "ret void", "}"]


def _wrapper(call: Call, image: Image, prefix: str, magic: int) -> list[str]:
    parameters = [f"{_llvm_type(p)} %c.{p[2] if len(p) > 2 else _c_name(p)}" for p in call.parameters]
    given = {p.split("%c.")[1]: p for p in parameters}
    lines = [f"define i32 @{_PUBLIC}{call.name}({', '.join(['ptr %b', *parameters])}) nounwind {{", "%out = alloca i64"]
    lines += ["%magic = load i64, ptr %b", f"%own = icmp eq i64 %magic, {magic}"]
    lines += ["br i1 %own, label %go, label %no", "no:", f"ret i32 {Result.NOT_CREATED.value}", "go:"]
    offsets, passed = image.offsets(), []
    f = call.function
    known = {*image.areas, *image.constants, *image.numbers}
    places = [place for p in f.signature.parameters for place in p.places]
    for place, own, kind in zip(places, f.argument_names, f.signature.arguments, strict=True):
        name = place if place in known or place == POSES_ADDRESS else own
        if name == POSES_ADDRESS:
            passed.append(f"i64 ptrtoint (ptr @{POSES} to i64)")
        elif name in given:
            if given[name].startswith("i32"):
                lines.append(f"%w.{name} = sext {given[name]} to i64")
                passed.append(f"i64 %w.{name}")
            else:
                passed.append(given[name])
        elif name in image.areas:
            lines.append(f"%a.{name} = getelementptr i64, ptr %b, i64 {offsets[name]}")
            passed.append(f"ptr %a.{name}")
        elif name in image.constants:
            passed.append(f"ptr @{prefix}.{name}")
        else:
            value = image.numbers[name]
            passed.append(f"double {literal(value)}" if kind == NUM else f"i64 {value}")
    if call.solves:
        lines.append(f"call void @{prefix}.bind(ptr %a.m, ptr %a.o)")
    lines.append(f"call void @{f.signature.symbol}.entry({', '.join([*passed, 'ptr %out'])})")
    return [*lines, "%r = load i64, ptr %out", "%s = trunc i64 %r to i32", "ret i32 %s", "}"]


def _create(image: Image, prefix: str, magic: int, size: int, features: Sequence[str] | None) -> list[str]:
    words = image.words()
    words[0] = magic
    runs, values = _runs(words)
    lines = [_data(f"@{prefix}.runs", runs), _data(f"@{prefix}.words", values)]
    base = ' "target-cpu"="x86-64" "target-features"="+sse2"' if features is not None else ""
    lines += [
        f"define internal void @{prefix}.fill(ptr %b) nounwind noinline {{", "%out = alloca i64",
        f"call void @{controller_data.fill.signature.symbol}.entry(ptr %b, i64 {size}, ptr @{prefix}.runs, ptr @{prefix}.words,"
        f" i64 {runs.size // 2}, ptr %out)", "ret void", "}",
        f"define i32 @{_PUBLIC}create(ptr %b, i64 %size) nounwind{base} {{",
        f"%whole = icmp eq i64 %size, {8 * size}", "br i1 %whole, label %align, label %small",
        "small:", f"ret i32 {Result.WRONG_SIZE.value}",
        "align:", "%address = ptrtoint ptr %b to i64", "%rest = and i64 %address, 63", "%good = icmp eq i64 %rest, 0",
        "br i1 %good, label %processor, label %bad",
        "bad:", f"ret i32 {Result.NOT_ALIGNED.value}", "processor:",
    ]  # fmt: skip
    if features is not None:
        lines += _x86_check(features)
    return [*lines, f"call void @{prefix}.fill(ptr %b)", f"ret i32 {Result.OK.value}", "}"]


def _runs(words: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(first, length) of what is not zero in a block, gaps of up to three words included, and the words there."""
    found = np.flatnonzero(words)
    cuts = np.flatnonzero(np.diff(found) > 4)
    first, last = np.append(found[0], found[cuts + 1]), np.append(found[cuts], found[-1]) + 1
    values = np.concatenate([words[a:b] for a, b in zip(first, last, strict=True)])
    return np.stack([first, last - first], axis=1).ravel(), values


#: Of the x86 family: register of leaf 7 (or of leaf 1) and bit, by Intel's manual, volume 2A, CPUID.
_LEAF1, _LEAF7 = (
    {"fma": 12, "avx": 28},
    {"bmi1": 3, "avx2": 5, "bmi2": 8, "avx512f": 16, "avx512dq": 17, "avx512bw": 30, "avx512vl": 31},
)


def _x86_check(features: Sequence[str]) -> list[str]:
    """Return WRONG_PROCESSOR where a feature is missing, or where the system does not keep the wide registers."""
    asm = "asm sideeffect"
    one, seven = (sum(1 << bits[f] for f in features if f in bits) for bits in (_LEAF1, _LEAF7))
    state = 0xE6 if any(f.startswith("avx512") for f in features) else 0x06
    cpuid = f'call {{i32, i32, i32, i32}} {asm} "cpuid", "={{ax}},={{bx}},={{cx}},={{dx}},{{ax}},{{cx}},~{{dirflag}},~{{fpsr}},~{{flags}}"'
    signed = lambda bits: bits - (1 << 32) if bits >> 31 else bits
    saves = one | 1 << 27  # the system has switched XGETBV on
    return [
        f"%l1 = {cpuid}(i32 1, i32 0)", "%c1 = extractvalue {i32, i32, i32, i32} %l1, 2",
        f"%h1 = and i32 %c1, {signed(saves)}", f"%k1 = icmp eq i32 %h1, {signed(saves)}",
        "br i1 %k1, label %leaf7, label %lacks", "leaf7:", f"%l0 = {cpuid}(i32 0, i32 0)",
        "%c0 = extractvalue {i32, i32, i32, i32} %l0, 0", "%k0 = icmp uge i32 %c0, 7", "br i1 %k0, label %wide, label %lacks",
        "wide:", f"%l7 = {cpuid}(i32 7, i32 0)", "%c7 = extractvalue {i32, i32, i32, i32} %l7, 1",
        f"%h7 = and i32 %c7, {signed(seven)}", f"%k7 = icmp eq i32 %h7, {signed(seven)}",
        f'%x = call {{i32, i32}} {asm} "xgetbv", "={{ax}},={{dx}},{{cx}},~{{dirflag}},~{{fpsr}},~{{flags}}"(i32 0)',
        "%xa = extractvalue {i32, i32} %x, 0", f"%xs = and i32 %xa, {state}", f"%xk = icmp eq i32 %xs, {state}",
        "%all = and i1 %k7, %xk", "br i1 %all, label %fine, label %lacks",
        "lacks:", f"ret i32 {Result.WRONG_PROCESSOR.value}", "fine:",
    ]  # fmt: skip

"""The target: its features, LLVM IR to object code, object code to addresses."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cache
from threading import Lock
from typing import Any

import llvmlite
import llvmlite.binding as llvm

from wbmpc.errors import InputError, KernelError, unknown_name


@dataclass(frozen=True)
class Target:
    """A processor that code is generated for: LLVM's names of the platform and the processor, and features by commas."""

    triple: str
    cpu: str
    features: str = ""


#: Platforms and processors that code can be exported for; "native" is this machine.
TARGETS = {
    "x86-64-v3": Target("x86_64-unknown-linux-gnu", "x86-64-v3"),
    "aarch64": Target("aarch64-unknown-linux-gnu", "generic"),
}
#: Held while an option of LLVM is set that is of the whole process.
_OPTION = Lock()
#: What code is generated for where it is not this machine.
_CHOSEN: ContextVar[Target | None] = ContextVar("target", default=None)


def find_target(name: str) -> Target:
    """The target of a name. Raises :class:`InputError` for an unknown one."""
    if name == "native":
        return Target(llvm.get_default_triple(), *host_target())
    if name not in TARGETS:
        raise unknown_name("target", name, ("native", *TARGETS))
    return TARGETS[name]


@contextmanager
def generating_for(chosen: Target) -> Iterator[None]:
    """Within it, vector widths are those of ``chosen``."""
    token = _CHOSEN.set(chosen)
    try:
        yield
    finally:
        _CHOSEN.reset(token)


def target() -> tuple[str, str]:
    """CPU name and features of what code is generated for."""
    chosen = _CHOSEN.get()
    return host_target() if chosen is None else (chosen.cpu, chosen.features)


@cache
def host_target() -> tuple[str, str]:
    """CPU name and features; 512-bit vectors are asked for where the target has them.

    ``WBMPC_TARGET`` (name, or name and comma-separated features after a colon) compiles for another one of the same family.
    """
    name = os.environ.get("WBMPC_TARGET")
    if name:
        name, _, features = name.partition(":")
        return name, features
    features = llvm.get_host_cpu_features()
    flags = features.flatten()
    if features.get("avx512f"):
        flags += ",-prefer-256-bit"
    return llvm.get_host_cpu_name(), flags


def register_width() -> int:
    """How many doubles the target's registers hold: 8, 4 or 2."""
    name, flags = target()
    features = set(flags.split(","))
    wide = ("+avx512f" in features, "+avx2" in features or "+avx" in features)
    if "WBMPC_TARGET" in os.environ or _CHOSEN.get() is not None:
        wide = (wide[0] or name in _AVX512, wide[1] or name in _AVX2)
    return 8 if wide[0] else 4 if wide[1] else 2


def vector_budget() -> int:
    """How many vectors of eight doubles a product may add up in the target's registers, a few left for its operands."""
    width = register_width()
    if width == 8:
        return 24  # 32 registers of 8
    chosen = _CHOSEN.get()
    machine = platform.machine() if chosen is None else chosen.triple.split("-")[0]
    if width == 4 or machine in ("aarch64", "arm64"):
        return 6  # 16 registers of 4, or 32 of 2
    return 3  # 16 registers of 2


_AVX512 = ("skylake-avx512", "icelake-server", "sapphirerapids", "znver4", "znver5", "x86-64-v4")
_AVX2 = ("haswell", "broadwell", "skylake", "znver1", "znver2", "znver3", "x86-64-v3")


def target_text() -> str:
    """What cached code depends on besides its source."""
    return " ".join([*target(), llvmlite.__version__])


@cache
def _initialize() -> None:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()


#: In a process of its own, for LLVM says what it does not know on its standard error, and then may abort.
_TRY = """
import sys, llvmlite.binding as llvm
llvm.initialize_native_target(), llvm.initialize_native_asmprinter()
machine = llvm.Target.from_default_triple().create_target_machine(cpu=sys.argv[1], features=sys.argv[2], jit=True)
machine.emit_object(llvm.parse_assembly("define double @f(double %x) { ret double %x }"))
"""


@cache
def _check(name: str, features: str) -> None:
    """Raise :class:`InputError` for a processor or a feature that LLVM does not know."""
    done = subprocess.run([sys.executable, "-c", _TRY, name, features], capture_output=True, text=True)
    message = next((line for line in done.stderr.splitlines() if "not a recognized" in line), "")
    if done.returncode or message:
        raise InputError(
            f"WBMPC_TARGET: '{name}:{features}' is no target of this machine ({message or 'LLVM rejects it'}); valid: a processor such"
            " as x86-64-v3 or cortex-a76, and after a colon features such as +avx2,+fma"
        )


def machine_for(chosen: Target, opt: int) -> Any:
    """LLVM's machine for position-independent code of a target, on this machine or another one."""
    _initialize_all()
    found = llvm.Target.from_triple(chosen.triple)
    return found.create_target_machine(
        cpu=chosen.cpu, features=chosen.features, opt=opt, reloc="pic", codemodel="small"
    )


@cache
def _initialize_all() -> None:
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    llvm.initialize_native_asmparser()


def _machine(opt: int) -> Any:
    chosen = _CHOSEN.get()
    if chosen is not None:
        return machine_for(chosen, opt)
    _initialize()
    cpu, flags = target()
    if os.environ.get("WBMPC_TARGET"):
        _check(cpu, flags)
    return llvm.Target.from_default_triple().create_target_machine(cpu=cpu, features=flags, opt=opt, jit=True)


def compile_module(ir: str, optimize: int = 0) -> bytes:
    """Object code of an LLVM module; ``optimize``: level of the passes on the IR (the kernels need none)."""
    return emit(optimized(ir, optimize) if optimize else ir)


def optimized(ir: str, level: int) -> bytes:
    """An LLVM module after the passes of a level, as bitcode."""
    machine, module = _machine(2), parsed(ir)
    options = llvm.create_pipeline_tuning_options(speed_level=level)
    options.loop_vectorization = True
    builder = llvm.create_pass_builder(machine, options)
    builder.getModulePassManager().run(module, builder)
    return bytes(module.as_bitcode())


def emit(code: str | bytes) -> bytes:
    """Object code of an LLVM module: as text, or as bitcode that the passes have gone through."""
    return object_code(_machine(2 if isinstance(code, bytes) else 1), parsed(code))


def object_code(machine: Any, module: Any) -> bytes:
    """Object code of a parsed module.

    Without LLVM's loop strength reduction: it takes up to half of the time, and the code is not faster for it. LLVM has this option for a
    whole process alone: it is off again afterwards, for others that compile in this process.
    """
    with _OPTION:
        llvm.set_option("wbmpc", "-disable-lsr=true")
        try:
            return bytes(machine.emit_object(module))
        finally:
            llvm.set_option("wbmpc", "-disable-lsr=false")


def parsed(code: str | bytes) -> Any:
    """An LLVM module of text or bitcode. Raises :class:`KernelError` for what LLVM does not take."""
    try:
        return llvm.parse_bitcode(code) if isinstance(code, bytes) else llvm.parse_assembly(code)
    except RuntimeError as error:
        raise KernelError(f"the generated code was rejected: {str(error)[:400]}") from error


def load_object(code: bytes, symbols: Mapping[str, int] | None = None) -> Any:
    """An execution engine that holds the object code; ``symbols``: addresses of what it calls elsewhere."""
    for name, address in (symbols or {}).items():
        llvm.add_symbol(name, address)
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _machine(1))
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    return engine

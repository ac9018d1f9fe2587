"""Code for other processors. Truth: this processor's own results; the assembly that LLVM prints."""

from __future__ import annotations

import os
import platform
import re
import subprocess
import sys
from pathlib import Path

import llvmlite.binding as llvm
import numpy as np
import pytest

from effort import some, thorough
from toys import LinearQuadratic, hardened_pendulum, pendulum
from wbmpc.kernel.cache import cache_directory
from wbmpc.kernel.codegen_target import TARGETS, machine_for, object_code, parsed, vector_budget
from wbmpc.kernel.compiled import emit_problem
from wbmpc.kernel.object_file import largest_frame
from wbmpc.ocp import Transcription
from wbmpc.solver import compilation, receding  # noqa: F401  all functions of the library

SCRIPT = """
import numpy as np
from toys import hardened_pendulum
found = hardened_pendulum().solve(np.array([0.2, 0.5, 0.3, -0.4]))
assert found.status.name == "CONVERGED", found
print(np.concatenate([found.x.ravel(), found.u.ravel(), found.gain.ravel()]).tobytes().hex())
"""


def solved(target: str, cache: Path) -> np.ndarray:
    paths = os.pathsep.join([str(Path(__file__).parents[1]), *sys.path])
    environment = {**os.environ, "WBMPC_TARGET": target, "WBMPC_CACHE_DIR": str(cache), "PYTHONPATH": paths}
    command = [sys.executable, "-W", "error", "-c", SCRIPT]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=180)
    assert done.returncode == 0, done.stderr[-2000:]
    return np.frombuffer(bytes.fromhex(done.stdout.strip()))


@pytest.mark.skipif(platform.machine() != "x86_64", reason="forces x86-64 features")
def test_narrow_vectors_give_the_same_solution(tmp_path: Path) -> None:
    """The host's, AVX2 with fused multiply-add, and the baseline of x86-64 (SSE2)."""
    found = hardened_pendulum().solve(np.array([0.2, 0.5, 0.3, -0.4]))
    own = np.concatenate([found.x.ravel(), found.u.ravel(), found.gain.ravel()])
    targets = some(["x86-64-v3:", "x86-64:"], [1])
    for target in targets:
        np.testing.assert_allclose(solved(target, tmp_path), own, rtol=1e-6, atol=1e-7)
    entries = {path.name for path in tmp_path.glob("*.bin")}
    assert len(entries) == 4 * len(targets)  # the driver twice: also as bitcode, for exports
    # no entry serves another target's code
    assert entries.isdisjoint(path.name for path in cache_directory().glob("*.bin"))


@pytest.mark.parametrize(
    ("target", "budget"), [("x86-64-v4:", 24), ("haswell:", 6), ("x86-64:", 3), ("any:+avx512f", 24)]
)
def test_registers_of_the_target(target: str, budget: int, monkeypatch: pytest.MonkeyPatch) -> None:
    from wbmpc.kernel import codegen_target as machine

    machine.host_target.cache_clear()
    monkeypatch.setenv("WBMPC_TARGET", target)
    try:
        if platform.machine() == "x86_64":
            assert vector_budget() == budget
    finally:
        machine.host_target.cache_clear()


@pytest.mark.parametrize("target", ["nonsense:", "x86-64-v3:+nonsense"])
def test_a_target_that_llvm_does_not_know_is_rejected(target: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """LLVM ignores some and ends the process for others."""
    from wbmpc.errors import InputError
    from wbmpc.kernel import codegen_target as machine

    machine.host_target.cache_clear()
    monkeypatch.setenv("WBMPC_TARGET", target)
    try:
        with pytest.raises(InputError, match=r"WBMPC_TARGET: '.*' is no target of this machine"):
            machine.compile_module("")
    finally:
        machine.host_target.cache_clear()


def assembly(ir: str, triple: str, cpu: str) -> str:
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    machine = llvm.Target.from_triple(triple).create_target_machine(cpu=cpu, features="", opt=1)
    module = llvm.parse_assembly(ir)
    module.triple = triple
    assert len(machine.emit_object(module)) > 10000
    return str(machine.emit_assembly(module))


@pytest.mark.parametrize("what", ["problem", pytest.param("driver", marks=thorough)])
def test_code_for_aarch64(what: str) -> None:
    """Generated, not run: vector and scalar fused multiply-add, no call but to the maths library."""
    if what == "problem":
        ir, _ = emit_problem(Transcription(LinearQuadratic(5, 4, 2).problem()))
    else:
        ir = compilation.LIBRARY.source()
    text = assembly(ir, "aarch64-unknown-linux-gnu", "cortex-a76")
    calls = set(re.findall(r"^\s+bl\s+(\w+)$", text, re.M))
    own = set(re.findall(r"^(\w+):", text, re.M))
    assert calls - own <= {"sin", "cos", "tan", "exp", "log", "pow", "atan2", "asin", "acos", "atan"}
    assert "fmadd" in text or "fmla" in text
    if what == "problem":
        assert len(re.findall(r"fml[as]\s+v\d+\.2d", text)) > 100


def test_the_pendulum_uses_more_than_one_kernel() -> None:
    """What the target test solves has equality rows, general rows and boxes."""
    t = pendulum().problem
    assert t.equality.shape[0] and t.path.barriers and t.path.general_barriers


@pytest.mark.parametrize("target", ["x86-64-v3", "aarch64"])
@pytest.mark.parametrize("size", [5000, 20_000, 70_000])
def test_the_largest_frame_is_no_less_than_what_a_function_keeps(target: str, size: int) -> None:
    """Truth: an array that goes to another function, whose address it has."""
    ir = f"declare void @use(ptr)\ndefine void @f() {{\n%a = alloca [{size} x i8]\ncall void @use(ptr %a)\nret void\n}}"
    code = object_code(machine_for(TARGETS[target], 1), parsed(ir))
    assert size <= largest_frame(code) < size + 4096 + 64


LOOP = """define double @f(ptr %x, i64 %n) {
entry:
br label %pass
pass:
%i = phi i64 [0, %entry], [%next, %pass]
%total = phi double [0.0, %entry], [%sum, %pass]
%twice = mul i64 %i, 24
%at = getelementptr i8, ptr %x, i64 %twice
%value = load double, ptr %at
%sum = fadd double %total, %value
%next = add i64 %i, 1
%done = icmp eq i64 %next, %n
br i1 %done, label %out, label %pass
out:
ret double %sum
}"""


def test_others_compile_in_this_process_as_if_nothing_were_set() -> None:
    """Truth: LLVM's own code before and after, which counts addresses; ours counts passes."""
    target = machine_for(TARGETS["x86-64-v3"], 1)
    emitted = lambda: bytes(target.emit_object(parsed(LOOP)))
    before, own = emitted(), object_code(target, parsed(LOOP))
    assert own != before and emitted() == before

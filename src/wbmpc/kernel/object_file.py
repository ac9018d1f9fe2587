"""Several LLVM modules as one object file of which only chosen functions can be seen."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import llvmlite.binding as llvm

from wbmpc.errors import KernelError
from wbmpc.kernel.codegen_target import Target, machine_for, object_code, parsed


class Symbols(NamedTuple):
    """Of an object file: what others can link with, and what it needs from elsewhere."""

    defined: list[str]
    undefined: list[str]


def link(modules: Sequence[str | bytes], target: Target, names: Mapping[str, str]) -> bytes:
    """Position-independent object code of LLVM modules (text, or bitcode that passes have gone through). ``names``: of functions that
    others can link with, by those in the modules; everything else is internal, and dropped if nothing uses it."""
    machine = machine_for(target, 1)
    parts = [parsed(module) for module in modules]
    for part in parts:
        part.triple, part.data_layout = target.triple, str(machine.target_data)
    whole = parts[0]
    for part in parts[1:]:
        whole.link_in(part)
    for thing in (*whole.functions, *whole.global_variables):
        if not thing.is_declaration and thing.name not in names:
            # no name of theirs is in the way of a public one
            thing.linkage, thing.name = "internal", f"{thing.name}.internal"
    passes = llvm.create_new_module_pass_manager()
    passes.add_global_dead_code_eliminate_pass()
    passes.run(whole, llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=0)))
    for name, public in names.items():
        whole.get_function(name).name = public
    return object_code(machine, whole)


def symbols(code: bytes) -> Symbols:
    """What a 64-bit little-endian ELF object defines for others and needs, each sorted."""
    if code[:6] != b"\x7fELF\x02\x01":
        raise KernelError("the object code is not in the ELF format of 64-bit little-endian systems")
    defined: set[str] = set()
    undefined: set[str] = set()
    for name, info, section in _symbol_table(code):
        if (
            name and info >> 4 in (1, 2) and name != "_GLOBAL_OFFSET_TABLE_"
        ):  # global or weak; the linker makes that one
            (defined if section else undefined).add(name)
    return Symbols(sorted(defined), sorted(undefined))


def _symbol_table(code: bytes) -> Iterator[tuple[str, int, int]]:
    """(name, info, section) of every symbol, by the layout that the ELF specification gives."""
    (start,) = struct.unpack_from("<Q", code, 0x28)
    size, count, _ = struct.unpack_from("<HHH", code, 0x3A)
    sections = [struct.unpack_from("<IIQQQQIIQQ", code, start + i * size) for i in range(count)]
    for kind, offset, length, strings in ((s[1], s[4], s[5], s[6]) for s in sections):
        if kind != 2:  # SHT_SYMTAB
            continue
        names = sections[strings][4]
        for at in range(offset, offset + length, 24):
            name, info, _, section = struct.unpack_from("<IBBH", code, at)
            yield code[names + name : code.index(b"\0", names + name)].decode(), info, section


#: Machines of ELF files; frames [bytes] from this size on are no code of ours, but bytes that look like it.
_X86_64, _AARCH64, _MOST = 62, 183, 1 << 24


def largest_frame(code: bytes) -> int:
    """The most stack [bytes] that one function of an object takes at once: the largest number that its code takes from the stack pointer.

    As the manuals of both machines encode it: SUB RSP, imm32 (48 81 EC); SUB SP, SP, imm12, and that times 4096. Bytes that only look
    like such an instruction make it larger, not smaller."""
    (machine,) = struct.unpack_from("<H", code, 0x12)
    found = [0]
    for kind, flags, offset, length in _sections(code):
        if kind != 1 or not flags & 4:  # SHT_PROGBITS, SHF_EXECINSTR
            continue
        text = code[offset : offset + length]
        if machine == _X86_64:
            found += [
                size
                for (size,) in (struct.unpack("<I", m) for m in re.findall(rb"\x48\x81\xec(.{4})", text, re.DOTALL))
            ]
        elif machine == _AARCH64:
            words = struct.unpack(f"<{length // 4}I", text[: length // 4 * 4])
            sizes = [(w >> 22 & 1, w >> 10 & 0xFFF) for w in words if w & 0xFF8003FF == 0xD10003FF]
            # a large frame takes both
            found.append(sum(max((n << 12 * s for s, n in sizes if s == shifted), default=0) for shifted in (0, 1)))
    return max(size for size in found if size < _MOST)


def _sections(code: bytes) -> Iterator[tuple[int, int, int, int]]:
    """(kind, flags, offset, length) of every section."""
    (start,) = struct.unpack_from("<Q", code, 0x28)
    size, count, _ = struct.unpack_from("<HHH", code, 0x3A)
    for i in range(count):
        _, kind, flags, _, offset, length = struct.unpack_from("<IIQQQQ", code, start + i * size)
        yield kind, flags, offset, length

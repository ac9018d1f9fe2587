"""An exported controller for aarch64 in an emulator: the object file is linked here, by the ELF specification for the machine (ARM IHI 0056),
and runs in Unicorn. What it needs of the C library's mathematics is computed on this machine."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import unicorn
from unicorn import arm64_const as arm

PAGE = 4096
#: Where things are in the memory: code and its data, the caller's block, arguments, the end of the stack, foreign functions (a branch
#: reaches 128 MB).
CODE, BLOCK, ARGUMENTS, STACK, FOREIGN, RETURN = 0x10_0000, 0x1000_0000, 0x2000_0000, 0x4000_0000, 0x8_0000, 0x9_0000
ROOM = 0x10_0000
#: SHT_SYMTAB, SHT_RELA, SHT_NOBITS, SHF_ALLOC.
_SYMBOLS, _RELOCATIONS, _EMPTY, _LOADED = 2, 4, 8, 2
#: Of instructions with the low bits of an address: their types, and how far the bits are shifted by the size of what they load.
_LOW = {277: 0, 278: 0, 284: 1, 285: 2, 286: 3, 299: 4, 312: 3}
_ONE = {name: getattr(math, name) for name in (
    "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "exp", "log", "log1p", "expm1",
    "floor", "ceil", "trunc", "erf")} | {"round": lambda a: math.copysign(math.floor(abs(a) + 0.5), a)}  # fmt: skip
_TWO: dict[str, Callable[[float, float], float]] = {
    **{name: getattr(math, name) for name in ("atan2", "hypot", "fmod", "copysign")},
    "pow": lambda a, b: float(np.power(a, b)), "fmax": lambda a, b: float(np.fmax(a, b)), "fmin": lambda a, b: float(np.fmin(a, b)),
}  # fmt: skip


class Emulated:
    """The functions of an object file, by name; addresses are the emulator's."""

    def __init__(self, code: bytes) -> None:
        self.machine = unicorn.Uc(unicorn.UC_ARCH_ARM64, unicorn.UC_MODE_ARM)
        self.symbols: dict[str, int] = {}
        self.foreign: dict[int, str] = {}
        #: calls of each foreign function
        self.calls: dict[str, int] = {}
        self._load(code)
        for start, size in ((FOREIGN, PAGE), (RETURN, PAGE), (STACK - ROOM, ROOM), (ARGUMENTS, ROOM)):
            self.machine.mem_map(start, size)
        self.machine.hook_add(unicorn.UC_HOOK_CODE, self._answer, begin=FOREIGN, end=FOREIGN + PAGE)

    def _load(self, code: bytes) -> None:
        (machine,) = struct.unpack_from("<H", code, 0x12)
        assert machine == 183, "not an object file for aarch64"
        (start,), (_, count, _) = struct.unpack_from("<Q", code, 0x28), struct.unpack_from("<HHH", code, 0x3A)
        sections = [struct.unpack_from("<IIQQQQIIQQ", code, start + 64 * i) for i in range(count)]
        at, places = CODE, {}
        for i, (_, kind, flags, _, _, size, _, _, align, _) in enumerate(sections):
            if flags & _LOADED:
                places[i] = at = -(-at // max(align, 16)) * max(align, 16)
                at += size
            assert kind != 9, "relocations without addends"
        (table,) = (s for s in sections if s[1] == _SYMBOLS)
        names, symbols = sections[table[6]][4], []
        for k in range(table[4], table[4] + table[5], 24):
            name, info, _, section, value, _ = struct.unpack_from("<IBBHQQ", code, k)
            text = code[names + name : code.index(b"\0", names + name)].decode()
            if section == 0 and text:
                value = FOREIGN + 16 * len(self.foreign)
                self.foreign[value] = text
            elif section in places:
                value += places[section]
                if info >> 4 == 1:
                    self.symbols[text] = value
            symbols.append(value)
        memory = bytearray(at - CODE)
        for i, place in places.items():
            if sections[i][1] != _EMPTY:
                memory[place - CODE : place - CODE + sections[i][5]] = code[
                    sections[i][4] : sections[i][4] + sections[i][5]
                ]
        pointers = self._relocate(code, sections, places, symbols, memory, -(-at // 16) * 16)
        size = -(-(len(memory) + 8 * len(pointers) + 16) // PAGE) * PAGE
        self.machine.mem_map(CODE, size)
        self.machine.mem_write(CODE, bytes(memory))
        for place, value in pointers.values():
            self.machine.mem_write(place, struct.pack("<Q", value))

    @staticmethod
    def _relocate(
        code: bytes, sections: list[Any], places: dict[int, int], symbols: list[int], memory: bytearray, table: int
    ) -> dict[int, tuple[int, int]]:
        """The global offset table's entries, by symbol, from ``table`` on: (address, value)."""
        pointers: dict[int, tuple[int, int]] = {}
        for s in sections:
            if s[1] != _RELOCATIONS or s[7] not in places:
                continue
            for k in range(s[4], s[4] + s[5], 24):
                offset, info, addend = struct.unpack_from("<QQq", code, k)
                kind, symbol, place = info & 0xFFFFFFFF, info >> 32, places[s[7]] + offset
                target = symbols[symbol] + addend
                if kind in (311, 312):  # ADR_GOT_PAGE, LD64_GOT_LO12_NC
                    target = pointers.setdefault(symbol, (table + 8 * len(pointers), target))[0]
                here = place - CODE
                if kind == 257:  # ABS64
                    struct.pack_into("<Q", memory, here, target & (1 << 64) - 1)
                    continue
                if kind in (260, 261):  # PREL64, PREL32
                    struct.pack_into("<q" if kind == 260 else "<i", memory, here, target - place)
                    continue
                (word,) = struct.unpack_from("<I", memory, here)
                if kind in (282, 283):  # JUMP26, CALL26
                    word |= (target - place) >> 2 & 0x3FFFFFF
                elif kind in (275, 311):  # ADR_PREL_PG_HI21
                    pages = (target // PAGE - place // PAGE) & 0x1FFFFF
                    word |= (pages & 3) << 29 | pages >> 2 << 5
                else:
                    assert target % (1 << _LOW[kind]) == 0
                    word |= (target % PAGE >> _LOW[kind]) << 10
                struct.pack_into("<I", memory, here, word)
        return pointers

    def _answer(self, machine: Any, address: int, *_: object) -> None:
        """A function of the C library, and back to its caller."""
        name = self.foreign[address]
        self.calls[name] = self.calls.get(name, 0) + 1
        x = [machine.reg_read(r) for r in (arm.UC_ARM64_REG_X0, arm.UC_ARM64_REG_X1, arm.UC_ARM64_REG_X2)]
        if name in ("memcpy", "memmove"):
            machine.mem_write(x[0], bytes(machine.mem_read(x[1], x[2])))
        elif name == "memset":
            machine.mem_write(x[0], bytes([x[1] & 0xFF]) * x[2])
        else:
            registers = (arm.UC_ARM64_REG_D0, arm.UC_ARM64_REG_D1)
            a, b = (struct.unpack("<d", struct.pack("<Q", machine.reg_read(r)))[0] for r in registers)
            if name == "sincos":
                machine.mem_write(x[0], struct.pack("<d", math.sin(a)))
                machine.mem_write(x[1], struct.pack("<d", math.cos(a)))
                return self._back()
            try:
                found = float(_TWO[name](a, b) if name in _TWO else _ONE[name](a))
            except (ValueError, OverflowError):
                found = math.nan
            machine.reg_write(registers[0], struct.unpack("<Q", struct.pack("<d", found))[0])
        self._back()

    def _back(self) -> None:
        self.machine.reg_write(arm.UC_ARM64_REG_PC, self.machine.reg_read(arm.UC_ARM64_REG_LR))

    def call(self, name: str, *arguments: object) -> int:
        """The result [int] of a function; arrays are copied in before and back after, floats go in vector registers."""
        machine, integers, floats, arrays, at = self.machine, 0, 0, [], ARGUMENTS
        for value in arguments:
            if isinstance(value, float):
                machine.reg_write(arm.UC_ARM64_REG_D0 + floats, struct.unpack("<Q", struct.pack("<d", value))[0])
                floats += 1
                continue
            if isinstance(value, np.ndarray):
                machine.mem_write(at, value.tobytes())
                arrays.append((value, at))
                value, at = at, at + -(-value.nbytes // 64) * 64
            machine.reg_write(arm.UC_ARM64_REG_X0 + integers, value)
            integers += 1
        machine.reg_write(arm.UC_ARM64_REG_SP, STACK - 64)
        machine.reg_write(arm.UC_ARM64_REG_LR, RETURN)
        machine.emu_start(self.symbols[name], RETURN)
        for value, place in arrays:
            value[...] = np.frombuffer(machine.mem_read(place, value.nbytes), value.dtype).reshape(value.shape)
        return struct.unpack("<i", struct.pack("<I", machine.reg_read(arm.UC_ARM64_REG_X0) & 0xFFFFFFFF))[0]


class Controller:
    """An exported controller, called as in :class:`exported.Controller`."""

    def __init__(self, done: Any) -> None:
        self.prefix, self.size = done.prefix, done.block_size
        self.code = Emulated((done.directory / f"{done.prefix}.o").read_bytes())
        self.code.machine.mem_map(BLOCK, -(-self.size // PAGE) * PAGE)

    def __call__(self, name: str, *arguments: object) -> int:
        return self.code.call(f"{self.prefix}_{name}", BLOCK, *arguments)

    def create(self) -> int:
        return self("create", self.size)

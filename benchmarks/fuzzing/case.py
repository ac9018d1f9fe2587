"""What all generators of cases share: the case, values that nothing takes, and damage to bytes."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass

VALID, INVALID, OPEN = "valid", "invalid", "open"


@dataclass
class Case:
    """What to do, with what to expect: arguments of the command line, or a function.

    ``real``: the experiment is built and runs for a few ticks, instead of a stand-in that accepts its settings.
    """

    what: str
    expected: str
    arguments: list[str] | None = None
    call: Callable[[], object] | None = None
    real: bool = False


#: Values that no key takes, whatever it is.
NEVER = (
    "010", "-017", "1:30", "12:30:45", "!!python/object:os.system x", "!!int 3", "&a 1", "*a",
    "[" * 200, "{a: " * 100, "[1",
    "{a: 1, a: 2}", "{<<: {a: 1}}", '"\\ud800"', '"\\0"', '"\\UFFFFFFFF"', "9" * 5000, "1e999", "- [",
    "%YAML 1.1.1", "a: b: c",
    "0x_", "\t- 1", "@x", "`x`", "|\n\x01",
    "!<tag:x> 1", "{? [1] : 2}", "'",
)  # fmt: skip
#: Numbers that are none.
NOT_FINITE = (".nan", ".inf", "-.inf", "nan", "inf", "-Infinity", "[.nan, 1]", "{a: .inf}", ".NaN", "+.INF")
#: What looks like a number to some programs, and to some people.
STRANGE = (
    "\u0661\u0662", "\uff11", "\u00b2", "1\u00a0000", "1,5", "1 000", "1;2", "0b11", "0o7", "1e", "e5", "1e5e5", "--1", "1.2.3",
    "\ufeff1", "1\x00", "\x1b[31m1", "1\u2028", "half", "1/2", "5%", "1m", "2 kg", "\u221e",
)  # fmt: skip
_TOKENS = (
    "1", "-1", "0", "0.5", "1e3", "-.inf", ".nan", "true", "no", "null", "~", "a", "swerve-ur10", "[", "]", "{",
    "}", ",", ":", ": ",
    "- ", "\n", " ", "'", '"', "#", "&", "*", "!", "|", ">", "%", "?", "010", "1:30", "_", "+", "0x1", "\u00e9",
    "\u202e", "2020-01-01",
)  # fmt: skip


def soup(rng: random.Random) -> str:
    """Tokens of YAML in any order."""
    return "".join(rng.choice(_TOKENS) for _ in range(rng.randint(1, 12)))


def flipped(rng: random.Random, data: bytes) -> bytes:
    """Bytes of which a few are others."""
    out = bytearray(data)
    for _ in range(rng.randint(1, 8)):
        out[rng.randrange(len(out))] = rng.randrange(256)
    return bytes(out)

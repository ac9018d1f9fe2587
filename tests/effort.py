"""How much of the slow tests runs: ``make test`` takes a part of their draws, ``WBMPC_THOROUGH=1 make test`` all of them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TypeVar

import pytest

THOROUGH = bool(os.environ.get("WBMPC_THOROUGH"))
T = TypeVar("T")

#: A test that takes minutes and whose mechanism a shorter one covers.
thorough = pytest.mark.skipif(not THOROUGH, reason="a long run; set WBMPC_THOROUGH=1")


def draws(part: int, whole: int) -> int:
    """How many random cases a test takes."""
    return whole if THOROUGH else part


def some(cases: Sequence[T], part: Sequence[int]) -> list[T]:
    """The cases of a test, or those with the indices ``part``."""
    return list(cases) if THOROUGH else [cases[i] for i in part]

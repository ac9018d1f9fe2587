"""Gates of estimators: how large a weighed square of errors may be. (SciPy has it, and takes as long to import as a robot to load.)"""

from __future__ import annotations

import math


def tail(square: float, freedom: int) -> float:
    """The probability that the sum of ``freedom`` squares of unit normal numbers is larger than ``square``.

    Source: Abramowitz and Stegun, Handbook of Mathematical Functions (1964), equations 26.4.4 and 26.4.5.
    """
    half = 0.5 * square
    if freedom % 2:
        terms = (half ** (i - 0.5) / math.gamma(i + 0.5) for i in range(1, (freedom + 1) // 2))
        return math.erfc(math.sqrt(half)) + math.exp(-half) * sum(terms)
    return math.exp(-half) * sum(half**i / math.factorial(i) for i in range(freedom // 2))


def gate(freedom: int, probability: float) -> float:
    """The square that is exceeded with a ``probability`` between 0 and 1, by bisection."""
    low, high = 0.0, float(freedom)
    while tail(high, freedom) > probability:
        low, high = high, 2.0 * high
    while low < (middle := 0.5 * (low + high)) < high:
        low, high = (middle, high) if tail(middle, freedom) > probability else (low, middle)
    return high

"""Units for readers: 1.457 mm instead of 0.001457 m. Files keep SI units."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

#: By SI unit: (largest magnitude [SI unit], unit that is shown below it, shown per SI unit); the first that fits is taken.
_SCALES: dict[str, tuple[tuple[float, str, float], ...]] = {
    "m": ((1e-4, "µm", 1e6), (0.1, "mm", 1e3)), "m/s": ((0.1, "mm/s", 1e3),), "s": ((0.1, "ms", 1e3),),
    "rad": ((math.inf, "°", 180 / math.pi),), "rad/s": ((math.inf, "°/s", 180 / math.pi),),
    "m2": ((math.inf, "m²", 1.0),), "1": ((0.1, "%", 100.0),),
}  # fmt: skip


def rate_unit(unit: str) -> str:
    """The unit of a time derivative: "rad" gives "rad/s", "m/s" gives "m/s²"; "" where ``unit`` is not known."""
    return f"{unit.removesuffix('/s')}/s²" if unit.endswith("/s") else f"{unit}/s" if unit else ""


def force_unit(unit: str) -> str:
    """The unit of what moves a joint whose position is in ``unit``: "rad" gives "N m", "m" gives "N"; "" for others."""
    return {"rad": "N m", "m": "N"}.get(unit, "")


def with_unit(text: str, unit: str) -> str:
    """``text [unit]``; the text alone where the unit is not known."""
    return f"{text} [{unit}]" if unit else text


def by_unit(units: Sequence[str]) -> dict[str, list[int]]:
    """Places of components by their unit, in the order in which units come first: an axis of a plot has one."""
    found: dict[str, list[int]] = {}
    for i, unit in enumerate(units):
        found.setdefault(unit, []).append(i)
    return found


def number(value: float) -> str:
    """A figure with four significant digits."""
    if not math.isfinite(value):
        return "not a number" if math.isnan(value) else f"{value:g}"
    return f"{value:.4g}"


@dataclass(frozen=True)
class Scale:
    """The unit of a row of figures, and how many of it one SI unit is."""

    unit: str
    factor: float = 1.0

    def text(self, value: float | None) -> str:
        """A figure in SI units as a cell of a table; an empty one for None."""
        return "" if value is None else number(self.factor * value)


def scale(unit: str, *values: float | None) -> Scale:
    """The unit in which ``values`` [unit] read best, one for all of them: chosen by the largest. Figures that are not finite, zeros
    and None do not count; without any other one a unit that is shown for all sizes, or else, and for units that are not listed, the unit
    itself; none for numbers without a unit."""
    largest = max((abs(v) for v in values if v is not None and math.isfinite(v) and v), default=math.nan)
    for below, shown, factor in _SCALES.get(unit, ()):
        if largest < below or math.isinf(below):
            return Scale(shown, factor)
    return Scale("" if unit == "1" else unit)

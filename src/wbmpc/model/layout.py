"""Names and units of the entries of a vector, in groups."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wbmpc.checks import real_numbers
from wbmpc.errors import InputError, unknown_name


class Layout:
    """An ordered set of named groups of named scalars: ``layout["arm"]`` is a slice.

    ``groups``: names of the scalars by group; ``names``: all of them in order, as ``group.name``; ``size``: how many.
    ``units``: by group one text for all of its scalars, or a text for each ("m", "rad/s"); as attributes ``units`` are those of
    all scalars in order, ``unit_groups`` by group; "" where a unit is not known. Raises :class:`InputError` for units of a group
    that is not there or of another number.
    """

    def __init__(
        self, groups: Mapping[str, Sequence[str]], units: Mapping[str, str | Sequence[str]] | None = None
    ) -> None:
        self.groups = {group: tuple(names) for group, names in groups.items()}
        self._slices: dict[str, slice] = {}
        start = 0
        for group, names in self.groups.items():
            self._slices[group] = slice(start, start + len(names))
            start += len(names)
        self.size = start
        self.names = tuple(f"{group}.{name}" for group, names in self.groups.items() for name in names)
        for group in units or ():
            self[group]  # raises for one that is not there
        self.unit_groups = {group: self._own_units(group, (units or {}).get(group, "")) for group in self.groups}
        self.units = tuple(unit for own in self.unit_groups.values() for unit in own)

    def _own_units(self, group: str, units: str | Sequence[str]) -> tuple[str, ...]:
        count = len(self.groups[group])
        own = (units,) * count if isinstance(units, str) else tuple(units)
        if len(own) != count:
            raise InputError(f"units of group '{group}': one for each of its {count} entries is needed, got {len(own)}")
        return own

    def __getitem__(self, group: str) -> slice:
        try:
            return self._slices[group]
        except KeyError:
            raise unknown_name("group", group, self.groups) from None

    def __contains__(self, group: str) -> bool:
        return group in self.groups

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Layout) and self.groups == other.groups

    def __hash__(self) -> int:
        return hash(self.names)

    def __repr__(self) -> str:
        return f"Layout({self.groups})"

    def index(self, name: str) -> int:
        """Place of the scalar ``group.name``."""
        if name not in self.names:
            raise unknown_name("entry", name, self.names)
        return self.names.index(name)

    def vector(self, values: Mapping[str, ArrayLike], default: float = 0.0) -> NDArray[np.float64]:
        """A vector (size,) from ``values`` by group, each one number or one for each of its entries; ``default``: of other groups."""
        out = np.zeros(self.size)
        if default != 0.0:
            out[:] = default
        for group, value in values.items():
            part = self[group]
            array = real_numbers(f"group '{group}'", value)
            if array.ndim and array.shape != (part.stop - part.start,):
                raise InputError(f"group '{group}' has {part.stop - part.start} entries, got {array.size}")
            out[part] = array
        return out

    def split(self, vector: ArrayLike) -> dict[str, NDArray[np.float64]]:
        """The parts of a vector (size,) by group."""
        vector = real_numbers("vector", vector)
        if vector.shape != (self.size,):
            raise InputError(
                f"a vector of {self.size} entries is needed ({', '.join(self.groups)}), got {vector.shape}"
            )
        return {group: vector[part] for group, part in self._slices.items()}

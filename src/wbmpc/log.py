"""Recording: named channels of rows over time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from wbmpc.output_file import whole_file


class Log:
    """Channels, each with rows of the same width and their times [s].

    By channel ``names`` and ``units`` of a row's components, where they are known.
    """

    def __init__(self) -> None:
        self.names: dict[str, tuple[str, ...]] = {}
        self.units: dict[str, tuple[str, ...]] = {}
        self._times: dict[str, list[float]] = {}
        self._rows: dict[str, list[np.ndarray]] = {}

    def add(self, channel: str, t: float, value: object) -> None:
        """Append a row, ``value`` (width,) or one number, at time ``t`` [s]."""
        times = self._times.get(channel)
        if times is None:
            times = self._times[channel] = []
            self._rows[channel] = []
        times.append(float(t))
        self._rows[channel].append(np.array(value, float))

    def label(self, channel: str, names: Sequence[str], units: str | Sequence[str] = ()) -> None:
        """Say what the components of a channel's rows are called, and their units: one for all of them, or one for each."""
        self.names[channel] = tuple(names)
        own = (units,) * len(names) if isinstance(units, str) else tuple(units)
        if any(own):
            self.units[channel] = own

    def extend(self, other: Log, suffix: str, channels: Sequence[str] | None = None) -> None:
        """Append the rows of another log as CHANNEL + ``suffix``: of all its ``channels``, or of these."""
        for channel in other.channels if channels is None else channels:
            self._times.setdefault(f"{channel}{suffix}", []).extend(other._times[channel])
            self._rows.setdefault(f"{channel}{suffix}", []).extend(other._rows[channel])
            for own, found in ((self.names, other.names), (self.units, other.units)):
                if channel in found:
                    own[f"{channel}{suffix}"] = found[channel]

    @property
    def channels(self) -> list[str]:
        """Names of all channels."""
        return list(self._rows)

    def times(self, channel: str) -> np.ndarray:
        """Times (n,) of a channel [s]."""
        return np.array(self._times[channel])

    def array(self, channel: str) -> np.ndarray:
        """Rows of a channel, (n, width) or (n,) for scalars."""
        return np.array(self._rows[channel])

    def save(self, path: Path) -> None:
        """Write a NumPy archive, whole or not at all: CHANNEL and CHANNEL.time for each channel, CHANNEL.names and CHANNEL.units
        where components have them."""
        arrays = {c: self.array(c) for c in self._rows}
        arrays |= {f"{c}.time": self.times(c) for c in self._rows}
        for kind, found in (("names", self.names), ("units", self.units)):
            arrays |= {f"{c}.{kind}": np.array(own, str) for c, own in found.items() if c in self._rows}
        with whole_file(path) as partial:
            np.savez_compressed(partial, **arrays)  # type: ignore[arg-type]

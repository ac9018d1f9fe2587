"""Recording: named channels of rows over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from wbmpc.output_file import whole_file

#: Rows for which there is room at first.
_FIRST = 1024

#: Ends of the names of a log's arrays that hold texts.
TEXTS = (".names", ".units")


class Rows:
    """Channels that are written together at the same times, with one copy for all. ``values``: by channel what the next row will be, an array
    (width,) to write into."""

    def __init__(self, widths: Mapping[str, int | None]) -> None:
        """``widths`` by channel; None: one number."""
        ends = np.cumsum([1 if width is None else width for width in widths.values()]).tolist()
        self._next, self._count = np.zeros(ends[-1]), 0
        self._rows, self._times = np.zeros((_FIRST, ends[-1])), np.zeros(_FIRST)
        self._places: dict[str, slice | int] = {}
        for (channel, width), end in zip(widths.items(), ends, strict=True):
            self._places[channel] = end - 1 if width is None else slice(end - width, end)
        starts = [0, *ends]
        self.values = {c: self._next[starts[i] : starts[i + 1]] for i, c in enumerate(widths)}

    def add(self, t: float) -> None:
        """Append a row of :attr:`values` at time ``t`` [s]."""
        k = self._count
        if k == len(self._times):
            self._rows, self._times = (
                np.concatenate([part, np.zeros_like(part)]) for part in (self._rows, self._times)
            )
        self._rows[k], self._times[k], self._count = self._next, t, k + 1

    def times(self) -> np.ndarray:
        """Times (n,) [s]."""
        return self._times[: self._count].copy()

    def array(self, channel: str) -> np.ndarray:
        """Rows of a channel, (n, width) or (n,)."""
        return self._rows[: self._count, self._places[channel]].copy()


class Log:
    """Channels, each with rows of the same width and their times [s].

    By channel ``names`` and ``units`` of a row's components, where they are known.
    """

    def __init__(self) -> None:
        self.names: dict[str, tuple[str, ...]] = {}
        self.units: dict[str, tuple[str, ...]] = {}
        self._times: dict[str, list[float]] = {}
        self._rows: dict[str, list[np.ndarray]] = {}
        self._together: dict[str, Rows] = {}

    def together(self, widths: Mapping[str, int | None]) -> Rows:
        """New channels that are written together: ``widths`` of their rows, None for one number."""
        rows = Rows(widths)
        self._together |= dict.fromkeys(widths, rows)
        return rows

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
            self._times.setdefault(f"{channel}{suffix}", []).extend(other.times(channel).tolist())
            self._rows.setdefault(f"{channel}{suffix}", []).extend(other.array(channel))
            for own, found in ((self.names, other.names), (self.units, other.units)):
                if channel in found:
                    own[f"{channel}{suffix}"] = found[channel]

    @property
    def channels(self) -> list[str]:
        """Names of all channels."""
        return [*self._rows, *self._together]

    def times(self, channel: str) -> np.ndarray:
        """Times (n,) of a channel [s]."""
        rows = self._together.get(channel)
        return np.array(self._times[channel]) if rows is None else rows.times()

    def array(self, channel: str) -> np.ndarray:
        """Rows of a channel, (n, width) or (n,) for scalars."""
        rows = self._together.get(channel)
        return np.array(self._rows[channel]) if rows is None else rows.array(channel)

    def save(self, path: Path) -> None:
        """Write a NumPy archive, whole or not at all: CHANNEL and CHANNEL.time for each channel, CHANNEL.names and CHANNEL.units
        where components have them."""
        write_log(self, path)


def write_log(log: Log, path: Path, follow: bool = True) -> None:
    """As :meth:`Log.save`; ``follow``: as of :func:`~wbmpc.output_file.whole_file`."""
    arrays = {c: log.array(c) for c in log.channels}
    arrays |= {f"{c}.time": log.times(c) for c in log.channels}
    for kind, found in (("names", log.names), ("units", log.units)):
        arrays |= {f"{c}.{kind}": np.array(own, str) for c, own in found.items() if c in log.channels}
    with whole_file(path, follow) as partial:
        np.savez_compressed(partial, **arrays)  # type: ignore[arg-type]

"""Plots beside a replay: the whole run, with a line at the moment that is shown."""

from __future__ import annotations

import time
from collections.abc import Mapping

import numpy as np
import viser
from viser import uplot

from wbmpc.arrays import Array

#: Points of a line, at most; seconds between two updates of the moment's line.
POINTS, PERIOD = 400, 0.2
#: Number of a replay: title of its plot, and by how much it is multiplied for the title's unit.
_TITLES = {
    "error": ("End effector position error [mm]", 1e3), "solve": ("Solve time and deadline [ms]", 1e3),
    "clearance": ("Least clearance of the plan [mm]", 1e3), "speed": ("Largest joint speed [rad/s]", 1.0),
}  # fmt: skip
_BLUE, _AMBER, _GRAY = "#1f5fa8", "#b7791f", "#7b8894"


class ReplayPlots:
    """``numbers`` by name: times (n,) [s] and values (n,), in SI units; ``deadline`` [s] of the solve times (nan: none)."""

    def __init__(self, server: viser.ViserServer, numbers: Mapping[str, tuple[Array, Array]], deadline: float) -> None:
        self._shown, self._next, self._figures = np.nan, -np.inf, []
        chosen = [name for name in _TITLES if name in numbers and np.isfinite(numbers[name][1]).any()]
        if not chosen:
            return
        with server.gui.add_folder("Plots"):
            for name in chosen:
                title, factor = _TITLES[name]
                times, values = thinned(*numbers[name])
                lines = [factor * values]
                styles = [uplot.Series(label=name, stroke=_BLUE, width=1.5)]
                if name == "solve" and np.isfinite(deadline):
                    lines.append(np.full(times.size, factor * deadline))
                    styles.append(uplot.Series(label="deadline", stroke=_AMBER, width=1.5))
                styles.append(uplot.Series(label="now", stroke=_GRAY, width=1.5))
                handle = server.gui.add_uplot(
                    marked(times, lines, float(times[0])), (uplot.Series(label="t"), *styles), title=title, aspect=2.2,
                    scales={"x": uplot.Scale(time=False)}, legend=uplot.Legend(show=False),
                )  # fmt: skip
                self._figures.append((handle, times, lines))

    def show(self, t: float) -> None:
        """Put the line at time t [s]; at most once in :data:`PERIOD`, since every update goes to all pages."""
        now = time.monotonic()
        if t == self._shown or now < self._next:
            return
        self._shown, self._next = t, now + PERIOD
        for handle, times, lines in self._figures:
            handle.data = marked(times, lines, t)


def thinned(times: Array, values: Array) -> tuple[Array, Array]:
    """At most :data:`POINTS` finite points (n,), each the largest of its interval: a plot that leaves out peaks would show a better run."""
    known = np.isfinite(values)
    times, values = times[known], values[known]
    every = -(-times.size // POINTS)
    starts = np.arange(0, times.size, max(every, 1))
    return times[starts], np.maximum.reduceat(values, starts) if times.size else values


def marked(times: Array, lines: list[Array], t: float) -> tuple[Array, ...]:
    """Data of a plot: times, lines, and last a level line with a peak at time t [s] as high as they are.

    All numbers are finite: the plotting library finds no range where one is not.
    """
    k, together = int(np.searchsorted(times, t)), np.concatenate(lines)
    low, high = min(0.0, float(together.min())), float(together.max())
    drawn = (np.insert(line, k, np.interp([t, t, t], times, line)) for line in lines)
    return np.insert(times, k, [t, t, t]), *drawn, np.insert(np.full(times.size, low), k, [low, high, low])

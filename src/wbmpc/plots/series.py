"""Plots as data: lines, titles, labels with units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Series:
    """One line of a plot: its ``name``, ``x`` (n) and ``y`` (n) in the units of the plot's labels, whether it is ``dashed``.

    Lines of the same ``color`` (a number) look alike; left out: each has its own, and "NAME, reference", "NAME, planned" and the like
    have that of "NAME". ``signal``: what the line is of, where that is not in its name: lines of one signal share an entry of the
    legend. ``limits``: lowest and highest value that ``y`` may have (infinite: none), drawn dotted.
    """

    name: str
    x: np.ndarray
    y: np.ndarray
    dashed: bool = False
    color: int | None = None
    limits: tuple[float, float] | None = None
    signal: str = ""


@dataclass(frozen=True)
class Plot:
    """A plot of the report: its ``title``, the labels of its axes with their units (``x_label``, ``y_label``) and its lines (``series``);
    ``equal_axes``: a length is the same along both axes. Plots over "time [s]" share zoom and cursor."""

    title: str
    x_label: str
    y_label: str
    series: list[Series]
    equal_axes: bool = False


@dataclass(frozen=True)
class Drawing:
    """A picture of the report that is no plot, as SVG text."""

    title: str
    svg: str
    equal_axes = False

"""A way from above as a picture: the base's outline, legs and wheels at some moments, with what lies on the ground."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wbmpc.arrays import Array
from wbmpc.model.wheels import ModuleGeometry

#: Pixels per meter; half the height of a strip and its border [m]; colors.
_SCALE, _HALF, _BORDER = 110.0, 1.25, 1.1
_INK, _SOFT, _BODY, _WAY, _BUMP = "#1d2733", "#5c6b7a", "#46535f", "#c8102e", "#e6d3a8"


@dataclass(frozen=True)
class Snapshot:
    """The base at time ``t`` [s]: ``pose`` (x, y, yaw), ``leg`` and ``steer`` (n) [rad], which brakes are ``open`` (n)."""

    t: float
    pose: Array
    leg: Array
    steer: Array
    open: NDArray[np.bool_]


@dataclass(frozen=True)
class Ground:
    """Around the way, all in meters: ``boxes`` (x, y, half length, half width), round ``bumps`` (x, y, radius), ``cables`` (x)."""

    boxes: Sequence[tuple[float, float, float, float]] = ()
    bumps: Sequence[tuple[float, float, float]] = ()
    cables: Sequence[float] = ()


def storyboard(
    geometry: ModuleGeometry, body: tuple[float, float], way: Array, snapshots: Sequence[Snapshot], ground: Ground,
    rows: int = 3,
) -> str:  # fmt: skip
    """SVG text: a way along x (points ``way`` (k, 2) [m]) in ``rows`` strips from left to right, one below the other.

    ``body``: half length and half width [m] of the outline. Snapshots lie in the strip in which their center is; a hinge with
    an open brake is a ring, with a closed one a dot; a line in the outline points ahead.
    """
    start, end = float(way[:, 0].min()), float(way[:, 0].max())
    length = (end - start) / rows
    width, height = _SCALE * (length + 2.0 * _BORDER), 2.0 * _SCALE * _HALF
    parts = []
    for row in range(rows):
        left, last = start + row * length, row == rows - 1
        inside = [s for s in snapshots if left <= s.pose[0] < left + length or (last and s.pose[0] >= left)]
        if row == 0:
            inside = [s for s in snapshots if s.pose[0] < left] + inside
        drawn = [*_ground(ground, left - _BORDER, left + length + _BORDER), _path(way)]
        drawn += [part for s in inside for part in _base(geometry, body, s)]
        words = [_time(s, left, row * height) for s in inside]
        words += [
            _mark(x, left, (row + 1) * height)
            for x in range(int(np.ceil(left - 0.9 * _BORDER)), int(left + length + _BORDER))
        ]
        # meters, y upwards; the strip is cut off where the next one begins
        place = f"translate({-_SCALE * (left - _BORDER):.1f} {height * (row + 0.5):.1f}) scale({_SCALE} {-_SCALE})"
        parts.append(
            f'<svg x="0" y="{row * height:.1f}" width="{width:.0f}" height="{height:.0f}" '
            f'viewBox="0 {row * height:.1f} {width:.0f} {height:.0f}"><g transform="{place}">{"".join(drawn)}</g>'
            f"{''.join(words)}</svg>"
        )
    total = rows * height
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="{total:.0f}" '
        f'viewBox="0 0 {width:.0f} {total:.0f}" font-family="system-ui, sans-serif" font-size="13" fill="{_INK}">'
        f'<rect width="100%" height="100%" fill="white"/>{"".join(parts)}</svg>\n'
    )


def _line(a: Array, b: Array, color: str, width: float, more: str = "") -> str:
    return (
        f'<line x1="{a[0]:.3f}" y1="{a[1]:.3f}" x2="{b[0]:.3f}" y2="{b[1]:.3f}" stroke="{color}" '
        f'stroke-width="{width:.3f}" {more}/>'
    )


def _path(way: Array) -> str:
    points = " ".join(f"{x:.3f},{y:.3f}" for x, y in way)
    return f'<polyline points="{points}" fill="none" stroke="{_WAY}" stroke-width="0.012"/>'


def _ground(ground: Ground, low: float, high: float) -> list[str]:
    """What lies between two places [m] of the way."""
    near = lambda x: low <= x <= high
    parts = [
        f'<circle cx="{x}" cy="{y}" r="{r}" fill="{_BUMP}" stroke="#b79a55" stroke-width="0.01"/>'
        for x, y, r in ground.bumps
        if near(x)
    ]
    for x in filter(near, ground.cables):
        parts.append(_line(np.array([x, -_HALF]), np.array([x, _HALF]), "#2f6f4f", 0.025))
    for x, y, half_length, half_width in ground.boxes:
        parts.append(
            f'<rect x="{x - half_length:.3f}" y="{y - half_width:.3f}" width="{2 * half_length:.3f}" '
            f'height="{2 * half_width:.3f}" fill="#8a5a2b"/>'
        )
    return parts


def _base(g: ModuleGeometry, body: tuple[float, float], s: Snapshot) -> list[str]:
    """Outline, legs and wheels."""
    c, n = np.cos(s.pose[2]), np.sin(s.pose[2])
    world = lambda points: points @ np.array([[c, n], [-n, c]]) + s.pose[:2]
    corners = world(np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * body)
    points = " ".join(f"{x:.3f},{y:.3f}" for x, y in corners)
    ahead = world(np.array([[0.0, 0.0], [body[0], 0.0]]))
    parts = [
        f'<polygon points="{points}" fill="{_BODY}" fill-opacity="0.12" stroke="{_BODY}" stroke-width="0.015"/>',
        _line(ahead[0], ahead[1], _BODY, 0.02),
    ]
    hinges, feet = world(g.hinge), world(g.steer_axes(s.leg))
    heading = s.pose[2] + g.wheel_heading + g.leg_angles(s.leg) + s.steer
    along = g.wheel_radius * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    for hinge, foot, roll, is_open in zip(hinges, feet, along, s.open, strict=True):
        parts.append(_line(hinge, foot, _BODY, 0.05, 'stroke-linecap="round" stroke-opacity="0.6"'))
        parts.append(_line(foot - roll, foot + roll, _INK, 0.08))
        fill = "white" if is_open else _BODY
        parts.append(
            f'<circle cx="{hinge[0]:.3f}" cy="{hinge[1]:.3f}" r="0.035" fill="{fill}" stroke="{_BODY}" '
            'stroke-width="0.015"/>'
        )
    return parts


def _time(s: Snapshot, left: float, top: float) -> str:
    """When it was, above the base."""
    x = _SCALE * (s.pose[0] - left + _BORDER)
    return f'<text x="{x:.1f}" y="{top + 15.0:.1f}" text-anchor="middle">{s.t:.0f} s</text>'


def _mark(x: int, left: float, bottom: float) -> str:
    """A meter of the way with its number, below the base."""
    at = _SCALE * (x - left + _BORDER)
    return (
        f'<path d="M{at:.1f} {bottom:.1f}v-6" stroke="{_SOFT}"/>'
        f'<text x="{at:.1f}" y="{bottom - 9.0:.1f}" text-anchor="middle" fill="{_SOFT}">{x} m</text>'
    )

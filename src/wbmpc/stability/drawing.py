"""A stance from above as an SVG: polygon, regions, legs, center of mass, zero-moment point. The robot looks upwards."""

from __future__ import annotations

import html

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wbmpc.stability.assessment import Assessment
from wbmpc.stability.geometry import support_polygon
from wbmpc.stability.robot import standing

#: Pixels per meter, border [px], height of the text below the picture [px].
_SCALE, _BORDER, _TEXT = 260.0, 56.0, 66.0
_REGIONS = ["#8fc1e3", "#f2c58a", "#b5d99c", "#d8b4dd", "#f0a9a0", "#c9c9a3", "#a3cfcf", "#d9cbb8"]
_INK, _SOFT, _BODY = "#1d2733", "#5c6b7a", "#46535f"


class _Paper:
    """Meters, x upwards and y to the left, onto pixels."""

    def __init__(self, points: NDArray[np.float64]) -> None:
        low, high = points.min(axis=0) - 0.12, points.max(axis=0) + 0.12
        self.low, self.high = np.floor(low * 4.0) / 4.0, np.ceil(high * 4.0) / 4.0
        # not narrower than its words
        wider = max(0.0, 2.0 - (self.high[1] - self.low[1])) / 2.0
        self.low[1], self.high[1] = self.low[1] - wider, self.high[1] + wider
        self.width = _SCALE * (self.high[1] - self.low[1]) + 2.0 * _BORDER
        self.height = _SCALE * (self.high[0] - self.low[0]) + 2.0 * _BORDER
        self.parts: list[str] = []

    def at(self, point: ArrayLike) -> tuple[float, float]:
        x, y = np.asarray(point, float)[:2]
        return _BORDER + _SCALE * (self.high[1] - y), _BORDER + _SCALE * (self.high[0] - x)

    def polygon(self, corners: NDArray[np.float64], style: str) -> None:
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in map(self.at, corners))
        self.parts.append(f'<polygon points="{points}" {style}/>')

    def line(self, a: ArrayLike, b: ArrayLike, style: str) -> None:
        (x1, y1), (x2, y2) = self.at(a), self.at(b)
        self.parts.append(f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" {style}/>')

    def dot(self, point: ArrayLike, radius: float, style: str) -> None:
        x, y = self.at(point)
        self.parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius}" {style}/>')

    def text(self, x: float, y: float, words: str, style: str = "") -> None:
        self.parts.append(f'<text x="{x:.1f}" y="{y:.1f}" {style}>{html.escape(words)}</text>')


def draw(a: Assessment, path: NDArray[np.float64] | None = None) -> str:
    """The picture as SVG text; ``path`` (k, 2) [m]: a way of the zero-moment point."""
    modules, feet = standing(a.robot).modules, a.stance.feet
    body = feet if modules is None else modules.hinge
    zmp = a.stance.zmp if np.isfinite(a.stance.zmp).all() else feet.mean(axis=0)
    far = np.abs(feet).max() + 0.35
    paper = _Paper(np.vstack([feet, body, np.clip(zmp, -far, far)]))
    _grid(paper)
    for k, region in enumerate(a.regions):
        color = _REGIONS[k % len(_REGIONS)]
        for piece in region.pieces:
            # a stroke of the same color closes the seams between pieces
            paper.polygon(piece, f'fill="{color}" stroke="{color}" stroke-width="0.5"')
    for i in range(len(feet)):
        for j in range(i):
            paper.line(feet[i], feet[j], f'stroke="{_SOFT}" stroke-width="1" stroke-dasharray="5 4"')
    paper.polygon(support_polygon(feet), f'fill="none" stroke="{_INK}" stroke-width="2"')
    _robot(paper, a)
    if path is not None:
        way = " ".join(f"{x:.1f},{y:.1f}" for x, y in map(paper.at, path))
        paper.parts.append(f'<polyline points="{way}" fill="none" stroke="#c8102e" stroke-width="2.5"/>')
    _points(paper, a, far)
    _words(paper, a)
    height = paper.height + _TEXT
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{paper.width:.0f}" height="{height:.0f}" '
        f'viewBox="0 0 {paper.width:.0f} {height:.0f}" font-family="system-ui, sans-serif" font-size="13" fill="{_INK}">'
        f'<rect width="100%" height="100%" fill="white"/>{"".join(paper.parts)}</svg>\n'
    )


def _grid(paper: _Paper) -> None:
    """Lines every quarter meter with their coordinates every half."""
    style = 'stroke="#e8ecef" stroke-width="1"'
    for x in np.arange(paper.low[0], paper.high[0] + 1e-9, 0.25):
        paper.line((x, paper.low[1]), (x, paper.high[1]), style)
        if abs(x * 2.0 - round(x * 2.0)) < 1e-9:
            paper.text(_BORDER - 8.0, paper.at((x, 0.0))[1] + 4.0, f"{x:g}", f'text-anchor="end" fill="{_SOFT}"')
    for y in np.arange(np.ceil(4.0 * paper.low[1]) / 4.0, paper.high[1] + 1e-9, 0.25):
        paper.line((paper.low[0], y), (paper.high[0], y), style)
        if abs(y * 2.0 - round(y * 2.0)) < 1e-9:
            below = paper.height - _BORDER + 18.0
            paper.text(paper.at((0.0, y))[0], below, f"{y:g}", f'text-anchor="middle" fill="{_SOFT}"')
    paper.text(14.0, _BORDER - 16.0, "x [m], ahead", f'fill="{_SOFT}"')
    paper.text(_BORDER, paper.height - _BORDER + 34.0, "y [m], to the left", f'fill="{_SOFT}"')


def _robot(paper: _Paper, a: Assessment) -> None:
    """Body, legs and wheels, where the feet are steered wheels."""
    footprint = standing(a.robot)
    g, steered = footprint.modules, footprint.steered
    if g is None or steered is None:
        return
    headings = steered.headings(a.x)
    around = g.hinge[np.argsort(np.arctan2(*g.hinge.T[::-1]))]
    paper.polygon(around, f'fill="{_BODY}" fill-opacity="0.15" stroke="{_BODY}" stroke-width="1.5"')
    for hinge, foot, heading, name in zip(g.hinge, a.stance.feet, headings, a.names, strict=True):
        paper.line(hinge, foot, f'stroke="{_BODY}" stroke-width="7" stroke-linecap="round" stroke-opacity="0.55"')
        along = g.wheel_radius * np.array([np.cos(heading), np.sin(heading)])
        paper.line(foot - along, foot + along, f'stroke="{_INK}" stroke-width="9"')
        x, y = paper.at(foot)
        paper.text(x + (34.0 if foot[1] < 0.0 else -34.0), y + 4.0, name,
                   f'text-anchor="{"start" if foot[1] < 0.0 else "end"}"')  # fmt: skip


def _points(paper: _Paper, a: Assessment, far: float) -> None:
    paper.dot(a.stance.com, 6, f'fill="white" stroke="{_INK}" stroke-width="2"')
    zmp = a.stance.zmp
    if np.isfinite(zmp).all():
        paper.dot(np.clip(zmp, -far, far), 6, 'fill="#c8102e" stroke="white" stroke-width="1.5"')


def _words(paper: _Paper, a: Assessment) -> None:
    s, left, line = a.stance, _BORDER, 21.0
    paper.text(left, 24.0, f"{a.robot.description.name}, {a.title}", 'font-size="17" font-weight="600"')
    y = paper.height + 10.0
    rows = [f"support polygon {a.polygon_area:.2f} m², largest region of two triangles {a.double_support_area:.2f} m²"]
    if np.isfinite(s.zmp).all():
        rows.append(
            f"red: zero-moment point ({s.zmp[0]:.3f}, {s.zmp[1]:.3f}) m; white: center of mass, {s.mass:.1f} kg"
        )
        margin, region = 1e3 * s.polygon_margin, 1e3 * a.region_margin
        if margin > 0.0:
            rows.append(f"{margin:.0f} mm to the edge of the polygon, {region:.0f} mm to the next triangle")
        else:
            rows.append(f"{-margin:.0f} mm outside the support polygon: the robot tips over")
    else:
        rows.append("the load does not press on the ground: the robot lifts off")
    for k, row in enumerate(rows):
        paper.text(left, y + k * line, row)

"""The figure of docs/results/rooms.md: rooms from above, with the ways that the three methods take.

Usage: python scripts/rooms_figure.py [--study runs/rooms] [--out docs/images/rooms.svg]
Of the rooms of the study one is drawn in which the MPC alone does not pass, one in which only the planner does, and one in which all
methods do: of each kind one with most things, whose runs were the shortest. They are run again, with the study's settings.
"""

from __future__ import annotations

import argparse
import json
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet
from numpy.typing import NDArray
from rooms import METHODS, shared

from wbmpc import lie
from wbmpc.model.robot import load_robot
from wbmpc.mpc.route import base_part
from wbmpc.obstacles.scene import SceneObstacle
from wbmpc.obstacles.shapes import Box, Cylinder
from wbmpc.tasks.rooms import EXPERIMENT, Room, RoomSettings, draw_room

ROOT = Path(__file__).parents[1]
Array = NDArray[np.float64]
#: Which methods pass in the rooms that are drawn, in the order of :data:`METHODS`.
PASSING = ((False, True, True), (False, False, True), (True, True, True))
COLORS = {"alone": "#d1495b", "alternatives": "#1f5fa8", "planner": "#2a9d6f"}
#: Pixels per meter, between rooms and above them.
SCALE, APART, ABOVE = 42.0, 18.0, 56.0


def chosen(rows: list[dict[str, Any]]) -> list[tuple[int, int]]:
    """Things and seed of a room for each of :data:`PASSING`, as far as there are such."""
    rooms: dict[tuple[int, int], dict[str, bool]] = {}
    took: dict[tuple[int, int], float] = {}
    for r in shared(rows):
        room = int(r["set.things"]), int(r["seed"])
        rooms.setdefault(room, {})[r["condition"]] = r["metric.passed"] == 1.0
        took[room] = took.get(room, 0.0) + float(r["wall_time"])
    ordered = sorted(rooms, key=lambda room: (-room[0], took[room]))
    kinds = {room: tuple(rooms[room][m] for m in METHODS) for room in ordered}
    return [next(room for room in ordered if kinds[room] == asked) for asked in PASSING if asked in kinds.values()]


class Plan:
    """A room in pixels, its lower left corner at ``left``, ``high`` pixels over which y points up."""

    def __init__(self, low: Array, left: float, high: float) -> None:
        self._low, self._left, self._high = low, left, high
        self.parts: list[str] = []

    def at(self, points: Array) -> Array:
        """Points (n, 2) [m] in pixels."""
        off = SCALE * (np.atleast_2d(points)[:, :2] - self._low)
        return np.column_stack([self._left + off[:, 0], ABOVE + self._high - off[:, 1]])

    def obstacle(self, one: SceneObstacle) -> None:
        """What stands there, seen from above."""
        place = np.asarray(one.place["position"], float)
        if isinstance(one.shape, Cylinder):
            (x, y), r = self.at(place)[0], SCALE * one.shape.radius
            self.parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{r:.1f}" fill="#9aa3ad"/>')
        elif isinstance(one.shape, Box):
            turn = lie.quaternion_to_rotation(np.asarray(one.place.get("orientation", (1.0, 0.0, 0.0, 0.0)), float))
            half = np.asarray(one.shape.half, float)[:2]
            corners = place[:2] + (half * [[1, 1], [-1, 1], [-1, -1], [1, -1]]) @ turn[:2, :2].T
            self.parts.append(f'<polygon points="{_points(self.at(corners))}" fill="#9aa3ad"/>')

    def path(self, base: Array, method: str, passed: bool) -> None:
        """The way of the base (n, 2), with a cross where it ends without having passed."""
        line = f'points="{_points(self.at(base))}" fill="none" stroke="{COLORS[method]}" stroke-width="2.5"'
        self.parts.append(f'<polyline {line} stroke-linejoin="round"/>')
        if not passed:
            x, y = self.at(base[-1:])[0]
            cross = f"M{x - 6:.1f} {y - 6:.1f}l12 12m0 -12l-12 12"
            self.parts.append(f'<path d="{cross}" stroke="{COLORS[method]}" stroke-width="3"/>')

    def mark(self, place: Array, filled: bool) -> None:
        """Start (filled) or goal."""
        x, y = self.at(place)[0]
        self.parts.append(
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="5" stroke="#222" stroke-width="1.5" fill="{"#222" if filled else "#fff"}"/>'
        )


def _points(pixels: Array) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in pixels)


def drawn(rooms: list[tuple[str, Room, dict[str, tuple[Array, bool]]]], start: Array) -> str:
    """Rooms side by side: a title, what stands there, and the ways of the base by method with whether each passed."""
    parts, left, height = [], APART, 0.0
    for title, room, ways in rooms:
        walls = np.array([one.place["position"][:2] for one in room.scene if one.name.startswith("wall_")])
        low, high = walls.min(axis=0) - 0.1, walls.max(axis=0) + 0.1
        plan = Plan(low, left, SCALE * float(high[1] - low[1]))
        for one in room.scene:
            plan.obstacle(one)
        for method, (base, passed) in ways.items():
            plan.path(base, method, passed)
        plan.mark(start, True)
        plan.mark(room.goal, False)
        parts += [f'<text x="{left:.0f}" y="{ABOVE - 8:.0f}">{escape(title)}</text>', *plan.parts]
        left += SCALE * float(high[0] - low[0]) + APART
        height = max(height, SCALE * float(high[1] - low[1]))
    for k, (method, name) in enumerate(METHODS.items()):
        x = APART + 240 * k
        parts.append(f'<path d="M{x:.0f} 20h28" stroke="{COLORS[method]}" stroke-width="3"/>')
        parts.append(f'<text x="{x + 36:.0f}" y="25">{escape(name)}</text>')
    size = f'width="{left:.0f}" height="{ABOVE + height + APART:.0f}"'
    view = f'viewBox="0 0 {left:.0f} {ABOVE + height + APART:.0f}"'
    style = 'font-family="sans-serif" font-size="15" fill="#222"'
    ground = '<rect width="100%" height="100%" fill="#fff"/>'
    return f'<svg xmlns="http://www.w3.org/2000/svg" {size} {view} {style}>{ground}\n' + "\n".join(parts) + "\n</svg>\n"


def ways(settings: RoomSettings, seed: int) -> dict[str, tuple[Array, bool]]:
    """Base paths (n, 2) of the three methods and whether each passed."""
    found = {}
    for method, name in zip(METHODS, ("mpc", "alternatives", "planner"), strict=True):
        result = EXPERIMENT.run(settings.model_copy(update={"method": name}), seed)
        found[method] = result.log.array("base")[::20, :2], result.metrics["passed"].value == 1.0
    return found


def main() -> None:
    """Run the rooms that are chosen and write the figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--study", type=Path, default=ROOT / "runs" / "rooms")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images" / "rooms.svg")
    given = parser.parse_args()
    file = given.study / "runs.parquet"
    if not file.is_file():
        raise SystemExit(f"rooms: there is no {file}; wbmpc study rooms --out {given.study}")
    combinations = json.loads((given.study / "study.json").read_text())["combinations"].values()
    rooms, start = [], np.zeros(3)
    for things, seed in chosen(pyarrow.parquet.read_table(file).to_pylist()):
        asked = next(c["settings"] for c in combinations if c["settings"]["things"] == things)
        settings = RoomSettings.model_validate(asked)
        robot = load_robot(settings.robot)
        start = robot.home[base_part(robot, "rooms")]
        rooms.append((f"{things} things, seed {seed}", draw_room(settings, robot, seed), ways(settings, seed)))
        given.out.write_text(drawn(rooms, start))  # after each: the runs take long
    if not rooms:
        raise SystemExit("rooms: there is no room in which every method has a run")


if __name__ == "__main__":
    main()

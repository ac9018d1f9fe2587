"""What nearest points of a robot and obstacles cost: the compiled engine, the parameters of all rows of a plan, points that become rows.

Usage: python benchmarks/nearest_points.py [--robot swerve-ur10] [--nodes 50] [--pairs 50] [--obstacles 10]

``pairs`` of boxes and cylinders that are all within reach, at states along a motion; then a robot with its rows among obstacles; then a
scan of a room, from its points to rows of a map of 6 x 6 x 2 m with cells of 5 cm. Processor times, the quickest of many.
"""

from __future__ import annotations

import argparse
import itertools
import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np

import wbmpc as wb
from wbmpc import lie
from wbmpc.clearance.nearest import with_sides
from wbmpc.clearance.rows import ObstacleRows, SelfRows
from wbmpc.clearance.table import SolidTable
from wbmpc.obstacles.solids import Solid

CALLS = 50


def quickest(function: Callable[[], Any]) -> float:
    """[ms]"""
    times = []
    for _ in range(CALLS):
        before = time.process_time()
        function()
        times.append(time.process_time() - before)
    return 1e3 * min(times)


def engine(nodes: int, pairs: int) -> float:
    """One shape of a robot that moves past ``pairs`` others [ms]."""
    rng = np.random.default_rng(0)
    moving: Any = SimpleNamespace(
        shapes=[SimpleNamespace(solid=Solid("cylinder", np.array([0.1, 0.3, 0.0])))], frame_of=np.zeros(1, int)
    )
    table = SolidTable(moving)
    others = [Solid(("box", "cylinder")[k % 2], rng.uniform(0.1, 0.3, 3)) for k in range(pairs)]
    places = np.tile(rng.uniform(-1.5, 1.5, (1, pairs, 3)) + [0.0, 0.0, 2.5], (nodes, 1, 1))
    turns = np.array([lie.quaternion_to_rotation(q / np.linalg.norm(q)) for q in rng.normal(size=(pairs, 4))])
    position = np.linspace([-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], nodes)[:, None]
    rotation, limit = np.tile(np.eye(3), (nodes, 1, 1, 1)), np.full((nodes, 1, pairs), 10.0)
    return quickest(lambda: table.nearest(position, rotation, others, places, turns, limit))


def rows(name: str, nodes: int, count: int) -> None:
    """A robot that drives 1.5 m past obstacles: all that is done before a solve, and after it."""
    robot, world, rng = wb.load_robot(name), wb.Obstacles(), np.random.default_rng(0)
    for k in range(count):
        place = np.array([2.0 * k / count, (1.0 + 0.4 * rng.uniform()) * (-1) ** k, 0.5])
        world.set(f"{k}", wb.shapes.Box((0.1, 0.1, 0.5)) if k % 2 else wb.shapes.Sphere(0.2), position=place)
    states = np.tile(robot.home, (nodes, 1))
    if "base" in robot.state:
        states[:, robot.state["base"].start] += np.linspace(0.0, 1.5, nodes)
    around, times = ObstacleRows(wb.residuals.Clearance(robot)), np.linspace(0.0, 4.0, nodes)
    snapshot = world.snapshot(0.0)
    print(f"{name}: {len(around.geometry.shapes)} shapes, {count} obstacles, {nodes} nodes")
    print(f"  rows of obstacles: {quickest(lambda: around.refresh(snapshot, times, states)):.2f} ms")
    print(f"  clearance of the plan: {quickest(lambda: around.clearance(snapshot, times, states)):.2f} ms")
    print(f"  search for contacts: {quickest(lambda: around.deepest(snapshot, times, states, 0.02, 0.003)):.2f} ms")
    own = SelfRows(wb.residuals.SelfClearance(robot))
    others, turn = (states, states + 1e-9), itertools.count()  # what was measured last is kept
    print(f"  rows of {own.size} pairs of its own: {quickest(lambda: own.refresh(others[next(turn) % 2])):.2f} ms")


def points(name: str, nodes: int, rays: int = 5760) -> None:
    """A scan of a room of 5 x 5 m about a robot at home, and a plan that stays."""
    robot, world, clock = wb.load_robot(name), wb.Obstacles(), itertools.count(1)
    angle = np.linspace(0.0, 2.0 * np.pi, rays, endpoint=False)
    ways = np.stack([np.cos(angle), np.sin(angle), np.zeros(rays)], axis=1)
    ways *= 2.5 / np.abs(ways).max(axis=1)[:, None]
    scan = ways + np.stack([0.0 * angle, 0.0 * angle, np.random.default_rng(0).uniform(0.1, 1.5, rays)], axis=1)
    around = ObstacleRows(wb.residuals.Clearance(robot))
    local, states, times = wb.LocalMap(robot), np.tile(robot.home, (nodes, 1)), np.linspace(0.0, 4.0, nodes)

    def whole() -> None:
        t = 0.1 * next(clock)
        local.add(scan, np.array([0.0, 0.0, 0.5]), t, robot.home)
        local.publish(world, t)
        around.refresh(with_sides(world.snapshot(t)), t + times, states)

    print(f"  {rays} points to rows, map of {local.shape} cells: {quickest(whole):.2f} ms")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robot", default="swerve-ur10")
    parser.add_argument("--nodes", type=int, default=50)
    parser.add_argument("--pairs", type=int, default=50)
    parser.add_argument("--obstacles", type=int, default=10)
    given = parser.parse_args()
    took = engine(given.nodes, given.pairs)
    print(f"nearest points of {given.nodes} nodes x {given.pairs} pairs, none skipped: {took:.2f} ms")
    rows(given.robot, given.nodes, given.obstacles)
    points(given.robot, given.nodes)


if __name__ == "__main__":
    main()

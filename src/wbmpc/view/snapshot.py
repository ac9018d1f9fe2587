"""What a view draws at one moment: arrays of fixed shape, so that they fit into a mailbox."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from wbmpc import lie
from wbmpc.arrays import Array
from wbmpc.simulation.scene import Contact, Scene
from wbmpc.view.actuator_load import SHARES
from wbmpc.view.named_configuration import configuration_text


def hull(points: Array) -> Array:
    """Corners (k, 2) of the convex hull of points (n, 2), counter-clockwise (Andrew's monotone chain)."""
    ordered = np.unique(points, axis=0)
    if len(ordered) < 3:
        return ordered
    halves = []
    for side in (ordered, ordered[::-1]):
        chain: list[Array] = []
        for p in side:
            while len(chain) > 1 and _turn(chain[-2], chain[-1], p) <= 0.0:
                chain.pop()
            chain.append(p)
        halves += chain[:-1]
    return np.array(halves)


def _turn(a: Array, b: Array, c: Array) -> float:
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


def pressure_point(points: Array, forces: Array) -> Array:
    """Where vertical forces (n) [N] at points (n, 3) act together (3); nan without any."""
    total = float(forces.sum())
    return (forces @ points) / total if total > 0.0 else np.full(3, np.nan)


def active_triangle(points: Array, forces: Array) -> Array:
    """Corners (3, 2), counter-clockwise, of the three points (n, 2) that carry most of the vertical forces (n) [N].

    A rigid base on more than three feet rests on one of their triangles (Pankert et al. 2022, section III): the feet that
    it rests on press harder than the others. Nothing (0, 2) for fewer than three points, or three on a line.
    """
    corners = hull(points[np.argsort(forces)[-3:]])
    return corners if len(corners) == 3 else np.zeros((0, 2))


def margin(corners: Array, point: Array) -> float:
    """Distance [m] from a point (2) to the nearest edge of a polygon (k, 2); negative outside; 0 without an area."""
    if len(corners) < 3 or not np.isfinite(point).all():
        return 0.0
    edges = np.roll(corners, -1, axis=0) - corners
    inward = np.stack([-edges[:, 1], edges[:, 0]], axis=1) / np.linalg.norm(edges, axis=1)[:, None]
    return float(np.min(np.sum(inward * (point - corners), axis=1)))


#: Points of the reference path and of plans, and contacts, at most.
REFERENCE, PLAN, CONTACTS = 200, 31, 8
#: Points of the way that the end effector has taken.
TRAIL = 202
#: A contact higher than this [m] is none with the floor or what lies on it.
ABOVE = 0.3
#: Numbers that are plotted. Lengths in m, times in s; ``error``, ``turn`` [rad]: of the end effector, ``base``: of a base with a goal;
#: those of :data:`~wbmpc.view.actuator_load.SHARES`: shares of limits; ``margin``, ``triangle_margin``: of the point of pressure inside the
#: support polygon and the active triangle.
#: ``late``: by how much a tick of a real-time run began late; ``factor``: the run's time over the clock's; ``late_ticks``: how many
#: of the ``ticks`` were late; ``configuration``: see :mod:`wbmpc.view.named_configuration`; ``clearance``: least of the plan.
NUMBERS = (
    "t", "error", "turn", "base", "solve", "deadline", *SHARES, "margin", "triangle_margin", "late", "factor", "ticks",
    "late_ticks", "configuration", "clearance",
)  # fmt: skip
#: Shapes of what :func:`ground` finds.
GROUND: dict[str, tuple[int, ...]] = {
    "forces": (CONTACTS, 2, 3), "support": (CONTACTS, 3), "triangle": (3, 3), "pressure": (3,), "margin": (),
    "triangle_margin": (),
}  # fmt: skip


def fields(scene: Scene) -> dict[str, tuple[int, ...]]:
    """Shapes of a snapshot. What there is less of is filled with nan; positions are in ``map`` [m].

    ``brakes``: 1 if all are open; ``obstacle``: the user's cube, see :class:`~wbmpc.view.user_commands.UserCommands`.
    """
    return {
        "numbers": (len(NUMBERS),),
        "poses": (len(scene.bodies), 7),
        "reference": (REFERENCE, 3),
        "trail": (TRAIL, 3),
        "end_effector_plan": (PLAN, 3),
        "base_plan": (PLAN, 3),
        **{name: GROUND[name] for name in ("forces", "support", "triangle", "pressure")},
        "goal": (7,),
        "base_goal": (3,),
        "brakes": (),
        "obstacle": (8,),
    }


def filled(rows: Any, shape: tuple[int, ...]) -> Array:
    """``rows`` in an array of ``shape``: thinned out if there are more, nan after the last if there are fewer."""
    out = np.full(shape, np.nan)
    rows = np.asarray(rows, float)
    if len(rows) > shape[0]:
        rows = rows[np.linspace(0, len(rows) - 1, shape[0]).round().astype(int)]
    if len(rows):
        out[: len(rows)] = rows
    return out


def ground(contacts: list[Contact], size: float = 0.002, size_above: float = 0.02) -> dict[str, Array]:
    """Of contacts: forces as arrows (``size`` [m/N]; ``size_above`` for those above the floor: an end effector pushes less than feet),
    support polygon, active triangle, point of pressure (the ZMP on a flat floor), and how far it is inside of both [m]."""
    arrows = [(c.point, c.point + (size if c.point[2] < ABOVE else size_above) * c.force) for c in contacts]
    carrying = [c for c in contacts if c.force[2] > 1.0 and c.point[2] < ABOVE]
    points = np.array([c.point for c in carrying]).reshape(-1, 3)
    corners = hull(points[:, :2]) if len(points) else np.zeros((0, 2))
    level = float(points[:, 2].mean()) if len(points) else 0.0
    loads = np.array([c.force[2] for c in carrying])
    found, triangle = pressure_point(points, loads), active_triangle(points[:, :2], loads)
    on_floor = lambda p: np.column_stack([p, np.full(len(p), level)])
    return {
        "forces": filled(arrows, (CONTACTS, 2, 3)), "support": filled(on_floor(corners), (CONTACTS, 3)),
        "triangle": filled(on_floor(triangle), (3, 3)), "pressure": found,
        "margin": np.array(margin(corners, found[:2])), "triangle_margin": np.array(margin(triangle, found[:2])),
    }  # fmt: skip


def errors(end_effector: Array, goal: Array, base: Array, base_goal: Array) -> dict[str, float]:
    """Errors of poses (7) in one frame against the end effector's ``goal`` (7) and ``base_goal`` (x, y, yaw); nan without a goal."""
    return {
        "error": float(np.linalg.norm(end_effector[:3] - goal[:3])),
        "turn": float(
            np.linalg.norm(
                lie.quaternion_log(lie.quaternion_multiply(lie.quaternion_conjugate(goal[3:]), end_effector[3:]))
            )
        ),
        "base": float(np.linalg.norm(base[:2] - base_goal[:2])),
    }


def status_text(numbers: Mapping[str, float], configurations: Sequence[str] = ()) -> str:
    """The end effector's error, how clear the plan is, how far the ZMP is inside of what it must stay in, how late the run is, how its legs
    stand (by the names of its ``configurations``): lines of Markdown after a first one."""
    lines = [f"end effector error {1e3 * numbers['error']:.1f} mm"] if np.isfinite(numbers["error"]) else []
    clear = numbers.get("clearance", np.nan)
    lines += [f"least clearance of the plan {1e3 * clear:.0f} mm"] if np.isfinite(clear) else []
    margins = [
        f"{1e3 * abs(numbers[name]):.0f} mm {'inside' if numbers[name] > 0.0 else 'outside'} the {what}"
        for name, what in (("margin", "polygon"), ("triangle_margin", "triangle"))
        if np.isfinite(numbers[name]) and numbers[name] != 0.0
    ]
    lines += [f"ZMP {', '.join(margins)}"] if margins else []
    pace = [f"real-time factor {numbers['factor']:.2f}"] if np.isfinite(numbers.get("factor", np.nan)) else []
    if np.isfinite(numbers.get("ticks", np.nan)):
        pace.append(f"{numbers['late_ticks']:.0f} of {numbers['ticks']:.0f} ticks late")
    lines += [", ".join(pace)] if pace else []
    named = configuration_text(numbers.get("configuration", np.nan), configurations)
    lines += [named] if named else []
    return "".join(f"  \n{line}" for line in lines)


def plain(text: str) -> str:
    """Text that Markdown shows as it is: what was sent by a page does not become a link or an image of another's. In addresses, which
    the page turns into links whatever is escaped, stands a character that is not seen (U+2060)."""
    text = re.sub(r"([\\`*_{}\[\]()<>#!|~$&])", r"\\\1", " ".join(text.split()))
    return re.sub(r"(?i)(:)(?=//)|(www)(?=\.)|(?=@)", lambda found: f"{found[0]}\u2060", text)

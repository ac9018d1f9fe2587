"""The storyboard. Truth: corners, feet and rings of a base that stands turned by a quarter, worked out by hand."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest

from toys import robot
from wbmpc.studies.storyboard import Ground, Snapshot, storyboard

GEOMETRY = robot("swerve-ur10").base.geometry
SVG = "{http://www.w3.org/2000/svg}"


def picture(rows: int) -> ElementTree.Element:
    still, is_open = np.zeros(4), np.array([True, False, False, True])
    shots = [
        Snapshot(t, np.array([x, 0.0, turn]), still, still, is_open) for t, x, turn in ((0, 0, 0), (9, 3, np.pi / 2))
    ]
    ground = Ground(boxes=[(1.0, 0.5, 0.03, 0.05)], bumps=[(2.5, 0.2, 0.3)], cables=[2.0])
    way = np.array([[0.0, 0.0], [3.0, 0.0]])
    return ElementTree.fromstring(storyboard(GEOMETRY, (0.5, 0.4), way, shots, ground, rows))


def corners(polygon: ElementTree.Element) -> list[tuple[float, ...]]:
    return sorted(tuple(map(float, p.split(","))) for p in polygon.attrib["points"].split())


def test_every_snapshot_is_drawn_once_where_it_was() -> None:
    first, second = (corners(p) for p in picture(1).iter(f"{SVG}polygon"))
    assert first == [(-0.5, -0.4), (-0.5, 0.4), (0.5, -0.4), (0.5, 0.4)]
    assert second == [(2.6, -0.5), (2.6, 0.5), (3.4, -0.5), (3.4, 0.5)]  # turned: long side across
    for rows in (2, 3):
        assert len(list(picture(rows).iter(f"{SVG}polygon"))) == 2


def test_hinges_turn_with_the_base_and_show_their_brakes() -> None:
    small = [c for c in picture(1).iter(f"{SVG}circle") if float(c.attrib["r"]) < 0.1]
    at = [(float(c.attrib["cx"]), float(c.attrib["cy"])) for c in small]
    hinge = GEOMETRY.hinge
    assert at[:4] == [pytest.approx(tuple(h), abs=1e-3) for h in hinge]
    assert at[4:] == [pytest.approx((3.0 - h[1], h[0]), abs=1e-3) for h in hinge]
    assert [c.attrib["fill"] == "white" for c in small] == [True, False, False, True] * 2


def test_what_lies_on_the_ground_is_in_the_strips_that_show_it() -> None:
    bumps = [c for c in picture(3).iter(f"{SVG}circle") if float(c.attrib["r"]) == 0.3]
    assert len(bumps) == 2  # at 2.5 m: in the strips from 1 to 2 m and from 2 to 3 m, with their borders
    assert {c.attrib["cx"] for c in bumps} == {"2.5"}

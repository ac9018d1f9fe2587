"""Offsets of masses from tippings. Truth: a rigid table with an arm whose offset is known, and the switches that `support_switches`
predicts for it, which is tested against a simulated table and linear programming; statistics of draws for the covariance."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wbmpc.errors import InputError
from wbmpc.studies.pankert2022.mass_offset import MassOffset, Tipping, estimate_mass_offset
from wbmpc.studies.pankert2022.support_switches import Switch, support_switches, upright

FEET = np.array([[0.5, 0.3], [0.5, -0.3], [-0.5, 0.3], [-0.5, -0.3]])
MIDDLE, REACH, TALL, STEP = np.array([-0.01, 0.01]), 0.2, 0.5, 0.05
HEADING = np.linspace(-np.pi, np.pi, 601)


def turned(heading: np.ndarray, arm: np.ndarray) -> np.ndarray:
    """The vector ``arm`` (2), turned by headings (k,)."""
    c, s = np.cos(heading), np.sin(heading)
    return np.stack([c * arm[0] - s * arm[1], s * arm[0] + c * arm[1]], axis=1)


def model(up: np.ndarray, heading: np.ndarray) -> np.ndarray:
    """Zero-moment points (k, 2) of the nominal table: its center of mass is TALL over the ground, its arm moves it by REACH."""
    return MIDDLE + turned(heading, np.array([REACH, 0.0])) - TALL * up[:2] / up[2]


def switches(foot: int, base: np.ndarray, arm: np.ndarray) -> tuple[np.ndarray, list[Switch]]:
    """With a step under one foot: heights (n), and when a table with this offset switches; the arm's heading is the time."""
    heights = np.where(np.arange(4) == foot, STEP, 0.0)
    shift = base + turned(HEADING, arm)
    stance = lambda up, _: (FEET, model(up, HEADING) + shift, np.ones(HEADING.size))
    return heights, support_switches(HEADING, FEET, heights, stance)


def tippings(foot: int, base: np.ndarray, arm: np.ndarray) -> list[Tipping]:
    """What is seen of one turn: over which edge it tipped and where the nominal model was on the face before."""
    heights, found = switches(foot, base, arm)
    out = []
    for s in found:
        edge = FEET[sorted(set(s.previous) & set(s.after))]
        point = model(upright(FEET, heights, s.previous), np.array([s.time]))[0]
        out.append(Tipping(edge, point, s.time))
    return out


offsets = st.tuples(*[st.floats(-0.01, 0.01)] * 4)


@given(offsets)
@settings(max_examples=20, deadline=None, derandomize=True)
def test_four_feet_in_turn_show_everything(values: tuple[float, ...]) -> None:
    base, arm = np.array(values[:2]), np.array(values[2:])
    seen = [t for foot in range(4) for t in tippings(foot, base, arm)]
    found = estimate_mass_offset(seen, base=1.0, arm=1.0, seen=1e-5)
    assert found.rank == 4
    np.testing.assert_allclose(found.base, base, atol=2e-5)
    np.testing.assert_allclose(found.arm, arm, atol=1e-4)


@given(offsets)
@settings(max_examples=20, deadline=None, derandomize=True)
def test_one_foot_shows_two_directions_and_predicts_its_own_edge(values: tuple[float, ...]) -> None:
    """c along the edge stays as it was known, and the estimate repeats the switches that it was made from."""
    base, arm = np.array(values[:2]), np.array(values[2:])
    seen = tippings(0, base, arm)
    found = estimate_mass_offset(seen, base=0.01, arm=0.01, seen=1e-6)
    assert (len(seen), found.rank) == (2, 2)
    along = (FEET[3] - FEET[0]) / np.linalg.norm(FEET[3] - FEET[0])
    assert along @ found.covariance[:2, :2] @ along == pytest.approx(0.01**2, rel=1e-6)
    assert found.base @ along == pytest.approx(0.0, abs=1e-9)
    again = switches(0, found.base, found.arm)[1]
    assert [s.time for s in again] == pytest.approx([s.time for s in switches(0, base, arm)[1]], abs=1e-4)
    rows = [t.row()[0] for t in seen]
    assert all(np.sqrt(row @ found.covariance @ row) < 2e-6 for row in rows)


def test_the_covariance_is_that_of_the_errors() -> None:
    """Over draws of offsets and readings the squared errors in standard deviations have the mean of χ² with 4 degrees."""
    rng, zero = np.random.default_rng(0), np.zeros(2)
    rows = [t for foot in (0, 1) for t in tippings(foot, zero, zero)]
    sizes = []
    for _ in range(400):
        truth = rng.normal(size=4) * [0.004, 0.004, 0.002, 0.002]
        seen = []
        for t in rows:
            row, _ = t.row()
            off = -row @ truth + t.row()[1] + 0.001 * rng.normal()
            seen.append(Tipping(t.edge, t.point + off * row[:2], t.heading))
        found = estimate_mass_offset(seen, base=0.004, arm=0.002, seen=0.001)
        error = np.concatenate([found.base, found.arm]) - truth
        sizes.append(error @ np.linalg.solve(found.covariance, error))
    assert np.mean(sizes) == pytest.approx(4.0, abs=0.5)


def test_without_tippings_nothing_is_learned() -> None:
    vague = estimate_mass_offset(tippings(0, np.zeros(2), np.zeros(2)), base=0.003, arm=0.001, seen=0.1)
    assert vague.rank == 0
    found = estimate_mass_offset([], base=0.003, arm=0.001)
    assert found.rank == 0 and not found.at([0.0, 1.0]).any()
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), [0.003, 0.003, 0.001, 0.001])


def test_the_part_of_the_arm_turns_with_it() -> None:
    offset = MassOffset(np.array([1.0, 2.0]), np.array([3.0, 0.0]), np.eye(4), 0)
    np.testing.assert_allclose(offset.at(np.array([0.0, np.pi / 2])), [[4.0, 2.0], [1.0, 5.0]], atol=1e-12)


@pytest.mark.parametrize("spread", [0.0, -1.0, np.nan, np.inf])
def test_senseless_spreads_are_rejected(spread: float) -> None:
    with pytest.raises(InputError, match=r"spreads: 'seen' must be (positive|finite), got"):
        estimate_mass_offset([], seen=spread)


@pytest.mark.parametrize(
    "wrong", [Tipping(FEET[[0, 0]], np.zeros(2), 0.0), Tipping(FEET[[0, 3]], np.array([np.nan, 0.0]), 0.0)]
)
def test_senseless_tippings_are_rejected(wrong: Tipping) -> None:
    with pytest.raises(InputError, match="an edge between two places"):
        estimate_mass_offset([wrong])

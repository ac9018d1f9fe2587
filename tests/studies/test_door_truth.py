"""The door's figures and what the controller learns of its place. Truth: logs by formula, circles on paper."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from wbmpc.log import Log
from wbmpc.ocp import Mode, ModeSchedule, Reference
from wbmpc.simulation.lockstep import Ending
from wbmpc.solver.results import Trajectory
from wbmpc.studies.minniti2019.door_control import PossibleForce
from wbmpc.studies.minniti2019.door_figures import Trial, trial_metrics
from wbmpc.studies.minniti2019.door_filter import LeverFit
from wbmpc.studies.minniti2019.door_settings import DOORS, RezeroDoorSettings
from wbmpc.studies.minniti2019.door_trial import LEVER, drawn_door


def pushed(lost: float, early: float) -> Trial:
    """10 N wanted from the touch at 1 s to the release at 3 s: ``early`` [N] off for 0.05 s, and no contact for the share ``lost``."""
    log, state = Log(), np.zeros(16)
    for t in np.arange(0.0, 5.0, 0.0025).tolist():
        pushing = 1.0 <= t < 3.0
        away = 2.0 <= t < 2.0 + 1.9 * lost
        force = 0.0 if not pushing or away else 10.0 - early * (t < 1.05)
        log.add("force", t, [0.0, force, 0.0])
        log.add("normal", t, [0.0, 1.0, 0.0])
        log.add("pushing", t, float(pushing))
        log.add("door", t, [0.0, 0.0])
        log.add("penetration", t, 0.002 if pushing else 0.0)
        log.add("force_sensorless", t, [0.0, force, 0.0])
        for name in ("hand", "hand_wanted"):
            log.add(name, t, np.zeros(3))
        log.add("state", t, state)
    return Trial(10.0, log, Ending(), None)  # type: ignore[arg-type]


def test_lost_contact_counts_in_full_and_the_first_tenth_of_a_second_does_not() -> None:
    whole = trial_metrics(pushed(0.0, 5.0))
    assert whole["force_error_ratio"] == pytest.approx(0.0, abs=1e-9) and whole["contact_share"] == 1.0
    lost = trial_metrics(pushed(0.16, 0.0))
    assert lost["force_error_ratio"] == pytest.approx(np.sqrt(0.16), rel=0.01)  # 100 % error for 16 % of the time
    assert lost["contact_share"] == pytest.approx(0.84, abs=0.01) and lost["panel_penetration_max"] == 0.002


@pytest.mark.parametrize("slide", [-0.02, 0.0, 0.02])
@pytest.mark.parametrize("lever", [0.58, 0.7, 0.82])
def test_the_lever_of_a_door_is_found_from_the_way_of_the_end_effector(lever: float, slide: float) -> None:
    """Truth: places on a circle of a tip that has slid along the panel while it bounced for 0.2 s, and rolls on it."""
    fit, along, normal, half, radius = LeverFit(0.7), np.array([0.0, -1.0, 0.0]), np.array([1.0, 0.0, 0.0]), 0.02, 0.012
    offset = half + radius
    rng, hinge, found = np.random.default_rng(3), np.array([1.0, 2.0, 0.6]), []
    fit.first = hinge + lever * along - offset * normal
    for k, angle in enumerate(np.linspace(0.0, 1.0, 800)):
        c, s = np.cos(angle), np.sin(angle)
        a, n = np.array([s, -c, 0.0]), np.array([c, s, 0.0])
        place = hinge + (lever + slide - radius * angle) * a - offset * n + 1e-3 * rng.normal(size=3)
        fit.update(0.0025, 0.0 if k else 0.2, place, along, normal, half)
        found.append(fit.lever)
    assert fit.lever == pytest.approx(lever, abs=0.01) and fit.now == pytest.approx(lever + slide, abs=0.01)
    assert np.all(np.abs(np.array(found) - lever) < 0.15)  # hardly farther off than it was known at first


def test_a_solve_starts_without_force_where_the_end_effector_is_free() -> None:
    """By hand: free until 1.2 s, in contact up to 1.5 s, then free. A plan that fits is left as it is: its multipliers stay too."""
    free, moving = Mode("free"), Mode("moving")
    guess = PossibleForce()
    guess.bind(SimpleNamespace(solver=SimpleNamespace(schedule=ModeSchedule((free, moving, free), (1.2, 1.5)))))  # type: ignore[arg-type]
    plan = Trajectory(1.0, np.linspace(0.0, 0.8, 9), np.zeros((9, 4)), np.ones((8, 5)))
    found = guess(1.0, np.zeros(4), plan)
    assert found is not None and np.all(found.u[:, :2] == 1.0)
    np.testing.assert_array_equal(found.u[:, 2:].any(axis=1), [False, True, True, True, False, False, False, False])
    assert guess(1.0, np.zeros(4), found) is None


def test_a_solve_starts_within_the_friction_cone_of_the_panel_as_it_is_believed_to_stand() -> None:
    """By hand: a panel along y that is pushed along x, and from 1.4 s on one that has turned by a right angle; μ = 0.5."""
    guess, moving = PossibleForce(0.5), Mode("moving")
    normals = np.array([[1.0, 0.0, 0.0, 0.5], [0.0, 1.0, 0.0, 0.5]])
    cone = Reference(np.array([1.0, 1.4]), normals, "hold")
    guess.bind(SimpleNamespace(solver=SimpleNamespace(schedule=ModeSchedule((moving,), ())), reference={"cone": cone}))  # type: ignore[arg-type]
    plan = Trajectory(1.0, np.linspace(0.0, 0.8, 9), np.zeros((9, 4)), np.tile([7.0, 7.0, -10.0, 2.0, -1.0], (8, 1)))
    found = guess(1.0, np.zeros(4), plan)
    assert found is not None and np.all(found.u[:, :2] == 7.0)
    for k, force in enumerate(found.u[:, 2:]):
        push, across = (-force[0], force[1]) if k < 4 else (-force[1], force[0])
        assert push == pytest.approx(10.0 if k < 4 else 0.6)  # as much as there was, or the least and some more
        assert max(abs(across), abs(force[2])) < 0.5 / np.sqrt(2.0) * push
    np.testing.assert_allclose(found.u[:4, 3:], [[2.0, -1.0]] * 4)
    assert guess(1.0, np.zeros(4), found) is None  # one that fits is left as it is


def test_doors_are_drawn_about_their_kind_and_reach_beyond_the_end_effector() -> None:
    settings = RezeroDoorSettings(door="heavy")
    doors = [drawn_door(settings, (1.0, LEVER), seed) for seed in range(60)]
    for name, kind in {**DOORS["heavy"], "closer": 2.0, "friction": 1.5}.items():
        ratio = np.array([getattr(door, name) for door in doors]) / kind
        assert 0.8 <= ratio.min() < 0.85 and 1.15 < ratio.max() <= 1.2
    lever = np.array([door.hinge[1] for door in doors])
    assert np.ptp(lever) > 0.2 and all(door.width >= at + 0.06 for door, at in zip(doors, lever, strict=True))
    same = drawn_door(RezeroDoorSettings(door_spread=0.0, door_position_error=0.0), (1.0, LEVER), 5)
    assert (same.width, same.mass, same.hinge) == (0.8, 12.0, (1.0, LEVER))

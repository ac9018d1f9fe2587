"""Open legs that hold nothing. Truth: the wheels' velocities (rigid-body motion): what no wheel sees is not held."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from toys import robot
from wbmpc.bases.swerve.brake_control import FLOATING, BrakeControl, floating, reject_floating_way
from wbmpc.errors import InputError
from wbmpc.model.wheels import ModuleGeometry, wheel_velocities
from wbmpc.stability import configuration_positions
from wbmpc.studies.pankert2022.mission import Mission, Reconfiguration

SWERVE = robot("swerve-ur10")
G, OPEN = SWERVE.base.geometry, np.ones(4)


def least_seen(leg: np.ndarray, motion: np.ndarray, geometry: ModuleGeometry = G) -> float:
    """Largest wheel speed [m/s] that is left of a motion when every leg moves as it can to cancel it."""
    none = wheel_velocities(geometry, leg, motion, np.zeros(4))
    one = wheel_velocities(geometry, leg, np.zeros(3), np.ones(4))
    swing = -np.sum(none * one, axis=1) / np.sum(one * one, axis=1)
    return float(np.hypot(*wheel_velocities(geometry, leg, motion, swing).T).max())


def test_h_floats_sideways_and_x_and_a_do_not() -> None:
    held, motion = floating(G, configuration_positions(SWERVE, "H"), OPEN)
    assert held < 1e-12 and abs(motion[1]) > 0.99 * np.linalg.norm(motion)
    assert least_seen(configuration_positions(SWERVE, "H"), motion) < 1e-12
    for name in "XA":
        legs = configuration_positions(SWERVE, name)
        held, motion = floating(G, legs, OPEN)
        assert held > FLOATING and least_seen(legs, motion) > 0.01


def test_legs_that_meet_in_a_point_float_about_it() -> None:
    """All legs radial: what they cancel is a turn about the middle."""
    legs = np.arctan2(G.hinge[:, 1], G.hinge[:, 0]) - G.leg_heading
    held, motion = floating(G, legs, OPEN)
    assert held < 1e-12 and abs(motion[2]) > 0.99 * np.linalg.norm(motion)
    assert least_seen(legs, motion) < 1e-12


def test_legs_that_slide_hold_the_base_across_themselves() -> None:
    """Legs along the diagonals hold it against everything; all parallel they would not along themselves."""
    g = robot("telescope-ur10").base.geometry
    legs = np.full(4, 0.1)
    held, motion = floating(g, legs, OPEN)
    assert held > FLOATING and least_seen(legs, motion, g) > 0.01
    parallel = replace(g, leg_heading=np.zeros(4))
    held, motion = floating(parallel, legs, OPEN)
    assert held < 1e-12 and abs(motion[0]) > 0.99 * np.linalg.norm(motion)
    assert least_seen(legs, motion, parallel) < 1e-12


def test_one_closed_brake_holds() -> None:
    held, _ = floating(G, np.zeros(4), [1, 1, 0, 1])
    assert held > FLOATING


def test_opening_in_h_is_rejected_unless_the_legs_move() -> None:
    brakes = BrakeControl(SWERVE)
    with pytest.raises(InputError, match=r"nothing would hold the base against sideways .* valid: a closed brake"):
        brakes.set(1.0, OPEN, leg=np.zeros(4))
    assert not brakes.commanded(2.0).any()
    brakes.set(1.0, OPEN, leg=configuration_positions(SWERVE, "A"))
    assert brakes.commanded(2.0).all()


def test_legs_may_pass_h_quickly_but_not_turn_all_parallel() -> None:
    """Legs that turn by the same angle from H are parallel all the way; to the mirror of X they pass H quickly."""
    x, fast = configuration_positions(SWERVE, "X"), np.full(4, 0.4)
    reject_floating_way(G, x, -x, OPEN, fast)
    reject_floating_way(G, np.zeros(4), x, OPEN, fast)
    reject_floating_way(G, np.zeros(4), np.zeros(4), OPEN, fast)  # there already: its brakes close
    with pytest.raises(InputError, match=r"on the way to .* nothing would hold the base against .* for more than 1 s"):
        reject_floating_way(G, np.zeros(4), np.full(4, 0.6), OPEN, fast)
    reject_floating_way(G, np.zeros(4), np.full(4, 0.6), [1, 1, 1, 0], fast)
    with pytest.raises(InputError, match=r"against (turning|sideways) for"):
        reject_floating_way(G, x, -x, OPEN, 0.03 * fast)


def test_a_mission_may_pass_h_but_not_stay_there() -> None:
    h, x = configuration_positions(SWERVE, "H"), configuration_positions(SWERVE, "X")
    quick = Mission((), h, (Reconfiguration(5.3, x), Reconfiguration(12.0, h)), ((5.0, 1.0), (16.5, 0.0)))
    quick.apply(BrakeControl(SWERVE))
    late = Mission((), h, (Reconfiguration(7.0, x),), ((5.0, 1.0), (12.0, 0.0)))
    with pytest.raises(InputError, match=r"mission: from 5.00 s on the brakes are open .* sideways"):
        late.apply(BrakeControl(SWERVE))
    stays = Mission((), x, (Reconfiguration(2.0, h),), ((1.0, 1.0),))
    with pytest.raises(InputError, match="legs that move on"):
        stays.apply(BrakeControl(SWERVE))
    Mission((), h, (), ()).apply(BrakeControl(SWERVE))  # closed brakes may stay


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (([np.nan] * 4, np.ones(4), OPEN, np.ones(4)), "'leg' needs 4 finite"),
        ((np.zeros(2), np.ones(4), OPEN, np.ones(4)), "'leg' needs 4 finite"),
        ((np.zeros(4), np.ones(3), OPEN, np.ones(4)), "'goal' needs 4 finite"),
        ((np.zeros(4), np.ones(4), np.ones(5), np.ones(4)), "'brake' needs 4 finite"),
        ((np.zeros(4), np.ones(4), OPEN, np.zeros(4)), "'rate' needs positive"),
        ((np.zeros(4), np.ones(4), OPEN, [1.0, 1.0, 1.0, np.nan]), "'rate' needs 4 finite"),
    ],
)
def test_a_way_that_is_none_is_rejected(given: tuple, words: str) -> None:
    with pytest.raises(InputError, match=words):
        reject_floating_way(G, *given)
    if "leg" in words:
        with pytest.raises(InputError, match=words):
            BrakeControl(SWERVE).set(1.0, OPEN, leg=given[0])


def test_legs_without_a_limit_of_speed_are_there_at_once() -> None:
    reject_floating_way(G, np.zeros(4), configuration_positions(SWERVE, "X"), OPEN, np.full(4, np.inf))
    with pytest.raises(InputError, match="on the way"):  # and stay: all parallel
        reject_floating_way(
            G,
            configuration_positions(SWERVE, "X"),
            configuration_positions(SWERVE, "H"),
            OPEN,
            [np.inf, np.inf, np.inf, 0.01],
        )


@pytest.mark.parametrize("delay", [-1.0, np.nan, np.inf])
def test_brakes_take_a_time_that_is_one(delay: float) -> None:
    with pytest.raises(InputError, match="delay must be finite and not negative"):
        BrakeControl(SWERVE, delay=delay)

"""The limit of pushes. Truth: robots of known strength, by formula; end effectors and balls that rest, come back or roll away, by
formula."""

from __future__ import annotations

import numpy as np
import pytest

from wbmpc.errors import InputError
from wbmpc.log import Log
from wbmpc.registry import REGISTRY
from wbmpc.studies.minniti2019 import push_limit
from wbmpc.studies.minniti2019.push_limit import MAXIMUM, HandLimitSettings, largest
from wbmpc.studies.minniti2019.push_once import Outcome, push_once
from wbmpc.studies.minniti2019.push_settings import RezeroPushHandSettings
from wbmpc.studies.minniti2019.recovery import LAST, NEAR, rest


@pytest.mark.parametrize("strength", [3.0, 22.0, 161.3])
def test_bisection_brackets_the_strength(strength: float) -> None:
    tried: list[float] = []

    def passes(impulse: float) -> bool:
        tried.append(impulse)
        return impulse < strength

    found = largest(passes, 5.0)
    assert found < strength <= found + 5.0 and len(tried) < 9
    assert largest(lambda _: True, 5.0) == MAXIMUM


@pytest.mark.parametrize(("criterion", "strength"), [("recovers", 77.0), ("stands", 161.3)])
def test_the_experiment_pushes_where_it_is_asked(
    criterion: str, strength: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Impulse, direction and length of every push; what counts is the criterion."""
    asked: set[tuple[float, float]] = set()

    def push(settings: HandLimitSettings, seed: int, force: float, direction: float, length: float) -> Outcome:
        asked.add((direction, length))
        impulse = force * length
        return Outcome(impulse < 161.3, impulse < 77.0, 0.01 * impulse)

    monkeypatch.setattr(push_limit, "push_once", push)
    settings = HandLimitSettings(direction=90.0, push_duration=0.4, criterion=criterion)  # type: ignore[arg-type]
    found = REGISTRY["rezero-push-limit-hand"].run(settings, 0).metrics
    assert found["impulse_max"].value < strength <= found["impulse_max"].value + 5.0
    assert asked == {(np.deg2rad(90.0), 0.4)} and found["ball_travel_max"].value < 0.77


def test_what_a_limit_does_not_read_is_an_error() -> None:
    with pytest.raises(ValueError, match="forces"):
        HandLimitSettings(forces=(10.0,))


@pytest.mark.parametrize("length", [1e-4, 0.0333])
def test_a_push_is_never_longer_than_asked(length: float) -> None:
    """The plant is pushed for whole controller periods: 10 kN for 0.1 ms, 1 N s, was 25 N s."""
    with pytest.raises(InputError, match="length"):
        push_once(RezeroPushHandSettings(pause=2.0), 0, 1e4, 0.0, length)


# ---------------------------------------------------------------------- recovered or not
def logged(end_effector: np.ndarray, believed: np.ndarray | None = None) -> Log:
    """Hands (n, 3) [m], 100 a second, and where the robot believes them to be."""
    log = Log()
    for k, (place, felt) in enumerate(zip(end_effector, end_effector if believed is None else believed, strict=True)):
        log.add("state", 0.01 * k, np.zeros(16))
        log.add("hand", 0.01 * k, place)
        log.add("hand_estimated", 0.01 * k, felt)
    return log


def test_recovered_is_back_where_the_robot_knows_its_place_and_at_rest_in_the_world() -> None:
    still, t = np.zeros((701, 3)), 0.01 * np.arange(701)
    away = np.array([0.3, 0.0, 0.0])
    assert rest(logged(still), "hand", np.zeros(3), 7.0).recovered
    assert not rest(logged(still + away), "hand", np.zeros(3), 7.0).recovered
    slipped = rest(logged(still + away, still), "hand", np.zeros(3), 7.0)  # 30 cm of slip, which it cannot know
    assert slipped.recovered and slipped.world == pytest.approx(0.3) and slipped.felt == pytest.approx(0.0)
    rolls = np.outer(np.maximum(t - 6.0, 0.0), [1.5 * NEAR / LAST, 0.0, 0.0])  # and believes to stand
    assert rest(logged(rolls, still), "hand", np.zeros(3), 7.0).moves > NEAR
    assert not rest(logged(rolls, still), "hand", np.zeros(3), 7.0).recovered
    swings = 0.1 * np.outer(np.sin(2.0 * np.pi * t), [0.0, 0.0, 1.0])
    assert not rest(logged(swings), "hand", np.zeros(3), 7.0).recovered
    assert not rest(logged(still[:400]), "hand", np.zeros(3), 7.0).recovered  # it fell
    assert rest(logged(swings), "ball", np.zeros(2), 7.0).recovered

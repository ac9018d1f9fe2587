"""A force sensor that is not believed. Truth: faults put into the messages of a sound sensor, at known times."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from wbmpc.control.door import DoorAgent
from wbmpc.errors import InputError, NotFinite
from wbmpc.estimation import ContactMonitor, ForceMonitor
from wbmpc.estimation.force import UNFELT, UNFELT_TIME
from wbmpc.plant import RezeroMeasurement

H, PUSH = 0.0025, np.array([0.0, 0.0, 8.0])


def judged(messages: list[np.ndarray]) -> tuple[float, ForceMonitor]:
    """When [s] the fault was told (infinite: never), and the monitor."""
    monitor = ForceMonitor()
    for k, message in enumerate(messages):
        reading = monitor.judge(H, message)
        if monitor.fault:
            assert not reading.any()
            return k * H, monitor
    return np.inf, monitor


def noisy(n: int) -> list[np.ndarray]:
    return list(PUSH + 0.1 * np.random.default_rng(0).normal(size=(n, 3)))


@pytest.mark.parametrize(
    ("last", "says"),
    [(noisy(40)[-1], "same numbers"), (np.zeros(3), "same numbers"), (np.full(3, np.nan), "no finite numbers")],
)
def test_a_sensor_that_stands_is_found_after_25_ms(last: np.ndarray, says: str) -> None:
    """40 sound messages, then one and the same; zeros and what is no number too."""
    told, monitor = judged(noisy(40) + [last] * 40)
    assert told == pytest.approx(40 * H + 0.025, abs=1.01 * H) and says in monitor.fault


def test_sound_sensors_are_believed() -> None:
    """With noise; one whose messages come four times each; one without noise and a force that hardly changes; one with gaps."""
    slow = [m for m in noisy(40) for _ in range(4)]
    quiet = [PUSH + [0.0, 0.0, 1e-12 * k] for k in range(200)]
    gaps = [np.full(3, np.nan) if k % 12 > 2 else m for k, m in enumerate(noisy(200))]
    for messages in (noisy(400), slow, quiet, gaps):
        assert judged(messages)[0] == np.inf
    monitor = ForceMonitor()
    monitor.judge(H, PUSH)
    np.testing.assert_array_equal(monitor.judge(H, np.full(3, np.nan)), PUSH)  # the one before counts


@pytest.mark.parametrize(
    ("touching", "felt", "found", "fault"),
    [
        (True, 8.0, 8.0 + UNFELT - 0.1, ""),
        (True, 8.0, 8.0 - UNFELT - 0.1, "feels 8.0 N, the robot's motion says 4.9 N"),
        (True, 8.0, 8.0 + UNFELT + 0.1, "feels 8.0 N, the robot's motion says 11.1 N"),
        (False, 0.0, UNFELT + 0.1, "pushed by 3.1 N that the force sensor does not feel"),
        (False, 0.0, -2.0 * UNFELT, ""),
    ],
)
def test_a_sensor_that_the_motion_contradicts_is_found(touching: bool, felt: float, found: float, fault: str) -> None:
    monitor, told = ForceMonitor(), np.inf
    for k in range(200):
        for _ in range(k == 50):  # once it agrees: the time begins anew
            monitor.compare(H, touching, felt, felt)
        if monitor.compare(H, touching, felt, found):
            told = min(told, k * H)
    assert told == (pytest.approx(50 * H + UNFELT_TIME, abs=2 * H) if fault else np.inf)
    assert fault in monitor.fault and bool(fault) == bool(monitor.fault)


def test_bad_messages_are_refused() -> None:
    monitor = ForceMonitor()
    with pytest.raises(InputError, match="'force' needs 3"):
        monitor.judge(H, np.zeros(2))
    with pytest.raises(InputError, match="interval"):
        monitor.judge(0.0, np.zeros(3))
    with pytest.raises(NotFinite, match="force sensor: 'found'"):
        monitor.compare(H, True, 8.0, np.nan)


@pytest.mark.parametrize("phase", ["approach", "push", "release"])
def test_an_agent_whose_sensor_stands_lets_go_and_feels_nothing_any_more(phase: str) -> None:
    """A hand at rest with a level forearm; its sensor stands at 8 N. Told once; neither force nor contact then, in any phase."""
    agent = DoorAgent.__new__(DoorAgent)
    agent.phase, agent.period, agent.door, agent.measured = phase, H, np.zeros(2), None
    agent.force, agent.monitor, agent.leaning, agent._found = np.zeros(3), None, None, []
    agent.contact, agent.sensor = ContactMonitor(), ForceMonitor()
    agent.push = SimpleNamespace(begin=0.0, give_up=9.0, open=1.0, tip_weight=0.0)  # type: ignore[assignment]
    agent.robot = SimpleNamespace(home=None, pose=lambda x: (None, np.array([1.0, 0.0, 0.0, 0.0])))  # type: ignore[assignment]
    agent.geometry = SimpleNamespace(directions=lambda angle: (np.zeros(3), np.array([0.0, 0.0, -1.0])))  # type: ignore[assignment]
    touched = False
    for k in range(60):
        agent._feel(RezeroMeasurement(k * H, np.zeros(0), 0.0, force=PUSH))
        touched |= agent.contact.touching and agent.force[2] == 8.0
    assert touched and not agent.contact.touching and not agent.force.any()
    assert agent._ends(60 * H)
    assert len(agent.faults) == 1 and "the force sensor gives the same numbers" in agent.faults[0]

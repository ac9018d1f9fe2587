"""Settings of the ball robot's experiments. Truth: what each experiment's code reads; asking in vain is an error, not silence."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from wbmpc.configuration import configure
from wbmpc.errors import InputError
from wbmpc.experiments import REGISTRY
from wbmpc.experiments.rezero_push import RezeroPushHandSettings
from wbmpc.experiments.rezero_rivals import RegulatorSettings, regulator_weights
from wbmpc.model import load_robot

BALL = [n for n in REGISTRY if n.startswith("rezero-")]


@pytest.mark.parametrize(
    ("name", "given"),
    [
        ("rezero-door", "controller=lqr"), ("rezero-door", "tracking.kind=actuators"),
        ("rezero-door", "lasting_after=0.5"),
        ("rezero-frequency", "controller=separate"), ("rezero-frequency", "drive_dead_time=0.02"),
        ("rezero-taskspace", "controller=lqr"), ("rezero-steps", "cost.torque.force=2"),
    ],
)  # fmt: skip
def test_what_an_experiment_does_not_use_is_refused(name: str, given: str) -> None:
    with pytest.raises(
        InputError, match=rf"{name}: --set {given.split('=')[0].removesuffix('.kind')}: this experiment does not use it"
    ):
        configure(REGISTRY[name].config_type, [given], name)


@pytest.mark.parametrize("name", BALL)
def test_defaults_and_what_is_used_are_taken(name: str) -> None:
    kind = REGISTRY[name].config_type
    configure(kind, [], name)
    usual = configure(kind, ["observer=false", "cost.torque.wheel=0.3", "plant.dead_time=0.008"], name)
    assert usual.cost.torque.wheel == 0.3
    if name not in ("rezero-door", "rezero-frequency", "rezero-taskspace"):
        assert configure(kind, ["controller=lqr", "cost.lean=0.5"], name).controller == "lqr"


def test_factors_of_a_regulator_are_of_the_weights_that_they_name() -> None:
    robot, settings = load_robot("rezero"), RezeroPushHandSettings()
    usual = regulator_weights(robot, settings, RegulatorSettings())
    of = lambda **factors: regulator_weights(robot, settings, RegulatorSettings(**factors))
    wheels, arm = robot.input["wheel"], robot.input["arm"]
    torque = usual.torque.copy()
    torque[wheels], torque[arm] = 3.0 * torque[wheels], 6.0 * torque[arm]
    assert of(torque=3.0, arm=2.0).torque == pytest.approx(torque)
    state, held = usual.state.copy(), of(posture=5.0)
    for group in ("arm", "arm_velocity"):
        assert state[robot.state[group]].min() > 0.0
        state[robot.state[group]] *= 5.0
    assert held.state == pytest.approx(state)
    assert np.array_equal(replace(held, state=usual.state).torque, usual.torque)
    assert of(hand=0.1).hand == pytest.approx(0.1 * usual.hand)

"""`rezero-frequency`, shortened. Truth: the experiment's goal, its torque error computed once more, rigid drives."""

from __future__ import annotations

import numpy as np
import pytest

from effort import thorough
from wbmpc.configuration import configure
from wbmpc.errors import InputError
from wbmpc.registry import REGISTRY
from wbmpc.studies.minniti2019.frequency_settings import RezeroFrequencySettings

SHORT = {"settle_time": 1.5, "hold_time": 2.0}


@pytest.fixture(scope="module")
def both():  # type: ignore[no-untyped-def]
    return REGISTRY["rezero-frequency"].run(RezeroFrequencySettings(**SHORT), 0, None)


@thorough
def test_filters_halve_the_torque_error(both) -> None:  # type: ignore[no-untyped-def]
    assert both.completed, both.reason
    m = {name: metric.value for name, metric in both.metrics.items()}
    assert m["torque_error_ratio"] <= 0.5
    assert m["rise_time_ratio"] == pytest.approx(1.0, abs=0.05)
    assert m["torque_error_rms_plain"] > 0.02 and m["fell_shaped"] == 0.0
    for name in ("plain", "shaped"):
        acting, asked = both.log.array(f"acting_{name}"), both.log.array(f"torque_{name}")
        # commands are a tick older than what they do
        error = np.sqrt(np.mean((acting[1:, :3] - asked[:-1, :3]) ** 2))
        assert m[f"torque_error_rms_{name}"] == pytest.approx(error, rel=1e-3)
    assert {s.name for s in both.plots[0].series} == {"plain", "shaped", "asked"}


@thorough
def test_rigid_drives_do_what_they_are_asked_for() -> None:
    rigid = {"drives": "rigid", "actuator_time_constant": 0.0}
    settings = RezeroFrequencySettings(**{**SHORT, "settle_time": 1.3, "hold_time": 1.0}, plain=False, plant=rigid)
    result = REGISTRY["rezero-frequency"].run(settings, 0, None)
    assert result.completed, result.reason
    assert result.metrics["torque_error_rms_shaped"].value < 1e-9
    assert result.metrics["arm_torque_error_rms_shaped"].value < 1e-9
    assert "torque_error_ratio" not in result.metrics


def test_bad_settings() -> None:
    with pytest.raises(InputError, match="one variant at least is needed"):
        configure(RezeroFrequencySettings, ["plain=false", "shaped=none"], "rezero-frequency")
    with pytest.raises(InputError, match=r"shaped\.wheel_zero"):
        configure(RezeroFrequencySettings, ["shaped.wheel_zero=0"], "rezero-frequency")

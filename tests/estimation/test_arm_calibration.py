"""Zeros of an arm's encoders. Truth: MuJoCo's kinematics of an arm with known zeros."""

from __future__ import annotations

import numpy as np
import pytest

from toys import robot
from wbmpc.bases.swerve.perturbation import SwervePerturbation
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.errors import InputError
from wbmpc.estimation.arm_calibration import ZERO_STD, calibrate_arm

SWERVE = robot("swerve-ur10")
STD = 1e-4


@pytest.fixture(scope="module")
def tracked() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Zeros (6), encoders (20, 6) and noisy positions (20, 3) in axes of the base."""
    rng, part = np.random.default_rng(3), SWERVE.state["arm"]
    offset, plant = (
        rng.uniform(-2e-3, 2e-3, 6),
        SwervePlant(SWERVE.description, None, SwervePerturbation.none(), settle=0.0),
    )
    arm = SWERVE.home[part] + rng.uniform(-0.7, 0.7, (20, 6))
    places = []
    for angles in arm:
        x = SWERVE.home.copy()
        x[part] = angles
        plant.arrange(x)
        places.append(plant.truth().tool_in_base)
    return offset, arm + offset, np.array(places) + STD * rng.normal(size=(20, 3))


def test_zeros_that_move_the_end_effector_are_found(tracked) -> None:  # type: ignore[no-untyped-def]
    offset, arm, tool = tracked
    found = calibrate_arm(SWERVE, arm, tool, STD)
    error, std = found.offset - offset, np.sqrt(np.diag(found.covariance))
    assert np.abs(error[:5]).max() < 0.4e-3 and (np.abs(error) < 4.0 * std).all()
    assert std[5] == pytest.approx(ZERO_STD, rel=0.1)  # it turns the tool about its own axis: nobody sees it
    assert 0.5 * STD < found.misfit / np.sqrt(3.0) < 1.5 * STD


def test_positions_that_no_zeros_explain_are_an_error(tracked) -> None:  # type: ignore[no-untyped-def]
    _, arm, tool = tracked
    with pytest.raises(InputError, match="positions miss by"):
        calibrate_arm(SWERVE, arm, tool[:, [1, 0, 2]], STD)
    with pytest.raises(InputError, match="6 angles"):
        calibrate_arm(SWERVE, arm[:, :5], tool, STD)
    with pytest.raises(InputError, match="finite"):
        calibrate_arm(SWERVE, arm, np.full_like(tool, np.nan), STD)

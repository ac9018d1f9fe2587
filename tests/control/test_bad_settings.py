"""Numbers of which no controller can be made. Truth: what they are, by the documentation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from toys import robot
from wbmpc.bases.ball.controller import BallController
from wbmpc.bases.ball.fall_detection import FallPredictor
from wbmpc.bases.ball.lean_control import LeanControl
from wbmpc.bases.ball.sent_torques import DriveSettings
from wbmpc.bases.swerve.controller import SwerveController
from wbmpc.bases.swerve.tracking import TrackingSettings
from wbmpc.errors import InputError
from wbmpc.studies.minniti2019.lqr import LqrWeights, RegulatorGains
from wbmpc.studies.minniti2019.separate import ArmLoop, EndEffectorInverse
from wbmpc.studies.minniti2019.taskspace_control import TaskGains
from wbmpc.studies.minniti2019.tracking_control import ActuatorGains
from wbmpc.studies.pankert2022.track_control import DryFriction, Smoothing

BALL, SWERVE, NAN = robot("rezero"), robot("swerve-ur10"), float("nan")
ARM, WEIGHTS = BALL.home[5:8], LqrWeights(np.ones(6), np.ones(6), np.ones(16), np.ones(6))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: FallPredictor(BALL, NAN * ARM), "'arm' needs 3"),
        (lambda: LeanControl(BALL, ARM, 0.6, 0.0), "lean_control: 'speed' must be positive"),
        (lambda: LeanControl(BALL, ARM, NAN, 2.0), "lean_control: 'share' must be finite"),
        (lambda: BallController(BALL, None, np.zeros(6), 0.0, DriveSettings()), "'period' must be positive"),  # type: ignore[arg-type]
        (lambda: DriveSettings(lag=-0.02), "'lag' must not"),
        (lambda: BallController(BALL, None, np.full(6, NAN), 0.0025, DriveSettings()), "'torque' needs 6"),  # type: ignore[arg-type]
        (lambda: SwerveController(SWERVE, np.zeros(3), NAN), "swerve robot's controller: 'period' must be finite"),
        (lambda: TrackingSettings(lag=-1.0), "'lag' must not be negative"),
        (lambda: ActuatorGains(arm_stiffness=np.inf), "arm_stiffness must be at least 0 and finite"),
        (lambda: ArmLoop(pace=0.0, integral=1.0), "arm's loop: 'pace' must be positive"),
        (lambda: EndEffectorInverse(BALL, np.full(6, -1.0), 1.0), "inverse kinematics: 'weight' must not be negative"),
        (lambda: EndEffectorInverse(BALL, np.ones(6), 0.0), "inverse kinematics: 'posture' must be positive"),
        (lambda: replace(WEIGHTS, torque=np.zeros(6)), "regulator's weights: 'torque' must be positive"),
        (lambda: replace(WEIGHTS, end_effector=np.ones(3)), "regulator's weights: 'end_effector' needs 6"),
        (lambda: RegulatorGains(BALL, WEIGHTS, 0.0), "regulator: 'period' must be positive"),
        (lambda: TaskGains(torque=NAN), "task-space gains: 'torque' must be finite"),
        (lambda: DryFriction(4, 0.0, 0.02), "dry friction: 'period' must be positive"),
        (lambda: Smoothing(0.0, 0.001, 1), "smoothing: 'time' must be positive"),
    ],
)
def test_what_no_controller_can_be_made_of_is_rejected(make: Callable[[], Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        make()

"""The ball robot's experiments with a robot of one's own: other wheels, a longer arm. Truth: what its file says."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_ball_variants import variant

from wbmpc.cli import main
from wbmpc.configuration import configure
from wbmpc.log import Log
from wbmpc.model.robot import RobotModel
from wbmpc.registry import REGISTRY
from wbmpc.simulation.lockstep import Ending
from wbmpc.studies.minniti2019 import circle as rezero_circle
from wbmpc.studies.minniti2019 import frequency as rezero_frequency
from wbmpc.studies.minniti2019 import push as rezero_push
from wbmpc.studies.minniti2019 import wholebody as rezero_wholebody
from wbmpc.studies.minniti2019.controller_settings import WholeBodyMpc
from wbmpc.studies.minniti2019.frequency_settings import RezeroFrequencySettings
from wbmpc.studies.minniti2019.metrics import common_plots
from wbmpc.studies.minniti2019.settings import RezeroSettings
from wbmpc.studies.minniti2019.task import BENT_ARM, Task, ball_robot, bent_arm, robot_of
from wbmpc.studies.minniti2019.taskspace_control import TaskGains, TaskSpaceController, _functions

BALL = [name for name in REGISTRY if name.startswith("rezero")]


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> RobotModel:
    """Five wheels, an arm of six joints."""
    return variant(tmp_path_factory.mktemp("own"), 5, 0.7, True)


@pytest.mark.parametrize("name", BALL)
def test_every_experiment_takes_a_robot_and_rejects_one_without_a_ball(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert REGISTRY[name].config_type().robot == "rezero"
    assert main(["run", name, "--set", "robot=swerve-ur10", "--out", str(tmp_path / "out")]) == 2
    assert "'swerve-ur10' has a base of type 'swerve'; valid: ball" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "module", "build"),
    [
        ("rezero-push-hand", rezero_push, rezero_push.build),
        ("rezero-circle", rezero_circle, rezero_circle.build),
        ("rezero-wholebody", rezero_wholebody, rezero_wholebody.build),
    ],
)
def test_its_task_is_its_own(
    name: str, module: object, build: Callable[..., Any], own: RobotModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It starts at the home of its file; the body's references have its size and begin with the end effector where it is."""
    tasks: list[Task] = []
    monkeypatch.setattr(module, "task_scenario", lambda settings, seed, task, *more: tasks.append(task))
    settings = configure(REGISTRY[name].config_type, [f"robot={own.description.source}"], name)
    build(settings, 0)
    np.testing.assert_allclose(tasks[0].arm, [0.0, 1.0, 0.8, 0.0, 0.4, 0.0])
    if "body" in tasks[0].references:
        start = tasks[0].references["body"].at(0.0)
        assert start.size == 2 * 11
        np.testing.assert_allclose(own.pose(start)[0], own.pose(own.home)[0], atol=2e-3)


def test_what_is_asked_of_its_model(own: RobotModel) -> None:
    settings = RezeroSettings(robot=own.description.source)
    assert (
        "payload" in robot_of(settings, WholeBodyMpc()).parameters and "payload" not in ball_robot(settings).parameters
    )
    assert "force" in ball_robot(settings, contact="force").input.groups
    assert bent_arm(RezeroSettings(), own) is BENT_ARM
    # contacts that its file has for other purposes are not inputs of the tasks
    path = Path(own.description.source).with_name("pushed.yaml")
    path.write_text(Path(own.description.source).read_text().replace("  type: ball", "  type: ball\n  contact: wrench"))
    assert set(ball_robot(RezeroSettings(robot=str(path))).input.groups) == {"wheel", "arm"}


def recorded(own: RobotModel, *names: str) -> Log:
    """Torques of 1, 2, … 11 N m, wheels first, at rest."""
    log, torque = Log(), np.arange(1.0, 12.0)
    for t in np.arange(0.0, 3.0, 0.1):
        for name in names or ("",):
            for channel, row in {
                "state": own.home, "torque": torque, "acting": torque, "asked": 0.0 * torque, "hand": np.zeros(3),
                "wanted": np.zeros(3), "tilt": 0.0,
            }.items():  # fmt: skip
                log.add(f"{channel}_{name}" if name else channel, t, row)
    return log


def test_wheels_are_reported_from_the_arm(own: RobotModel) -> None:
    """Five wheels with 1 to 5 N m, six joints with 6 to 11 N m: root mean squares by hand."""
    log = recorded(own)
    (plot,) = (p for p in common_plots(log, np.zeros(3), np.zeros(2)) if p.title == "Wheel torques")
    assert [s.y[0] for s in plot.series] == [1.0, 2.0, 3.0, 4.0, 5.0]
    settings = RezeroFrequencySettings(settle_time=1.3, hold_time=1.0)
    found = rezero_frequency.metrics(settings, recorded(own, "plain"), {"plain": Ending()})
    assert found["torque_error_rms_plain"].value == pytest.approx(np.sqrt(11.0))
    assert found["arm_torque_error_rms_plain"].value == pytest.approx(np.sqrt(451.0 / 6.0))


def test_the_task_space_baseline_balances_on_all_wheels(own: RobotModel) -> None:
    """Its regulator's poles, of the robot on five wheels."""
    home, torque = own.base.numeric.equilibrium(own.home[own.state["arm"]])
    controller = TaskSpaceController.__new__(TaskSpaceController)
    controller.robot, controller.gains, controller.home, controller._rest = own, TaskGains(), home, torque
    controller._model = _functions(own)
    gain = controller._lqr()
    assert gain.shape == (5, 10)
    poles = np.linalg.eigvals(np.block([[np.zeros((5, 5)), np.eye(5)], [-gain]]))
    assert poles.real.max() < 0.0

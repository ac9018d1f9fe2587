"""Arms of ball robots that rest against the robot itself, and encoders that stand still there."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml

import wbmpc as wb
from wbmpc.bases.ball import defaults
from wbmpc.bases.ball.self_contact import SelfContact
from wbmpc.bases.ball.sensor_faults import BallReadings, EncoderMonitor
from wbmpc.bases.ball.settings import mpc_settings
from wbmpc.model.robot import RobotModel

DATA = Path(wb.__file__).parent / "robots" / "data"
#: Yaw, shoulder, elbow [rad]: the tip of the forearm 5 mm beside the base, from which a larger elbow brings it nearer (see the test).
RESTS = np.array([0.0, 1.5, 2.39])


@pytest.fixture(scope="module")
def listed(tmp_path_factory: pytest.TempPathFactory) -> RobotModel:
    """Rezero, whose file lists the pair of base and forearm."""
    data = yaml.safe_load((DATA / "rezero.yaml").read_text())
    data |= {"model": str(DATA / "rezero.xml"), "collision": {"self": {"pairs": [["base", "arm_forearm_link"]]}}}
    path = tmp_path_factory.mktemp("robot") / "listed.yaml"
    path.write_text(yaml.safe_dump(data))
    return wb.load_robot(path)


def apart(arm: np.ndarray, part: str) -> float:
    """MuJoCo's distance [m] of a body's drawn shapes to those of Rezero's base, at arm angles (3) [rad]."""
    model = mujoco.MjModel.from_xml_path(str(DATA / "rezero.xml"))
    data = mujoco.MjData(model)
    for name, angle in zip(("arm_yaw", "arm_shoulder", "arm_elbow"), arm, strict=True):
        data.qpos[model.jnt_qposadr[model.joint(name).id]] = angle
    mujoco.mj_kinematics(model, data)
    of = lambda body: np.flatnonzero(model.geom_bodyid == model.body(body).id).tolist()
    ends = np.zeros(6)
    return min(mujoco.mj_geomDistance(model, data, a, b, 1.0, ends) for a in of("base") for b in of(part))


def test_stops_of_the_shoulder_keep_the_upper_arm_off_the_base() -> None:
    """Truth: MuJoCo's distances at the stops; 0.05 rad farther they touch, so that the stops take no reach."""
    robot = wb.load_robot("rezero")
    place = robot.state["arm"].start + 1
    for stop in (robot.limits.state_lower[place], robot.limits.state_upper[place]):
        for yaw in np.linspace(-2.6, 2.6, 9):
            assert apart(np.array([yaw, stop, 0.0]), "arm_upper_link") > 0.001
        assert apart(np.array([0.0, stop + np.sign(stop) * 0.05, 0.0]), "arm_upper_link") < 0.0


def test_a_turn_that_closes_is_one_that_brings_parts_nearer(listed: RobotModel) -> None:
    """Truth: MuJoCo's distances before and after the turn."""
    contact, x = SelfContact(listed), listed.home.copy()
    x[listed.state["arm"]] = RESTS
    here = apart(RESTS, "arm_forearm_link")
    assert 0.0 < here < 0.01
    for joint, turn in ((1, 0.02), (1, -0.02), (2, 0.01), (2, -0.02)):
        nearer = apart(RESTS + turn * np.eye(3)[joint], "arm_forearm_link") < here
        assert contact.closes(x, joint, turn) is nearer
    assert not contact.closes(listed.home, 2, 0.02)  # nearer, but far


@pytest.mark.parametrize(("turns", "found"), [(1.0, False), (-1.0, True)])
def test_an_arm_that_rests_against_the_body_has_no_failed_encoder(
    listed: RobotModel, turns: float, found: bool
) -> None:
    """A drive presses the elbow against the base: it stands. If it had to turn away, it would stand for its encoder."""
    monitor, x = EncoderMonitor(3, listed.state.groups["arm"], contact=SelfContact(listed)), listed.home.copy()
    x[listed.state["arm"]] = RESTS
    pressed, faults = np.array([0.0, 0.0, turns * 400.0]), []
    for k in range(80):
        acceleration = pressed * (k > 10)
        faults += monitor.update(BallReadings(0.0025 * k, 0.0025, RESTS, np.zeros(3), acceleration, (), None, x))
    assert [f.part for f in faults] == ["arm_elbow"] * found
    assert bool(monitor.lost) is found


def test_pairs_of_the_robot_file_are_kept_apart(listed: RobotModel, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(defaults, "MPC", lambda ocp, *_, **__: ocp)  # no machine code
    for robot, there in ((listed, True), (wb.load_robot("rezero"), False)):
        assert (
            "self_clearance" in defaults.rezero_mpc(robot, mpc_settings(3e-2), defaults.RezeroCost()).terms
        ) is there

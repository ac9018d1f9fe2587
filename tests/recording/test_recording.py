"""Recordings of real runs. Truth: rosbags, which reads the file by code of its own, against the run's NumPy archive; MuJoCo's
force sensors and the robot's weight; the run without a recorder."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from mcap.reader import NonSeekingReader
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability
from rosbags.typesys import Stores, get_typestore

from effort import some
from frame_tree import joined, of_transforms, of_urdf, place, root
from wbmpc import lie
from wbmpc.bases.ball.plant import BallPlant
from wbmpc.bases.swerve.messages import SwerveCommand
from wbmpc.bases.swerve.plant import SwervePlant
from wbmpc.cli import main
from wbmpc.errors import EndedByUser, InputError
from wbmpc.model.robot import load_robot
from wbmpc.mpc.policy_queue import PolicyQueue
from wbmpc.ocp import Mode, ModeSchedule
from wbmpc.recording.reader import read_recording
from wbmpc.recording.recorder import PAUSE, Recorder
from wbmpc.registry import REGISTRY
from wbmpc.robots import load_description
from wbmpc.simulation.lockstep import Ending, Running, Watch, run_lockstep, watched
from wbmpc.simulation.scene import Scene, SceneReader
from wbmpc.studies.pankert2022 import stability as swerve_stability
from wbmpc.types import Timing
from wbmpc.view.replay import Film
from wbmpc.view.session import system_of

FAST = ["--set", "periods=1", "--set", "speed=0.8", "--set", "settle_time=1", "--set", "calibration=none"]
BALL = ["--set", "forces=[20]", "--set", "settle_time=0.5", "--set", "pause=2"]
STORE = get_typestore(Stores.ROS2_JAZZY)


@pytest.fixture(scope="module")
def track(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("track")
    assert main(["run", "swerve-track", "--seed", "3", *FAST, "--out", str(out), "--json"]) == 0
    return out


@pytest.fixture(scope="module")
def ball(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("ball")
    assert main(["run", "rezero-push-ball", "--seed", "3", *BALL, "--out", str(out), "--json"]) == 0
    return out


def messages(folder: Path, topic: str) -> Iterator[tuple[float, object]]:
    with AnyReader([folder / "run.mcap"]) as reader:
        chosen = [c for c in reader.connections if c.topic == topic]
        for connection, ns, raw in reader.messages(chosen):
            yield ns / 1e9, reader.deserialize(raw, connection.msgtype)


def poses(folder: Path, topic: str) -> tuple[np.ndarray, np.ndarray]:
    found = [(t, m.pose) for t, m in messages(folder, topic)]  # type: ignore[attr-defined]
    return np.array([t for t, _ in found]), np.array(
        [[*map(float, (p.position.x, p.position.y, p.position.z))] for _, p in found]
    )


def quaternion(q) -> np.ndarray:  # type: ignore[no-untyped-def]
    return np.array([q.w, q.x, q.y, q.z])


def test_hand_and_encoders_are_those_of_the_archive(track: Path) -> None:
    with np.load(track / "log.npz") as log:
        # of the reference the recording has what the MPC is given: samples of 20 ms, joined by lines
        for topic, channel, apart in (
            ("/ground_truth/end_effector", "hand", 1e-12),
            ("/end_effector_reference", "hand_reference", 2e-4),
        ):
            t, p = poses(track, topic)
            np.testing.assert_allclose(t, log[f"{channel}.time"], atol=1e-9)
            np.testing.assert_allclose(p, log[channel], atol=apart)
        # the archive takes the true height, the recording that of the estimate
        np.testing.assert_allclose(poses(track, "/end_effector_pose")[1], log["hand_odometry"], atol=2e-3)
        for topic, channel in (
            ("/measured/arm", "arm"),
            ("/measured/steer", "steer"),
            ("/command/wheel", "wheel_command"),
        ):
            values = np.array([m.data for _, m in messages(track, topic)])  # type: ignore[attr-defined]
            np.testing.assert_array_equal(values, log[channel])


def test_frames_are_those_of_the_archive(track: Path) -> None:
    with np.load(track / "log.npz") as log:
        base, believed, times = log["base"], log["base_odometry"], log["base.time"]
    found = list(messages(track, "/tf"))
    assert len(found) > 200
    for t, message in found[::20]:
        frames = {f.child_frame_id: f for f in message.transforms}  # type: ignore[attr-defined]
        drift, estimate = frames["odom"], frames["base_link"]
        assert (drift.header.frame_id, estimate.header.frame_id) == ("map", "odom")
        assert {"leg_LF", "wheel_RB", "wrist_3_link", "contact_wheel_LF"} <= set(frames)
        k = int(np.argmin(np.abs(times - t)))
        e = estimate.transform
        assert [e.translation.x, e.translation.y] == pytest.approx(believed[k, :2], abs=1e-12)
        d = drift.transform
        at = np.array([d.translation.x, d.translation.y, d.translation.z])
        place = at + lie.quaternion_to_rotation(quaternion(d.rotation)) @ [*believed[k, :2], e.translation.z]
        assert place[:2] == pytest.approx(base[k, :2], abs=1e-9)
        whole = lie.quaternion_multiply(quaternion(d.rotation), quaternion(e.rotation))
        assert lie.rotation_to_euler_zyx(lie.quaternion_to_rotation(whole))[0] == pytest.approx(base[k, 2], abs=1e-9)
    odometry = [m for _, m in messages(track, "/odom")]
    x = np.array([m.pose.pose.position.x for m in odometry])  # type: ignore[attr-defined]
    np.testing.assert_allclose(x, believed[:, 0], atol=1e-12)
    # the speed in the base's axes: its integral is the way
    v = np.array([m.twist.twist.linear.x for m in odometry])  # type: ignore[attr-defined]
    assert np.sum(v) * 0.01 == pytest.approx(x[-1] - x[0], rel=1e-2)


@pytest.mark.parametrize(
    ("run", "points"), [("track", {"tool0", "mount", "imu", "arm_base_link"}), ("ball", {"tool", "imu", "ball"})]
)
def test_recorded_frames_and_the_description_are_one_tree(
    run: str, points: set[str], request: pytest.FixtureRequest
) -> None:
    """A stand-in for robot_state_publisher beside the recording gives no frame another parent; the end effector is where it was."""
    folder = request.getfixturevalue(run)
    text = next(m.data for _, m in messages(folder, "/robot_description"))  # type: ignore[attr-defined]
    fixed, moved = ([m for _, m in messages(folder, t)] for t in ("/tf_static", "/tf"))
    links, by_joints = of_urdf(text)
    recorded = joined(of_transforms(fixed), of_transforms(moved))
    parents = joined(by_joints, recorded)
    assert root(parents, "imu") == "map" and (parents["odom"], parents["base_link"]) == ("map", "odom")
    assert links | points <= set(recorded)
    odometry = next(m for _, m in messages(folder, "/odom"))
    assert odometry.child_frame_id == "base_link"  # type: ignore[attr-defined]
    frames = {t.child_frame_id: t for m in (fixed[0], moved[-1]) for t in m.transforms}  # type: ignore[attr-defined]
    at, turn, frame = np.zeros(3), np.eye(3), "tool0" if run == "track" else "tool"
    while frame in frames:
        p, r = place(frames[frame].transform)
        at, turn, frame = p + r @ at, r @ turn, frames[frame].header.frame_id
    times, hands = poses(folder, "/ground_truth/end_effector")
    when = [t for t, _ in messages(folder, "/tf")][-1]
    np.testing.assert_allclose(at, hands[np.argmin(np.abs(times - when))], atol=1e-6)


def test_plans_go_ahead_of_the_hand(track: Path) -> None:
    """The plan's end effector starts where the end effector is soon after, and ends where it is a horizon later."""
    with np.load(track / "log.npz") as log:
        times, end_effector = log["hand.time"], log["hand_odometry"]
    t, plan = next((t, m) for t, m in messages(track, "/end_effector_plan") if t > 2.0)
    first, last = plan.poses[0].pose.position, plan.poses[-1].pose.position  # type: ignore[attr-defined]
    at = lambda when: np.array([np.interp(when, times, end_effector[:, i]) for i in range(3)])
    assert np.linalg.norm([first.x, first.y, first.z] - at(t + 0.03)) < 0.02
    assert np.linalg.norm([last.x, last.y, last.z] - at(t + 0.03)) > 0.5
    assert len(plan.poses) <= 31  # type: ignore[attr-defined]


def test_contact_forces_carry_the_robot(track: Path) -> None:
    plant = SwervePlant(load_description("swerve-ur10"), None, None, 3)
    vertical = [
        np.array([m.wrench.force.z for _, m in messages(track, f"/contact/wheel_{leg}")])  # type: ignore[attr-defined]
        for leg in ("LF", "RF", "LB", "RB")
    ]
    assert min(map(len, vertical)) > 200
    assert np.mean(np.sum(vertical, axis=0)) == pytest.approx(plant.weight, rel=0.01)
    assert min(map(np.min, vertical)) > 50.0


def test_contacts_agree_with_the_force_sensors() -> None:
    plant = SwervePlant(load_description("swerve-ur10"))
    reader = SceneReader(plant.model, "body")
    for _ in range(100):
        plant.step(SwerveCommand.stop(), 5)
    truth = plant.truth()
    previous = plant.data.qacc.copy()
    contacts = {c.body: c for c in reader.contacts(plant.data)}
    np.testing.assert_array_equal(plant.data.qacc, previous)  # the plant is left alone
    forces = np.array([contacts[f"wheel_{leg}"].force[2] for leg in ("LF", "RF", "LB", "RB")])
    np.testing.assert_allclose(forces, truth.wheel_force, rtol=2e-3)
    assert all(abs(c.point[2]) < 1e-3 for c in contacts.values())


def test_the_ball_robot_is_recorded_from_the_floor_up(ball: Path) -> None:
    radius = 0.125
    with np.load(ball / "log.npz") as log:
        t, end_effector = poses(ball, "/ground_truth/end_effector")
        every = np.isin(np.round(log["hand.time"], 9), np.round(t, 9))
        np.testing.assert_allclose(end_effector - [0, 0, radius], log["hand"][every], atol=1e-12)
        torque = np.array([m.data for _, m in messages(ball, "/command/torque")])  # type: ignore[attr-defined]
        np.testing.assert_array_equal(torque, log["torque"][every])
    plant = BallPlant(load_description("rezero"), None, None, None, 3)
    force = np.array([m.wrench.force.z for _, m in messages(ball, "/contact/ball")])  # type: ignore[attr-defined]
    assert np.mean(force) == pytest.approx(plant.weight, rel=0.03)
    drift = [f for _, m in messages(ball, "/tf") for f in m.transforms if f.child_frame_id == "odom"]  # type: ignore[attr-defined]
    assert all(abs(f.transform.translation.x) < 1e-12 for f in drift)


def test_the_solver_is_recorded(track: Path) -> None:
    saved = json.loads((track / "metrics.json").read_text())["mpc"]
    seconds = [m.data for _, m in messages(track, "/mpc/solve_time")]  # type: ignore[attr-defined]
    assert len(seconds) == saved["solves"]
    # the first solve is not in the statistics
    assert np.median(seconds[1:]) * 1e3 == pytest.approx(saved["solve_ms"]["median"], rel=1e-3)
    assert [m.data for _, m in messages(track, "/mpc/failures")][-1] == saved["failures"]  # type: ignore[attr-defined]
    assert [m.data for _, m in messages(track, "/mpc/period")] == [0.02]  # type: ignore[attr-defined]
    assert [m.data for _, m in messages(track, "/mode")] == ["CCCC", "ended: completed"]  # type: ignore[attr-defined]


def test_what_ran_is_in_the_file(track: Path) -> None:
    with AnyReader([track / "run.mcap"]) as reader:
        qos = {c.topic: c.ext.offered_qos_profiles[0].durability for c in reader.connections}  # type: ignore[union-attr]
    assert qos["/robot_description"] is qos["/tf_static"] is QosDurability.TRANSIENT_LOCAL
    assert qos["/joint_states"] is QosDurability.VOLATILE
    recording = read_recording(track)
    assert recording.complete
    saved = json.loads((track / "metrics.json").read_text())
    assert json.loads(recording.metadata["run"]["settings"]) == saved["settings"]
    assert recording.metadata["run"]["seed"] == "3"
    assert recording.metadata["versions"]["mujoco"] == saved["versions"]["mujoco"]
    assert recording.metadata["result"]["completed"] == "true"
    figures = {name: m["value"] for name, m in saved["metrics"].items()}
    assert json.loads(recording.metadata["result"]["metrics"]) == figures
    scene = Scene.of_plain(recording.attachment("scene.json"))
    assert scene.robot == "base_link" and {s.kind for s in scene.shapes} == {"box", "capsule", "cylinder", "plane"}


def test_recording_changes_nothing(tmp_path: Path) -> None:
    """Every command and the end of the run, to the last bit."""

    def run(*watchers: Recorder) -> tuple[np.ndarray, np.ndarray]:
        plant, controller, mpc, timing = system_of(load_robot("rezero"), 3).parts
        commands: list[np.ndarray] = []
        note = lambda t, command, plans: commands.append(np.concatenate([np.ravel(v) for v in vars(command).values()]))
        assert run_lockstep(plant, controller, mpc, timing, 0.4, note, Watch(None, watchers)).reason == ""
        return np.array(commands), plant.data.qpos.copy()

    recorder = Recorder(tmp_path / "run.mcap", {})
    recorded, alone = run(recorder), run()
    recorder.close({"completed": "true"})
    assert len(read_recording(tmp_path)["/joint_states"].times) == 40
    for one, other in zip(recorded, alone):
        np.testing.assert_array_equal(one, other)
    assert np.ptp(alone[0][1:], axis=0).max() > 0.0  # it moves


def test_a_killed_run_leaves_a_readable_file(tmp_path: Path) -> None:
    command = [
        sys.executable,
        "-m",
        "wbmpc",
        "run",
        "swerve-track",
        "--set",
        "settle_time=0",
        "--set",
        "calibration=none",
        "--out",
        str(tmp_path),
        "--json",
    ]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2] / "src")}
    process = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL)
    path, deadline = tmp_path / "run.mcap", time.monotonic() + 300.0
    while not (path.exists() and path.stat().st_size > 200_000) and time.monotonic() < deadline:
        assert process.poll() is None
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    recording = read_recording(path)
    assert not recording.complete and recording.end > 0.5
    assert recording.metadata["run"]["experiment"] == "swerve-track" and "result" not in recording.metadata
    # the same by mcap's own reader for streams, payloads by rosbags
    end_effector = []
    with path.open("rb") as file, pytest.raises(Exception):  # noqa: B017 - the end is missing
        for schema, channel, message in NonSeekingReader(file).iter_messages(log_time_order=False):
            assert schema is not None
            if channel.topic == "/ground_truth/end_effector":
                end_effector.append(STORE.deserialize_cdr(message.data, schema.name).pose.position.x)
    ours = recording.table("/ground_truth/end_effector").columns["pose.position.x"]
    np.testing.assert_array_equal(ours, end_effector)


@pytest.mark.parametrize("share", [0.9999, 0.9, 0.5, 0.02, 0.004])
def test_a_file_that_ends_anywhere_is_read_up_to_there(track: Path, tmp_path: Path, share: float) -> None:
    whole = (track / "run.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: int(share * len(whole))])
    cut, full = read_recording(tmp_path / "cut.mcap"), read_recording(track)
    assert not cut.complete
    for name, topic in cut.topics.items():
        assert topic.data == full[name].data[: len(topic.data)]
    kept = sum(len(t.data) for t in cut.topics.values()) / sum(len(t.data) for t in full.topics.values())
    assert kept > share - 0.15


def test_what_is_no_recording_is_said(tmp_path: Path) -> None:
    (tmp_path / "text.mcap").write_text("hello " * 100)
    (tmp_path / "empty.mcap").write_text("")
    for name in ("text", "empty"):
        with pytest.raises(InputError, match="is not a recording"):
            read_recording(tmp_path / f"{name}.mcap")
    with pytest.raises(InputError, match="there is no such recording"):
        (tmp_path / "run").mkdir()
        read_recording(str(tmp_path / "run"))


def test_a_second_loop_follows_the_first(tmp_path: Path) -> None:
    """An experiment of several parts gives one file; times go on."""
    recorder = Recorder(tmp_path / "run.mcap", {"run": {"experiment": "two"}})
    part = _Part()
    for _ in range(2):
        recorder.begin(part.running())
        for i in range(9):
            recorder.tick(i * 0.0025, SwerveCommand.stop(), part.plans)
        recorder.end(Ending())
    recorder.close({"completed": "true"})
    times = read_recording(tmp_path).table("/joint_states").times
    np.testing.assert_allclose(times, [0.0, 0.01, 0.02, 0.02 + PAUSE, 0.03 + PAUSE, 0.04 + PAUSE])


def test_a_run_without_an_mpc_is_recorded(tmp_path: Path) -> None:
    recorder, part = Recorder(tmp_path / "run.mcap", {}), _Part()
    running = part.running()
    recorder.begin(Running(running.plant, running.controller, None, running.timing, 1.0))
    recorder.tick(0.0, SwerveCommand.stop(), part.plans)
    recorder.close({"completed": "true"})
    topics = read_recording(tmp_path).topics
    assert {"/joint_states", "/ground_truth/end_effector", "/tf"} <= set(topics)
    assert not any(name.startswith(("/mpc", "/plan", "/end_effector_reference")) for name in topics)


class _Seen(Exception):
    """A watcher has seen the loop."""


@pytest.mark.parametrize(
    "name",
    some(
        ["swerve-fixed", "swerve-calibrate", "swerve-brakes", "swerve-wobble", "rezero-frequency", "rezero-taskspace"],
        [2, 5],
    ),
)
def test_experiments_of_parts_hand_their_watchers_on(name: str) -> None:
    def seen(running: Running) -> None:
        raise _Seen

    watcher = SimpleNamespace(begin=seen, end=lambda ending: None)
    experiment = REGISTRY[name]
    with pytest.raises(_Seen):
        known = {"calibration": "none"} if name == "swerve-fixed" else {}
        experiment.run(experiment.config_type(**known), 0, Watch(None, (watcher,)))


def test_a_run_without_physics_of_its_own_is_recorded_too(tmp_path: Path) -> None:
    """`swerve-stability`: the feet, where the physics finds them, span the area of the paper's Table I."""
    assert main(["run", "swerve-stability", "--out", str(tmp_path), "--quiet"]) == 0
    recording = read_recording(tmp_path)
    said = [m["data"] for _, m in recording["/mode"].messages()]
    assert said == [line for name in "HXA" for line in (f"begins: {name}", "ended: completed")]
    film = Film(recording)
    for k, name in enumerate("HXA"):
        feet = film.snapshot(k * (swerve_stability.STANDING + PAUSE) + 0.5)["support"][:4, :2]
        x, y = feet.T
        area = 0.5 * abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
        assert area == pytest.approx(swerve_stability.TABLE[name][0], abs=0.02)


def test_every_part_is_drawn_in_its_own_world(tmp_path: Path) -> None:
    """A block that stands in the second of two worlds is far away while the first one is shown, and where it stands then."""

    def block(spec: mujoco.MjSpec) -> None:
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.1, 0.1, 0.1], pos=[1.5, 0.0, 0.1])

    recorder, description = Recorder(tmp_path / "run.mcap", {}), load_description("swerve-ur10")
    for edit in (None, block):
        plant = SwervePlant(description, edit=edit)
        with watched(plant, 0.01, 0.1, Watch(None, (recorder,))) as tick:
            for k in range(10):
                tick(0.01 * k, SwerveCommand.stop())
    recorder.close({})
    film = Film(read_recording(tmp_path))
    (shape,) = [s for s in film.scene.shapes if s.kind == "box" and s.pose[0] == 1.5]
    place = [b.name for b in film.scene.bodies].index(shape.body)
    at = lambda t: film.snapshot(t)["poses"][place]
    assert at(0.05)[2] < -50.0 and at(0.05 + 0.09)[2] < -50.0
    np.testing.assert_array_equal(at(0.09 + PAUSE + 0.05), [0, 0, 0, 1, 0, 0, 0])


def test_ctrl_c_ends_a_loop_that_an_experiment_runs_itself(tmp_path: Path) -> None:
    """Between two steps, with its recording closed and said to be interrupted."""
    recorder, plant = Recorder(tmp_path / "run.mcap", {}), SwervePlant(load_description("swerve-ur10"))
    with (
        pytest.raises(EndedByUser, match=r"interrupted at 0.03 s"),
        watched(plant, 0.01, 1.0, Watch(None, (recorder,))) as tick,
    ):
        for k in range(100):
            if k == 3:
                os.kill(os.getpid(), signal.SIGINT)
            tick(0.01 * k, SwerveCommand.stop())
    recorder.close({})
    assert read_recording(tmp_path)["/mode"].last()["data"] == "ended: interrupted at 0.03 s"


class _Part:
    """The least that a recorder looks at: a plant, a controller that has not measured, an MPC that has not solved."""

    def __init__(self) -> None:
        self.plans = PolicyQueue()
        self._mpc = SimpleNamespace(
            period=0.02, statistics=SimpleNamespace(solves=0), reference={},
            solver=SimpleNamespace(schedule=ModeSchedule((Mode("rest"),))),
        )  # fmt: skip
        self._timing = Timing(0.0025, 5, 8, 4)
        self._controller = SimpleNamespace()

    def running(self) -> Running:
        return Running(SwervePlant(load_description("swerve-ur10")), self._controller, self._mpc, self._timing, 1.0)  # type: ignore[arg-type]


STACK = """
<mujoco><worldbody><geom type="plane" size="0 0 0.1"/>
  <body name="low" pos="0 0 0.1"><freejoint/><geom type="box" size="0.2 0.2 0.1" mass="3"/></body>
  <body name="high" pos="0.05 0 0.25"><freejoint/><geom type="box" size="0.1 0.1 0.05" mass="2"/></body>
</worldbody></mujoco>
"""


def test_bodies_that_lie_on_each_other() -> None:
    """Each is carried with its own weight: action and reaction have their signs."""
    model = mujoco.MjModel.from_xml_string(STACK)
    data = mujoco.MjData(model)
    for _ in range(2000):
        mujoco.mj_step(model, data)
    contacts = {c.body: c for c in SceneReader(model, "low").contacts(data)}
    np.testing.assert_allclose(contacts["low"].force, [0, 0, 3 * 9.81], atol=0.05)
    np.testing.assert_allclose(contacts["high"].force, [0, 0, 2 * 9.81], atol=0.05)
    np.testing.assert_allclose(contacts["high"].point, [0.05, 0, 0.2], atol=5e-3)

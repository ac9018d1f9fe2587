"""Files and values that somebody else made: one message with file and key and exit code 2, never a traceback or a hang.

Truth: the YAML 1.2 specification (no octal without 0o, no sexagesimal numbers, keys are unique), the generators of the fuzz
command, which know what they break, and the shapes in the robots' own files.
"""

from __future__ import annotations

import io
import json
import os
import stat
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from effort import draws
from fake_experiment import REGISTRY, FakeSettings
from wbmpc import registry as experiments
from wbmpc.bases.swerve.wheel_calibration import WheelCalibration
from wbmpc.cli import main
from wbmpc.configuration import configure
from wbmpc.errors import InputError
from wbmpc.input_file import read_file
from wbmpc.model.robot import load_robot
from wbmpc.obstacles.scene import read_scene
from wbmpc.recording.messages import decode, encode
from wbmpc.recording.reader import read_recording
from wbmpc.recording.records import MAGIC
from wbmpc.robots import load_description
from wbmpc.run_files import read_log, read_metrics
from wbmpc.study.definition import load_definition
from wbmpc.yaml_file import load_yaml, parse_yaml

sys.path.append(str(Path(__file__).parents[1] / "benchmarks"))


BAD_YAML = [
    ("a: -0b1_1", r"line 1, key 'a': '-0b1_1' may be read as a binary number"),
    ("a:\n  b: 010", r"line 2, key 'a.b': '010' may be read as an octal number; write 10"),
    ("a: {b: 1_0}", r"line 1, key 'a.b': '1_0' has an underscore that separates no thousands"),
    ("a: -1_000_00.5", r"'-1_000_00.5' has an underscore"),
    ("a: 0x_1", r"'0x_1' has an underscore"),
    ("a: 0x1_0F", r"'0x1_0F' has an underscore"),
    ("a: [1, 1:30]", r"line 1, key 'a.1': '1:30' may be read as a number to the base of 60"),
    ("a: 1\nb: 2\na: 3", r"line 3, key 'a': appears twice"),
    ("a: &x 1\nb: *x", r"line 1, key 'a': an anchor"),
    ("a: *x", r"line 1, key 'a': an alias"),
    ("a: !!python/name:os.system x", r"line 1, key 'a': a tag"),
    ("a: " + "[" * 100, r"nested deeper than 32 levels"),
    ("<<: {a: 1}", r"merging"),
    ("a: 1\n---\nb: 1", r"second document"),
    ('a: "\\UFFFFFFFF"', r"not valid YAML"),
    ('a: "\\ud800"', r"cannot be printed"),
    ("a: 0x_", r"has an underscore"),
    ("a: " + "9" * 5000, r"a number of 5000 characters"),
    ("a: 1e999", r"too large"),
    ("? [1]\n: 2", r"is no key"),
    ("#" * 300_000, r"at most 262144 are read"),
    ("a: [" + "1," * 100_000 + "1]", r"line 1, key 'a.[0-9]+': more than 8000 keys and values"),
    ("\n".join(f"k{k}: 1" for k in range(20_000)), r"more than 8000 keys and values"),
]


@pytest.mark.parametrize(("text", "says"), BAD_YAML, ids=range(len(BAD_YAML)))
def test_what_yaml_readers_take_differently_is_an_error_with_file_line_and_key(
    text: str, says: str, tmp_path: Path
) -> None:
    path = tmp_path / "file.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=says) as error:
        load_yaml(path)
    assert str(error.value).startswith(f"{path}: ") and "\n" not in str(error.value)


def test_numbers_and_texts_are_those_of_yaml() -> None:
    text = "a: 1e-3\nb: 0x1F\nc: '010'\nd: 2020-01-01\ne: 1_000\nf: -.5\ng: yes\nh: ~\ni: [0, 0.5]\n"
    expected = {
        "a": 1e-3,
        "b": 31,
        "c": "010",
        "d": "2020-01-01",
        "e": 1000,
        "f": -0.5,
        "g": True,
        "h": None,
        "i": [0, 0.5],
    }
    assert parse_yaml(text, "text") == expected


@pytest.mark.parametrize(
    "value", ["010", "1:30", "&a 1", "{a: 1, a: 2}", "[" * 5000, '"\\UFFFFFFFF"', "0x_", "9" * 5000]
)
def test_values_of_settings_go_by_the_same_rules(value: str) -> None:
    with pytest.raises(InputError, match=r"^fake: --set mpc.rate="):
        configure(FakeSettings, [f"mpc.rate={value}"], "fake")


def test_a_value_without_a_key_is_named_by_its_setting_alone() -> None:
    with pytest.raises(InputError, match=r"^fake: --set mpc.rate=010: '010' may be read as an octal number"):
        configure(FakeSettings, ["mpc.rate=010"], "fake")


@pytest.mark.parametrize(
    "value",
    [
        "joint_offset=1e12",
        "com_offset=1e12",
        "actuator_time_constant=1e12",
        "gyro_noise=1e12",
        "friction=1e12",
        "encoder_counts=1000000000000000",
    ],
)
def test_a_plant_is_a_machine_of_this_world(value: str) -> None:
    """Spreads and noise beyond every machine end in numbers that are not finite in the middle of a run."""
    model = experiments.REGISTRY["swerve-track"].config_type
    with pytest.raises(InputError, match=rf"swerve-track: --set plant.{value.partition('=')[0]}(\.0)?="):
        configure(model, [f"plant.{value}"], "swerve-track")


def test_calibrations_do(tmp_path: Path) -> None:
    path = tmp_path / "calibration.yaml"
    path.write_text("modules: {}\nmodules: {}\n")
    robot = load_robot("swerve-ur10")
    with pytest.raises(InputError, match=r"calibration.yaml: line 2, key 'modules': appears twice"):
        WheelCalibration.load(path, robot.base.geometry, list(robot.state.groups["steer"]))


@pytest.mark.parametrize(
    "read",
    [lambda p: read_file(p, 100), read_log, read_recording, load_yaml],
    ids=["bytes", "log", "recording", "yaml"],
)
def test_a_file_of_the_kernel_that_waits_for_more_is_an_error(
    read: Callable[[Path], object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As /proc/kmsg, which says that it is a regular file: a pipe that says so, with a writer who does not write."""
    os.mkfifo(path := tmp_path / "kmsg")
    monkeypatch.setattr(stat, "S_ISREG", lambda mode: True)
    monkeypatch.setattr(Path, "is_file", lambda path: True)
    writer = os.open(path, os.O_RDWR)
    try:
        with pytest.raises(InputError, match=r"kmsg: (cannot be read|this is not the log)"):
            read(path)
    finally:
        os.close(writer)


@pytest.mark.parametrize(("start", "says"), [(b"", "does not begin like one"), (MAGIC, "at most 8589934592 are read")])
def test_a_recording_of_a_terabyte_is_an_error_before_it_is_read(start: bytes, says: str, tmp_path: Path) -> None:
    """A sparse one, which has no room on the disk."""
    path = tmp_path / "big.mcap"
    path.write_bytes(start)
    os.truncate(path, 2**40)
    with pytest.raises(InputError, match=rf"big\.mcap: .*{says}"):
        read_recording(path)


def test_what_grows_while_it_is_read_is_read_within_its_limit() -> None:
    """Files of the kernel have no size until they are read."""
    with pytest.raises(InputError, match="has 9 bytes; at most 8 are read"):
        read_file(Path("/proc/self/status"), 8)


# ---------------------------------------------------------------------- runs and messages
ODD = ["", "[]", "[" * 100_000, '{"a":' * 5000, '{"metrics": []}',
       '{"metrics": {"a": 5}}', '{"metrics": {"a": {"value": "x", "unit": ""}}}',
       '{"metrics": {"a": {"value": NaN, "unit": ""}}}', '{"settings": 5}', '{"metrics": {"a": {"value": 1e999, "unit": ""}}}',
       '{"metrics": {}, "settings": {}, "metrics": {}}']  # fmt: skip


@pytest.mark.parametrize("text", ODD, ids=range(len(ODD)))
def test_odd_metrics_are_an_error(
    text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("a", "b"):
        Path(name).mkdir()
        np.savez(Path(name, "log.npz"), **{"hand": np.zeros(3), "hand.time": np.arange(3.0)})
        Path(name, "metrics.json").write_text(json.dumps({"metrics": {}, "settings": {}}))
    Path("b/metrics.json").write_text(text)
    assert main(["compare", "a", "b"]) == 2
    said = capsys.readouterr().err
    assert said.startswith("wbmpc: b/metrics.json: ") and len(said.splitlines()) == 1


@pytest.mark.parametrize("share", [0.0, 0.3, 0.6, 0.9])
def test_a_log_that_was_cut_is_an_error(
    share: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("a", "b"):
        Path(name).mkdir()
        np.savez(Path(name, "log.npz"), **{"hand": np.zeros(300), "hand.time": np.arange(300.0)})
        Path(name, "metrics.json").write_text(json.dumps({"metrics": {}, "settings": {}}))
    data = Path("b/log.npz").read_bytes()
    Path("b/log.npz").write_bytes(data[: int(share * len(data))])
    for command in (["compare", "a", "b"], ["calibrate", "b"]):
        assert main(command) == 2
        assert "b/log.npz: this is not the log of a run" in capsys.readouterr().err


def test_a_small_log_that_unpacks_to_much_is_an_error_before_that(tmp_path: Path) -> None:
    """260 MB of zeros in 260 kB, as an archive may say them; 1 MB that is packed as well is read."""
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "|u1", "fortran_order": False, "shape": (260 * 2**20,)})
    path = tmp_path / "log.npz"
    for size, says in ((260, r"packed into [0-9]+: no run's are packed so well"), (1, "not the log of a run")):
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("x.npy", "w") as file:
            file.write(head.getvalue())
            for _ in range(size):
                file.write(bytes(2**20))
        assert path.stat().st_size < 400_000
        with pytest.raises(InputError, match=says):
            read_log(path)
    np.savez_compressed(path, x=np.zeros(2**17))
    assert read_log(path)["x"].size == 2**17


MANY = {f"metric{k}": k for k in range(6000)}


@pytest.mark.parametrize(
    "more",
    [{"metrics": {name: {"value": k, "unit": ""} for name, k in MANY.items()}}, {"settings": MANY}, {"idealisations": ["a"] * 6000}],
    ids=["metrics", "settings", "texts"],
)  # fmt: skip
def test_a_run_of_more_figures_than_a_table_shows_is_an_error(more: dict[str, object], tmp_path: Path) -> None:
    """Their table took a millisecond for each: a file of 1 MB half a minute."""
    path = tmp_path / "metrics.json"
    path.write_text(json.dumps({"metrics": {}, "settings": {}, **more}))
    with pytest.raises(InputError, match=r"metrics.json: has [0-9]+ numbers and texts; at most 5000 are read of a run"):
        read_metrics(path)


@pytest.mark.parametrize("times", [np.array(1.0), np.zeros((3, 1)), np.array(["a", "b", "c"]), np.full(3, np.nan)])
def test_a_channel_of_odd_times_is_an_error(times: np.ndarray, tmp_path: Path) -> None:
    """Also of one number, which has no length."""
    np.savez(tmp_path / "log.npz", **{"hand": np.zeros(3), "hand.time": times})
    with pytest.raises(InputError, match=r"log.npz: channel 'hand.time': "):
        read_log(tmp_path / "log.npz")


def test_a_message_that_was_cut_or_goes_on_is_none() -> None:
    data = encode("std_msgs/String", {"data": "a longer text"})
    assert decode("std_msgs/String", data) == {"data": "a longer text"}
    for wrong in (data[:-4], data + bytes(16), data[:8]):
        with pytest.raises(InputError, match=r"bytes are no std_msgs/String"):
            decode("std_msgs/String", wrong)


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("std_msgs/String", {"data": 5}), ("std_msgs/String", {"data": "\ud800"}), ("std_msgs/Float64MultiArray", {"data": 5}),
        ("sensor_msgs/JointState", {"position": ["a"]}), ("sensor_msgs/JointState", {"name": 7}), ("geometry_msgs/Pose", "here"),
    ],
)  # fmt: skip
def test_a_message_of_other_values_is_an_error_with_its_field(kind: str, message: object) -> None:
    with pytest.raises(InputError, match=r"^message: .* cannot be "):
        encode(kind, message, missing={})  # type: ignore[arg-type]


def test_a_limit_takes_no_memory(tmp_path: Path) -> None:
    """Truth: no machine has as much memory as may be read here."""
    (tmp_path / "a").write_bytes(b"magic, and more")
    assert read_file(tmp_path / "a", 2**50, b"magic") == b"magic, and more"
    assert read_file(Path("/proc/self/status"), 2**50).startswith(b"Name:")  # its size is 0


# ---------------------------------------------------------------------- everything
def test_generated_cases_are_accepted_or_rejected_as_their_generators_know(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The short form of ``python benchmarks/fuzz.py``, in this process."""
    import fuzz
    from fuzzing import kinds

    monkeypatch.chdir(tmp_path)
    experiments, tallies = kinds.stand_ins(), {}
    for kind, (share, _) in kinds.KINDS.items():
        tally = tallies[kind] = fuzz.Tally()
        for number in range(share // draws(8, 4) if kind != "problems" else 0):
            case = kinds.make(kind, 17, number, tmp_path)
            tally.count(f"{kind} {number}", *fuzz.outcome(case, experiments), case, 0.0)
    assert [line for t in tallies.values() for line in t.bad] == []
    assert (
        all(t.rejected for kind, t in tallies.items() if kind != "problems")
        and sum(t.accepted for t in tallies.values()) > 20
    )


def test_an_experiment_that_is_not_there_is_exit_code_two() -> None:
    assert main(["run", "fake", "--set", "mpc.rate=010"], REGISTRY) == 2


@pytest.mark.parametrize(
    ("read", "text"),
    [
        (lambda path: configure(FakeSettings, (), "fake", path), "mpc.rate: {long}"),
        (load_definition, "experiments: {{hold: {{}}}}\nseeds: {long}"),
        (load_definition, "experiments: {{hold: {{}}}}\nseeds: 1\nconditions: {many}"),
        (load_description, "name: {long}"),
        (lambda path: list(read_scene(path)), "obstacles: {{a: {{sphere: {{radius: {long}}}}}}}"),
        (lambda path: list(read_scene(path)), "obstacles: {{a: {long}}}"),
    ],
)
def test_a_message_is_shorter_than_what_it_is_about(read: Callable[[Path], object], text: str, tmp_path: Path) -> None:
    """A list of 7000 numbers, or as many keys, filled a terminal."""
    path = tmp_path / "file.yaml"
    path.write_text(text.format(long=[1.5] * 7000, many={f"a{k}": 1 for k in range(3000)}))
    with pytest.raises(InputError) as caught:
        read(path)
    assert len(str(caught.value)) < 1500 + len(str(path))

"""Replays and clips of recordings. Truth: MuJoCo's poses and contacts during the run; files read by imageio; a browser."""

from __future__ import annotations

import base64
import json
import re
import subprocess
import sys
import weakref
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from browser import browser
from filmed import record
from test_live import free_port

from wbmpc import lie, reproduce
from wbmpc.cli import main
from wbmpc.errors import InputError, WbmpcError
from wbmpc.mpc.policy_queue import PolicyQueue
from wbmpc.recording.plots import positions
from wbmpc.recording.reader import Recording, read_recording
from wbmpc.recording.writer import McapFile, stamp
from wbmpc.simulation.lockstep import Ending, Running
from wbmpc.view import render
from wbmpc.view.replay import Film, write_page
from wbmpc.view.snapshot import NUMBERS


class Truth:
    """Notes where the bodies are, straight from the simulator."""

    def __init__(self) -> None:
        self.poses: dict[float, np.ndarray] = {}

    def begin(self, running: Running) -> None:
        self.plant, self.controller = running.plant, running.controller
        # the controller believes that it is elsewhere: what is shown must not
        running.controller.estimator.odometry._state.mean[:3] += [0.3, -0.1, 0.2]

    def tick(self, t: float, command: Any, plans: PolicyQueue) -> None:
        self.plant.truth()
        d = self.plant.data
        self.poses[round(t, 6)] = np.hstack([d.xpos[1:], d.xquat[1:]])

    def end(self, ending: Ending) -> None: ...


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> SimpleNamespace:
    folder, truth = tmp_path_factory.mktemp("run"), Truth()
    mpc = record(folder, truth)
    return SimpleNamespace(
        folder=folder, truth=truth, film=Film(read_recording(folder)), goal=mpc.reference["end_effector"].at(0.0)
    )


def test_bodies_are_where_they_were(run: SimpleNamespace) -> None:
    for t in (0.0, 0.5, 0.98):
        shown, true = run.film.snapshot(t)["poses"], run.truth.poses[round(t, 6)]
        np.testing.assert_allclose(shown[:, :3], true[:, :3], atol=1e-9)
        same = np.abs(np.sum(shown[:, 3:] * true[:, 3:], axis=1))
        np.testing.assert_allclose(same, 1.0, atol=1e-12)
    assert np.linalg.norm(run.film.snapshot(0.98)["poses"] - run.film.snapshot(0.0)["poses"]) > 1e-3
    np.testing.assert_array_equal(run.film.snapshot(0.511)["poses"], run.film.snapshot(0.5)["poses"])


def test_goals_and_plans_are_shown_in_the_world(run: SimpleNamespace) -> None:
    """The goal of the controller's frame lies beside the true end effector by as much as the controller is wrong."""
    s = run.film.snapshot(0.0)
    wrong = np.array([0.3, -0.1, 0.2])
    drift = np.array([*lie.se2_compose([0, 0, 0], [0, 0, -wrong[2]])[:2], 0.0])
    turn = lie.quaternion_to_rotation(lie.quaternion_about((0, 0, 1), -wrong[2]))
    expected = turn @ (run.goal[:3] - [0.3, -0.1, 0.0]) + drift
    np.testing.assert_allclose(s["goal"][:3], expected, atol=2e-3)
    assert np.isfinite(s["end_effector_plan"]).all() and np.isfinite(s["base_plan"]).all()
    assert np.linalg.norm(s["base_plan"][0, :2]) < 0.05  # it starts at the true base


def test_numbers_and_forces(run: SimpleNamespace) -> None:
    s = run.film.snapshot(0.1)  # the robot has not set out yet
    forces = s["forces"][np.isfinite(s["forces"]).all(axis=(1, 2))]
    weight = np.sum(forces[:, 1, 2] - forces[:, 0, 2]) / 0.002
    assert len(forces) == 4 and weight == pytest.approx(run.truth.plant.weight, rel=0.05)
    numbers = dict(zip(NUMBERS, s["numbers"], strict=True))
    taken = s["trail"][np.isfinite(s["trail"]).all(axis=1)]
    times, poses = positions(run.film.recording, "/ground_truth/end_effector")  # type: ignore[misc]
    assert len(taken) == np.sum(times <= 0.1) and np.array_equal(taken[-1], poses[len(taken) - 1])
    assert numbers["t"] == 0.1 and 0.0 < numbers["solve"] < 1.0 and numbers["deadline"] == 0.02


def test_the_trail_of_a_robot_whose_true_poses_nobody_knows_is_the_one_that_it_believes(run: SimpleNamespace) -> None:
    """A bus of a real robot has no true poses, and without a localization no ``map``. Truth: the true ones, which what it believes comes near in
    the world, and the poses that were recorded."""
    recording = read_recording(run.folder)
    times, true = positions(recording, "/ground_truth/end_effector")  # type: ignore[misc]
    believed_at, believed = positions(recording, "/end_effector_pose")  # type: ignore[misc]
    del recording.topics["/ground_truth/end_effector"]
    film = Film(recording)
    trail = lambda: film._taken(0.9)
    np.testing.assert_allclose(trail()[-1], true[times <= 0.9][-1], atol=5e-3)
    assert np.linalg.norm(trail()[-1] - believed[believed_at <= 0.9][-1]) > 0.1
    for frames in (film._static, *film._frames):
        frames.pop("odom", None)
    film._trail = film._estimated_trail()
    np.testing.assert_array_equal(trail(), believed[believed_at <= 0.9])
    assert np.isfinite(film.snapshot(0.9)["poses"]).all()


def test_recordings_without_pictures_are_rejected(tmp_path: Path) -> None:
    file = McapFile(tmp_path / "run.mcap")
    file.put("/mode", "std_msgs/String", 0.0, {"data": "H"})
    file.close()
    with pytest.raises(InputError, match=r"it has no scene .* and no frames \(/tf\)"):
        Film(read_recording(tmp_path))


# ---------------------------------------------------------------------- pages
def test_times_that_go_back_or_on_for_years_are_one_message(run: SimpleNamespace, tmp_path: Path) -> None:
    """Any program may have written the stamps: no page of no pictures, none of billions."""
    recording = read_recording(run.folder)
    recording["/tf"].times.reverse()
    with pytest.raises(InputError, match=r"the times of its frames \(/tf\) go back"):
        Film(recording)
    years: Any = SimpleNamespace(times=np.array([0.0, 4e9]), recording=recording)
    with pytest.raises(InputError, match=r"has 4e\+09 s; a page is of at most 7200 s"):
        write_page(years, tmp_path / "page.html")
    film = Film(read_recording(run.folder))
    film.times = np.array([*film.times[:-1], 4e9])
    with pytest.raises(InputError, match=r"has 4e\+09 s; a clip is of at most 7200 s"):
        render.render(film, tmp_path / "clip.gif", (0.0, np.inf), (64, 48))


def test_a_gap_of_hours_in_a_film_is_one_pause(run: SimpleNamespace) -> None:
    """A clock that is set forward during a run: as many pictures as without it, no matter how many would fit into the gap."""
    usual = len(run.film.motion().parts[0].times)
    recording = read_recording(run.folder)
    for topic in recording.topics.values():
        topic.times = [t + 7100.0 * (t > 0.5) for t in topic.times]
    times = Film(recording).motion().parts[0].times
    assert abs(len(times) - usual) <= 1 and times[-1] > 7100.0


@pytest.mark.parametrize(("kind", "labels"), [(".gif", True), (".gif", False), (".webp", True)])
def test_a_gap_of_hours_in_a_clip_is_one_pause(run: SimpleNamespace, kind: str, labels: bool, tmp_path: Path) -> None:
    """As many pictures as without the gap, which a GIF can hold ten minutes of."""
    image = pytest.importorskip("PIL.Image")
    draw = lambda recording, name: render.render(
        Film(recording), tmp_path / f"{name}{kind}", (0.0, np.inf), (64, 48), labels=labels
    )
    usual = draw(read_recording(run.folder), "usual")
    recording = read_recording(run.folder)
    for topic in recording.topics.values():
        topic.times = [t + 7100.0 * (t > 0.5) for t in topic.times]
    assert abs(draw(recording, "gap") - usual) <= 1
    with image.open(tmp_path / f"gap{kind}") as clip:
        shown = []
        for k in range(clip.n_frames):
            clip.seek(k)
            clip.load()
            shown.append(clip.info["duration"])
    assert max(shown) == pytest.approx(600e3, rel=0.01) and sorted(shown)[-2] < 1e3


def test_a_film_draws_no_picture_twice(run: SimpleNamespace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It goes on at its rate through a gap, with the picture that it has; the time on it goes on too."""
    pytest.importorskip("PIL.Image")
    recording, drawn, written = read_recording(run.folder), [], []
    for topic in recording.topics.values():
        topic.times = [t + 20.0 * (t > 0.5) for t in topic.times]
    frame = render.Renderer.frame
    monkeypatch.setattr(render.Renderer, "frame", lambda *given: drawn.append(1) or frame(*given))
    monkeypatch.setitem(render._WRITERS, ".mp4", lambda path, pictures, _: (written.extend(pictures), path.touch()))
    pytest.importorskip("imageio_ffmpeg")
    count = render.render(Film(recording), tmp_path / "a.mp4", (0.0, np.inf), (640, 64))
    assert count == len(written) > 500 > 5 * len(drawn)
    assert len({picture.tobytes() for picture in written}) > 200  # 0.1 s each


def test_a_clip_reads_nothing_that_it_does_not_show(
    run: SimpleNamespace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Contact forces and joint speeds took a fifth of its time."""
    pytest.importorskip("PIL.Image")
    read, table = [], Recording.table
    monkeypatch.setattr(Recording, "table", lambda recording, name: read.append(name) or table(recording, name))
    render.render(Film(read_recording(run.folder)), tmp_path / "a.gif", (0.0, 0.2), (64, 48))
    assert read and not [name for name in read if name not in ("/end_effector_reference", "/ground_truth/end_effector")]


def test_a_clip_that_would_fill_the_memory_is_one_message(run: SimpleNamespace, tmp_path: Path) -> None:
    film = Film(read_recording(run.folder))
    film.times = np.arange(0.0, 7200.0, 0.02)
    with pytest.raises(InputError, match=r"long\.gif' need 46\.7 GB, at most 2 are taken; valid: --mp4"):
        render.render(film, tmp_path / "long.gif", (0.0, np.inf), (960, 540))
    assert not (tmp_path / "long.gif").exists()


def test_a_film_may_begin_at_any_time(run: SimpleNamespace, tmp_path: Path) -> None:
    """As a part of a long run, or stamps of a calendar: bar and page begin where the film does, at a time so large that a nanosecond
    more is the same number."""
    pytest.importorskip("viser")
    from wbmpc.view.access import Access
    from wbmpc.view.replay import Player

    late = 1.8e10
    recording = read_recording(run.folder)
    for topic in recording.topics.values():
        topic.times = [t + late for t in topic.times]
    film = Film(recording)
    with pytest.raises(InputError, match=r"the recording has 1\.8e\+10"):  # not a picture of another moment
        render.render(film, tmp_path / "a.png", (10.0, np.inf), (64, 48))
    player = Player(film, Access.of("127.0.0.1"), free_port())
    try:
        assert player._time.value == player._time.min == film.times[0] and player._time.max == film.times[-1]
    finally:
        player.server.stop()
    write_page(film, tmp_path / "page.html")
    (part,) = pictures(tmp_path / "page.html")
    times = np.frombuffer(base64.b64decode(part["times"]))
    np.testing.assert_allclose(times - late, run.film.motion().parts[0].times, atol=1e-5)


def pictures(page: Path) -> list[dict[str, Any]]:
    """What a page plays: its parts."""
    found = re.search(r'<script type="application/json" class="data">(.*?)</script>', page.read_text(), re.DOTALL)
    assert found
    parts: list[dict[str, Any]] = json.loads(found[1])
    return parts


@pytest.fixture(scope="module")
def page(run: SimpleNamespace) -> Path:
    path = run.folder / "replay.html"
    with pytest.MonkeyPatch.context() as patch:  # a page needs no server
        patch.setitem(sys.modules, "viser", None)
        assert main(["replay", str(run.folder), "--html", str(path)]) == 0
    return path


def test_the_page_plays_the_film(run: SimpleNamespace, page: Path) -> None:
    """Truth: MuJoCo's poses; where the end effector was, in the recording; ten pictures a second."""
    (part,) = pictures(page)
    times, full = np.frombuffer(base64.b64decode(part["times"])), part["full"]
    np.testing.assert_allclose(np.diff(times), 0.1, atol=0.021)
    number = lambda key: np.frombuffer(base64.b64decode(part[key]), "<i2")
    bodies = number("poses").reshape(len(times), -1, 7) / full
    for k in (0, len(times) // 2):
        true = run.truth.poses[round(float(times[k]), 6)][part["moving"], :3]
        np.testing.assert_allclose(part["middle"] + part["half"] * bodies[k, :, :3], true, atol=1e-3)
    points = part["middle"] + part["half"] * number("points").reshape(len(times), -1, 3) / full
    taken = run.film.snapshot(times[-1])["trail"]
    np.testing.assert_allclose(points[-1, 0], taken[np.isfinite(taken).all(axis=1)][-1], atol=1e-3)
    np.testing.assert_allclose(points[0, 1], run.film.snapshot(0.0)["goal"][:3], atol=1e-3)


def test_plots_of_the_page_go_with_its_time(page: Path) -> None:
    """In a browser without a network: the replay goes to the time of a click on a plot, and all show it."""
    with browser() as tab:
        tab.page.context.set_offline(True)
        tab.page.goto(page.as_uri())
        titles = tab.page.locator(".plots h3").all_text_contents()
        assert {"End effector error, estimated frame", "Solve times", "Vertical contact forces"} <= set(titles)
        assert {"Joint speeds: arm", "Joint speeds: wheel"} <= set(titles)  # 17 lines, and colors for eight
        tab.page.evaluate(
            "document.querySelectorAll('.js-plotly-plot')[1].emit('plotly_click', {xvals: [0.5], points: []})"
        )
        assert tab.page.locator(".replay output").text_content().startswith("0.5 s of")
        assert tab.page.locator(".cursor:not([hidden])").count() == len(titles) - 1  # all but the path
        assert tab.errors == [] and tab.outside == []


def test_replay_needs_viser(run: SimpleNamespace, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert main(["replay", str(run.folder)]) == 2
    assert capsys.readouterr().err == "wbmpc: replay: this needs viser: pip install 'wbmpc[viz]'\n"


def test_the_player_shows_moments(run: SimpleNamespace, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("viser")
    from wbmpc.view.access import Access
    from wbmpc.view.replay import Player

    monkeypatch.setattr(
        Recording, "title", "<script>steer()</script>"
    )  # of a file that somebody sent: no script of the page
    player = Player(run.film, Access.of("127.0.0.1"), free_port())
    try:
        assert "<script>" not in player._text.content.replace("\\<", "")
        for t in (0.0, 0.98):
            player.show(t)
            assert "<script>" not in player._text.content.replace("\\<", "")
            shown = [h.position for h in player.stage._bodies]
            np.testing.assert_allclose(shown, run.truth.poses[t][:, :3], atol=1e-6)
        assert "0.98 s" in player._text.content
    finally:
        player.server.stop()


def test_what_a_replay_does_not_do_stays_on_its_page(run: SimpleNamespace) -> None:
    """Each picture wrote over it: it was there for a thirtieth of a second, or not at all."""
    pytest.importorskip("viser")
    from hostile import Client

    from wbmpc.view.access import Access
    from wbmpc.view.rejection import SHOWN, Rejection
    from wbmpc.view.replay import Player

    player = Player(run.film, Access.of("127.0.0.1"), free_port())
    try:
        page = Client(player.url)
        page.set("Speed", float("nan"))
        assert page.alive  # the server has taken it in
        for t in (0.0, 0.3, 0.6):
            player.show(t)
        assert page.hears("0.60 s")
        assert "**Not done:** Speed: must be 0.1 to 4, got nan" in page.history[-1]
    finally:
        player.server.stop()
    now = 0.0
    rejection = Rejection(lambda: now)
    assert rejection.text == ""
    rejection.show("a [link](x)")
    now = SHOWN - 0.1
    assert rejection.text == "  \n**Not done:** a \\[link\\]\\(x\\)"
    now = SHOWN
    assert rejection.text == ""


def test_a_browser_begins_with_a_camera_that_looks_at_the_robot(run: SimpleNamespace) -> None:
    """Before one has come: it takes the camera that there is then."""
    pytest.importorskip("viser")
    from wbmpc.view import replay
    from wbmpc.view.access import Access
    from wbmpc.view.camera import camera_offset

    player = replay.Player(run.film, Access.of("127.0.0.1"), free_port())
    try:
        poses, camera = run.film.snapshot(float(run.film.times[0]))["poses"], player.server.initial_camera
        robot = poses[run.film.scene.index, :3]
        np.testing.assert_allclose(camera.look_at, robot, atol=1e-6)
        np.testing.assert_allclose(np.array(camera.position) - robot, camera_offset(poses, run.film.scene), atol=1e-6)
    finally:
        player.server.stop()


def test_without_a_browser_a_replay_does_not_move(run: SimpleNamespace, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is drawn until somebody looks; then pictures follow each other. Clock and browsers are this test's."""
    pytest.importorskip("viser")
    from wbmpc.view import replay
    from wbmpc.view.access import Access

    player, waits, shown = replay.Player(run.film, Access.of("127.0.0.1"), free_port()), [], []

    def sleep(seconds: float) -> None:
        waits.append((seconds, len(shown)))
        if len(waits) == 20:
            raise KeyboardInterrupt

    monkeypatch.setattr(replay, "time", SimpleNamespace(sleep=sleep))
    monkeypatch.setattr(player, "show", shown.append)
    monkeypatch.setattr(player.server, "get_clients", lambda: {0: None} if len(waits) >= 10 else {})
    try:
        with pytest.raises(KeyboardInterrupt):
            player.run()
    finally:
        player.server.stop()
    assert all(seconds >= 0.2 and count == 0 for seconds, count in waits[:10])
    assert len(shown) == 10 and all(later > earlier for earlier, later in pairwise(shown))


# ---------------------------------------------------------------------- clips
def graphics(run: SimpleNamespace) -> None:
    try:
        next(render._pictures(run.film, np.array([0.0]), (64, 48)))
    except WbmpcError as error:
        pytest.skip(str(error))


# imageio's readers leave their pipes to the garbage collector
@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
def test_clips(run: SimpleNamespace, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    imageio = pytest.importorskip("imageio.v3")
    from PIL import Image

    graphics(run)
    size = ["--width", "160", "--height", "90"]
    files = [tmp_path / f"a.{kind}" for kind in ("png", "gif", "mp4", "webp")]
    options = [f"--{f.suffix[1:]}" for f in files]
    named = [text for pair in zip(options, map(str, files), strict=True) for text in pair]
    assert main(["render", str(run.folder), *named, "--start", "0.5", *size]) == 0
    assert "a.png: 1 picture\n" in capsys.readouterr().out
    still = imageio.imread(files[0])
    assert still.shape[:2] == (90, 160) and len(np.unique(still.reshape(-1, still.shape[2]), axis=0)) > 50
    for moving in files[1], files[3]:
        with Image.open(moving) as clip:
            assert clip.n_frames == 6 + 1  # 0.48 s at 12.5 Hz; both ends
    film = imageio.imread(files[2])
    assert len(film) == 13 and film.shape[1:3] == (90, 160)
    drawn = next(render._pictures(run.film, np.array([0.5]), (160, 90), True, ".mp4")).astype(int)
    assert np.abs(film[0].astype(int) - drawn).mean() < 6.0  # the same moment, compressed
    assert (
        np.abs(drawn - still[..., :3].astype(int)).mean() < 16.0
    )  # the light is a little weaker with shadows on the floor alone


def test_a_clip_shows_motion(run: SimpleNamespace) -> None:
    graphics(run)
    pictures = [p.astype(int) for p in render._pictures(run.film, np.array([0.0, 0.0, 0.98]), (160, 90))]
    np.testing.assert_array_equal(pictures[0], pictures[1])
    assert np.abs(pictures[2] - pictures[0]).max() > 20


def near_color(picture: np.ndarray, color: tuple[int, int, int]) -> int:
    """How many pixels are about of a color."""
    return int((np.abs(picture.astype(int) - color).max(axis=2) < 12).sum())


def test_labels_say_what_lines_are_at_the_edges_of_a_clip(run: SimpleNamespace) -> None:
    pytest.importorskip("PIL")
    graphics(run)
    drawn = {on: next(render._pictures(run.film, np.array([0.5]), (320, 180), on)) for on in (True, False)}
    snapshot = run.film.snapshot(0.5)
    there = [name for name in render.LINES if np.isfinite(snapshot[name]).all(axis=1).sum() > 1]
    assert "reference" in there
    differs = np.any(drawn[True] != drawn[False], axis=2)
    assert differs[:20].any() and differs[-20:].any() and not differs[20:-20].any()  # labels, at the edges alone
    assert all(
        near_color(drawn[True][:20], render.LINES[name]) > near_color(drawn[False][:20], render.LINES[name])
        for name in there
    )


BAD = {
    (): "what to write is missing; valid: --mp4 FILE, --gif FILE, --webp FILE, --png FILE",
    ("--mp4", "a.avi"): "--mp4: 'a.avi' must end in .mp4",
    ("--png", "a.png", "--start", "9"): "there is nothing to draw",
    ("--gif", "a.gif", "--speed", "1e-9"): "the speed must be 0.01 to 1000, got 1e-09",
    ("--mp4", "a.mp4", "--width", "321"): "width and height must be even (its codec halves them), got 321 and 540",
}


@pytest.mark.parametrize("arguments", BAD)
def test_bad_input(run: SimpleNamespace, arguments: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["render", str(run.folder), *arguments]) == 2
    err = capsys.readouterr().err
    assert BAD[arguments] in err and err.count("\n") == 1


def test_without_graphics_there_is_one_message_that_names_packages(
    run: SimpleNamespace, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def nothing(*_: object, **__: object) -> None:
        raise WbmpcError("no picture: OpenGL does not start")

    pytest.importorskip("imageio")
    monkeypatch.setattr(render, "Renderer", nothing)
    assert main(["render", str(run.folder), "--png", str(tmp_path / "a.png")]) == 2
    err = capsys.readouterr().err
    assert "neither EGL nor OSMesa starts" in err and "libegl1" in err and "libosmesa6" in err and err.count("\n") == 1
    assert not (tmp_path / "a.png").exists()


def test_recordings_are_read_without_viser() -> None:
    """`wbmpc log` and `wbmpc render` work without the extra ``viz``."""
    code = "import sys; sys.modules['viser'] = None; import wbmpc.view.replay, wbmpc.view.render, wbmpc.view.live"
    assert subprocess.run([sys.executable, "-c", code], timeout=60).returncode == 0


def test_a_site_has_its_clip(run: SimpleNamespace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Drawn once, from the first run that is finished; without graphics the page says why there is none."""
    pytest.importorskip("imageio_ffmpeg")
    (job,) = reproduce.plan(["toy"], [1], tmp_path)
    job.directory.mkdir(parents=True)
    (job.directory / "run.mcap").write_bytes((run.folder / "run.mcap").read_bytes())
    job.mark.touch()
    with monkeypatch.context() as broken:
        broken.setattr(render, "Renderer", lambda *_, **__: (_ for _ in ()).throw(WbmpcError("none")))
        assert "There is no clip: render: neither EGL nor OSMesa" in reproduce._clip([job], "toy", tmp_path, True)
    graphics(run)
    monkeypatch.setattr(reproduce, "CLIP_SIZE", (64, 48))
    assert 'src="clip.mp4"' in reproduce._clip([job], "toy", tmp_path, True)
    drawn = (tmp_path / "toy" / "clip.mp4").stat()
    assert drawn.st_size > 500
    reproduce._clip([job], "toy", tmp_path, True)
    assert (tmp_path / "toy" / "clip.mp4").stat().st_mtime_ns == drawn.st_mtime_ns


@pytest.mark.parametrize("value", [1e300, np.nan])
def test_frames_that_are_nowhere_are_rejected(tmp_path: Path, value: float) -> None:
    """A camera has nothing to look at; it was a traceback of NumPy."""
    path = tmp_path / "run.mcap"
    file = McapFile(path)
    file.attach("scene.json", {"robot": "b", "bodies": [{"name": "b", "parent": "world", "moves": True}], "shapes": []})
    transform = {
        "header": {"stamp": stamp(0.0), "frame_id": "map"},
        "child_frame_id": "b",
        "transform": np.full(7, value),
    }
    file.put("/tf", "tf2_msgs/TFMessage", 0.0, {"transforms": [transform]})
    file.close()
    with pytest.raises(InputError, match="are not finite at first, or farther away than 1e\\+06 m"):
        Film(read_recording(path))


def test_a_film_is_encoded_while_it_is_drawn(run: SimpleNamespace, tmp_path: Path) -> None:
    """A film of minutes does not fit into the memory; what drawing raises stays what it is."""
    pytest.importorskip("imageio_ffmpeg")
    made: list[weakref.ref[np.ndarray]] = []

    def drawn() -> Iterator[np.ndarray]:
        for k in range(40):
            assert sum(ref() is not None for ref in made) <= 2
            picture = np.full((48, 64, 3), k, np.uint8)
            made.append(weakref.ref(picture))
            yield picture
        raise InputError("no frame")

    with pytest.raises(InputError, match="no frame"):
        render._write_mp4(tmp_path / "a.mp4", drawn(), [])
    assert len(made) == 40

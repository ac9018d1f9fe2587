"""The world of obstacles. Truth: kinematics of a constant velocity; what its docstrings promise."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
import pytest

import wbmpc as wb
from wbmpc.errors import InputError
from wbmpc.obstacles.scene import read_scene

BALL = wb.shapes.Sphere(0.2)


def test_a_moving_obstacle_is_predicted_from_when_it_was_seen() -> None:
    world = wb.Obstacles()
    world.set("person", BALL, position=(1, 2, 0), velocity=(0.5, 0, 0), std=0.03, velocity_std=0.1, seen=4.0)
    snapshot = world.snapshot(4.2)
    (person,) = snapshot.obstacles
    places, turn = snapshot.pose(person, np.array([3.0, 4.0, 6.0]))
    np.testing.assert_allclose(places, [[1, 2, 0], [1, 2, 0], [2, 2, 0]])
    np.testing.assert_allclose(turn, np.eye(3))
    np.testing.assert_allclose(person.spread(np.array([4.0, 6.0])), [0.03, np.hypot(0.03, 0.2)])


def test_without_a_time_it_is_seen_when_the_next_solve_begins() -> None:
    world = wb.Obstacles()
    world.set("person", BALL, velocity=(1, 0, 0))
    world.snapshot(7.0)
    snapshot = world.snapshot(9.0)
    assert snapshot.pose(snapshot.obstacles[0], np.array([9.0]))[0][0, 0] == pytest.approx(2.0)


@pytest.mark.parametrize("t", [np.nan, np.inf, "1", None, True])
def test_a_moment_that_is_none_is_an_error_and_drops_nothing(t: object) -> None:
    world = wb.Obstacles()
    world.set("ball", BALL)
    with pytest.raises(InputError, match="obstacles: the time"):
        world.snapshot(t)  # type: ignore[arg-type]
    assert np.isnan(world._obstacles["ball"].seen)
    assert [] not in world and 3 not in world and "ball" in world


def test_a_frame_moves_all_that_is_given_in_it() -> None:
    world = wb.Obstacles()
    world.set_frame("map", (1, 0, 0), (np.sqrt(0.5), 0, 0, np.sqrt(0.5)))  # turned by 90° about z
    world.set("box", wb.shapes.Box((0.1, 0.2, 0.3)), position=(2, 0, 0), velocity=(1, 0, 0), frame="map", seen=0.0)
    snapshot = world.snapshot(0.0)
    places, turn = snapshot.pose(snapshot.obstacles[0], np.array([0.0, 1.0]))
    np.testing.assert_allclose(places, [[1, 2, 0], [1, 3, 0]], atol=1e-12)
    np.testing.assert_allclose(turn @ [1, 0, 0], [0, 1, 0], atol=1e-12)
    world.set_frame("map", (5, 0, 0))
    assert world.snapshot(0.0).pose(snapshot.obstacles[0], np.zeros(1))[0][0] == pytest.approx([7, 0, 0])


def test_what_expires_is_gone_and_what_moves_stays() -> None:
    world = wb.Obstacles()
    world.set("old", BALL, seen=1.0, expire=0.5)
    world.set("new", BALL)
    assert len(world.snapshot(1.5).obstacles) == 2 and "old" in world
    assert [o.name for o in world.snapshot(1.6).obstacles] == ["new"] and world.names == ("new",)
    world.move("new", (3, 0, 0))
    assert world.snapshot(2.0).obstacles[0].position == pytest.approx([3, 0, 0])
    world.remove("new")
    assert len(world) == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"position": (0, 0)}, ("'p'", "position")),
        ({"position": (0, 0, np.nan)}, ("'p'", "position")),
        ({"velocity": (0, np.inf, 0)}, ("'p'", "velocity")),
        ({"orientation": (2, 0, 0, 0)}, ("'p'", "orientation", "unit quaternion")),
        ({"std": -1.0}, ("'p'", "std")),
        ({"expire": 1.0}, ("'p'", "expire", "seen")),
        ({"expire": 0.0, "seen": 1.0}, ("'p'", "expire")),
        ({"frame": "map"}, ("'p'", "frame 'map'", "world")),
    ],
)
def test_a_wrong_argument_names_the_obstacle_and_changes_nothing(arguments, words) -> None:  # type: ignore[no-untyped-def]
    world = wb.Obstacles()
    world.set("p", BALL, position=(1, 1, 1))
    with pytest.raises(InputError) as error:
        world.set("p", BALL, **arguments)
    assert all(word in str(error.value) for word in words)
    assert world.snapshot(0.0).obstacles[0].position == pytest.approx([1, 1, 1])


def test_unknown_names_and_things_that_are_no_shapes() -> None:
    world = wb.Obstacles()
    with pytest.raises(InputError, match="shape is needed, got float"):
        world.set("p", 0.3)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="unknown obstacle 'q'"):
        world.remove("q")
    with pytest.raises(InputError, match="unknown obstacle 'q'"):
        world.move("q", (0, 0, 0))
    for wrong in ("chassis", [1], 3):
        with pytest.raises(InputError, match="'ignore' needs a list of names of frames"):
            world.set("p", wb.shapes.Sphere(0.3), ignore=wrong)  # type: ignore[arg-type]


def test_threads_set_and_remove_while_another_takes_snapshots() -> None:
    world, wrong = wb.Obstacles(), []

    def churn(k: int) -> None:
        try:
            for i in range(150):
                world.set(f"o{k}", BALL, position=(i, i, i))
                if i % 3 == 0:
                    world.remove(f"o{k}")
        except Exception as error:
            wrong.append(error)

    threads = [threading.Thread(target=churn, args=(k,)) for k in range(4)]
    for thread in threads:
        thread.start()
    for t in range(100):
        for o in world.snapshot(float(t)).obstacles:
            assert o.position[0] == o.position[1] == o.position[2]
    for thread in threads:
        thread.join()
    assert not wrong and len(world) == 4


def test_a_scene_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(
        "obstacles:\n"
        "  pillar: {cylinder: {a: [2, 0, 0], b: [2, 0, 1.5], radius: 0.1}}\n"
        "  shelf: {box: {half: [0.3, 0.2, 0.02]}, position: [1, 1, 0.8], std: 0.01}\n"
        "  floor: {half_space: {normal: [0, 0, 1]}}\n"
    )
    world = wb.Obstacles()
    world.load(path)
    assert world.names == ("floor", "pillar", "shelf")
    assert [o.std for o in world.snapshot(0.0).obstacles] == [0.0, 0.0, 0.01]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("pillar: {sphere: {radius: 1}}", ("'obstacles'",)),
        ("obstacles: {p: {sphere: {radius: 1}, color: red}}", ("obstacles.p", "unknown key 'color'")),
        ("obstacles: {p: {sphere: {radius: -1}}}", ("obstacles.p.sphere", "radius", "positive")),
        ("obstacles: {p: {sphere: {}}}", ("obstacles.p.sphere", "'radius' is missing")),
        ("obstacles: {p: {sphere: {radius: 1, size: 2}}}", ("obstacles.p.sphere", "unknown key 'size'")),
        ("obstacles: {p: {position: [0, 0, 0]}}", ("obstacles.p", "one shape is needed, got 0")),
        ("obstacles: {p: {sphere: {radius: 1}, position: [0, 0]}}", ("obstacles.p", "'p'", "position")),
        ("obstacles: {p: {sphere: {radius: 1}, position: [0, yes, 0]}}", ("obstacles.p", "not true or false")),
        ("obstacles: {p: {sphere: {radius: 1, center: [0, 0, no]}}}", ("obstacles.p", "not true or false")),
        ("obstacles: {p: {box: {half: [1, 1, 1], orientation: [1e300, 0, 0, 0]}}}", ("obstacles.p.box", "at most 2")),
        ("obstacles: {p: 3}", ("obstacles.p", "mapping")),
        ("obstacles: {q: {sphere: {radius: 1}}, p: {box: {half: x}}}", ("obstacles.p.box", "half")),
    ],
)
def test_a_scene_with_a_mistake_names_file_and_key_and_sets_nothing(tmp_path: Path, text: str, words) -> None:  # type: ignore[no-untyped-def]
    path, world = tmp_path / "scene.yaml", wb.Obstacles()
    path.write_text(text)
    with pytest.raises(InputError) as error:
        world.load(path)
    assert str(path) in str(error.value) and all(word in str(error.value) for word in words)
    assert len(world) == 0


@pytest.mark.parametrize("appears", ["-1", "1e300", "yes", ".nan"])
def test_obstacles_appear_at_a_time_of_the_run(tmp_path: Path, appears: str) -> None:
    (tmp_path / "scene.yaml").write_text(f"obstacles: {{p: {{sphere: {{radius: 1}}, appears: {appears}}}}}")
    with pytest.raises(InputError, match=r"scene\.yaml: key 'obstacles\.p'"):
        list(read_scene(tmp_path / "scene.yaml", simulated=True))


def test_a_missing_scene_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no such file"):
        list(read_scene(tmp_path / "none.yaml"))


@pytest.mark.parametrize(
    "arguments",
    [
        {"position": [1e308, 0.0, 0.0]}, {"velocity": [0.0, 1e150, 0.0]}, {"std": 1e308}, {"velocity_std": 1e308}, {"seen": 1e308},
        {"position": [10**400, 0, 0]}, {"expire": "long"}, {"expire": None}, {"frame": []}, {"frame": None}, {"frame": 3},
    ],
)  # fmt: skip
def test_what_no_robot_meets_is_rejected(arguments) -> None:  # type: ignore[no-untyped-def]
    world = wb.Obstacles()
    with pytest.raises(InputError, match="obstacle 'a'"):
        world.set("a", wb.shapes.Sphere(0.1), **arguments)
    assert len(world) == 0


@pytest.mark.parametrize(
    "make",
    [
        lambda: wb.shapes.Sphere(1e308), lambda: wb.shapes.Sphere(1e-320), lambda: wb.shapes.Sphere(0.1, [1e200, 0, 0]),
        lambda: wb.shapes.Box([1e308] * 3), lambda: wb.shapes.Box([1e-200] * 3), lambda: wb.shapes.HalfSpace([0, 0, 1], 1e308),
        lambda: wb.shapes.HalfSpace([1e200] * 3), lambda: wb.shapes.Capsule([0] * 3, [1e200] * 3, 1.0),
        lambda: wb.shapes.Cylinder([0] * 3, [1e200] * 3, 1.0), lambda: wb.shapes.ConvexMesh(1e-200 * np.eye(4, 3)),
    ],
)  # fmt: skip
def test_shapes_of_no_size_or_beyond_all_are_rejected(make) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(InputError):
        make()


@pytest.mark.parametrize("name", [None, 3, [], ""])
def test_a_name_is_a_text(name) -> None:  # type: ignore[no-untyped-def]
    world = wb.Obstacles()
    for call in (world.remove, lambda n: world.move(n, [0.0, 0.0, 0.0])):
        with pytest.raises(InputError, match="a name is needed"):
            call(name)


def test_names_of_a_scene_that_become_the_same_are_an_error(tmp_path: Path) -> None:
    path, world = tmp_path / "scene.yaml", wb.Obstacles()
    path.write_text('obstacles: {1: {sphere: {radius: 0.1}}, "1": {sphere: {radius: 0.2}}}')
    with pytest.raises(InputError, match="appears twice"):
        world.load(path)


def test_a_scene_for_which_there_is_no_room_sets_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("wbmpc.obstacles.world.MAX_OBSTACLES", 2)
    path, world = tmp_path / "scene.yaml", wb.Obstacles()
    world.set("own", wb.shapes.Sphere(0.1))
    path.write_text("obstacles: {a: {sphere: {radius: 0.1}}, b: {sphere: {radius: 0.2}}}")
    with pytest.raises(InputError, match="at most so many"):
        world.load(path)
    assert world.names == ("own",)


def test_what_is_moved_while_another_thread_removes_it_does_not_come_back(monkeypatch: pytest.MonkeyPatch) -> None:
    world = wb.Obstacles()
    world.set("a", wb.shapes.Sphere(0.1))
    put, other = world.set, threading.Thread(target=lambda: world.remove("a"))

    def between(*arguments, **keys):  # type: ignore[no-untyped-def]
        other.start()
        other.join(0.2)
        put(*arguments, **keys)

    monkeypatch.setattr(world, "set", between)
    world.move("a", [1.0, 0.0, 0.0])
    other.join()
    assert "a" not in world

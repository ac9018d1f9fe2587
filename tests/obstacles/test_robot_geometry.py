"""Shapes of robots. Truth: MuJoCo's own kinematics and contacts of the robot's file."""

from __future__ import annotations

import re
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import mujoco
import numpy as np
import pytest

from clearing import TrueDistance, write_arm
from wbmpc.clearance.rows import SelfRows
from wbmpc.cli import main
from wbmpc.errors import InputError
from wbmpc.model.robot import RobotModel, load_robot
from wbmpc.obstacles import pairs
from wbmpc.obstacles.geometry import RobotGeometry, _cover, robot_geometry
from wbmpc.obstacles.pairs import (
    diagnose,
    distances,
    draw_states,
    list_pairs,
    own_margins,
    propose_pairs,
    self_pairs,
    unlisted,
)
from wbmpc.obstacles.solids import Solid
from wbmpc.ocp.clearance_residuals import SELF_WIDTH, SelfClearance
from wbmpc.ocp.scaling import telescopes


@contextmanager
def limited_memory(more: int) -> Iterator[None]:
    """So many bytes more than the process has now."""
    before = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + more, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


ROBOTS = ("differential-ur10", "rezero", "swerve-ur10")


def lowest(geometry: RobotGeometry, x: np.ndarray, direction: np.ndarray) -> float:
    """How far the robot reaches against a direction."""
    positions, rotations = geometry.kinematics(x[None])
    centers, axes = geometry.at(positions, rotations)
    ends = [c - a @ s.solid.support((direction @ a)[None])[0] for c, a, s in zip(centers[0], axes[0], geometry.shapes)]
    return float(min(e @ direction for e in ends))


@pytest.mark.parametrize("name", ROBOTS)
def test_shapes_are_where_the_file_has_them(name: str) -> None:
    """Truth: distances of MuJoCo's geoms to a wall, from six sides."""
    robot = load_robot(name)
    geometry = robot_geometry(robot)
    truth = TrueDistance(robot, [(mujoco.mjtGeom.mjGEOM_SPHERE, [0.01])])
    x = robot.home.copy()
    rng = np.random.default_rng(0)
    arm = robot.state["arm"]
    x[arm] += rng.uniform(-0.5, 0.5, x[arm].size)
    for direction in np.concatenate([np.eye(3), -np.eye(3)]):
        # a far ball in that direction sees the extreme point, but for the robot's width over its distance
        far = 1.5 * direction + robot.pose(x, robot.description.base.body)[0] * (1.0 - np.abs(direction))
        found = truth(x, [far])
        if found < 1.99:
            assert lowest(geometry, x, -direction) <= -(far @ direction - found - 0.01) + 1e-6


def test_a_spinning_wheel_is_what_it_sweeps_on_the_body_that_carries_it() -> None:
    """Truth: the radius in the robot file."""
    geometry = robot_geometry(load_robot("swerve-ur10"))
    assert not [f for f in geometry.frames if f.startswith("wheel")]
    (wheel,) = [s for s in geometry.shapes if s.frame == "steer_LF" and s.solid.kind == "cylinder"]
    assert wheel.solid.size[0] == pytest.approx(0.10, abs=1e-5) and wheel.solid.position[2] == pytest.approx(-0.2746)


def test_a_part_that_rolls_is_a_ball_on_the_base() -> None:
    robot = load_robot("rezero")
    geometry = robot_geometry(robot)
    assert lowest(geometry, robot.home, np.array([0, 0, 1.0])) == pytest.approx(-0.1255, abs=1e-3)  # the ball's radius


@pytest.mark.parametrize("kind", ["capsule", "cylinder", "box", "ellipsoid"])
def test_balls_cover_a_solid(kind: str) -> None:
    """Truth: random points of the surface, on rays from the center."""
    rng = np.random.default_rng(0)
    solid = Solid(kind, np.array([0.1, 0.25, 0.15]), np.array([0.3, 0.0, -0.1]))
    d = rng.normal(size=(4000, 3))
    low, high = np.zeros((4000, 1)), 2.0 / np.linalg.norm(d, axis=1)[:, None]
    for _ in range(50):  # bisection
        middle = 0.5 * (low + high)
        inside = solid.distance(middle * d)[:, None] < 0.0
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    points = solid.position + low * d
    points = np.concatenate([points, solid.position + solid.support(d / np.linalg.norm(d, axis=1)[:, None])])
    gaps = np.min([np.linalg.norm(points - c, axis=1) - r for c, r in _cover(solid)], axis=0)
    assert gaps.max() < 1e-9


def test_shapes_by_hand(tmp_path: Path) -> None:
    section = """collision:
  shapes:
    - {frame: tip, kind: sphere, radius: 0.05}
    - {frame: upper, kind: capsule, radius: 0.05, a: [0, 0, 0], b: [0.4, 0, 0]}
    - {frame: foot, kind: box, half: [0.1, 0.1, 0.1], center: [0, 0, 0.1]}
  margin: 0.04
  self: {margin: 0.01, pairs: [[foot, tip]]}
"""
    robot = load_robot(write_arm(tmp_path, section))
    geometry = robot_geometry(robot)
    assert geometry.frames == ("tip", "upper", "foot") and robot.description.collision.margin == 0.04
    assert self_pairs(robot) == (("foot", "tip"),)


@pytest.mark.parametrize(
    ("section", "words"),
    [
        (
            "collision: {shapes: [{frame: nose, kind: sphere, radius: 0.1}]}",
            ("collision.shapes.0.frame", "nose", "tip"),
        ),
        ("collision: {shapes: [{frame: tip, kind: cone, radius: 0.1}]}", ("collision.shapes.0.kind", "sphere")),
        ("collision: {shapes: [{frame: tip, kind: sphere}]}", ("collision.shapes.0.radius", "required")),
        ("collision: {shapes: [{frame: tip, radius: 0.1}]}", ("collision.shapes.0.kind", "required")),
        ("collision: {shapes: [{frame: tip, kind: sphere, radius: yes}]}", ("collision.shapes.0.radius", "not true")),
        (
            "collision: {shapes: [{frame: tip, kind: cylinder, radius: 0.1, a: [0, 0, 1], b: [0, 0, 1]}]}",
            ("'collision.shapes.0'", "two points that differ"),
        ),
        (
            "collision: {shapes: [{frame: tip, kind: box, half: [1, 1, 1], orientation: [1, 1, 0, 0]}]}",
            ("'collision.shapes.0.orientation'", "unit quaternion"),
        ),
        (
            "collision: {shapes: [{frame: tip, kind: sphere, radius: 0.1, half: [1, 1, 1]}]}",
            ("'collision.shapes.0.half'", "valid: ", "collision.shapes.0.radius"),
        ),
        ("collision: {margin: -1}", ("collision.margin", "-1")),
        ("collision: {margins: 1}", ("collision.margins", "margin")),
        ("collision: {self: {pairs: [[foot, nose]]}}", ("collision.self.pairs", "nose", "fore")),
        ("collision: {self: {ignore: [[foot]]}}", ("collision.self.ignore",)),
        ("collision: {shapes: []}", ("collision.shapes", "no shapes")),
    ],
)
def test_a_wrong_section_names_file_and_key(tmp_path: Path, section: str, words: tuple[str, ...]) -> None:
    with pytest.raises(InputError) as error:
        robot_geometry(load_robot(write_arm(tmp_path, section)))
    assert all(word in str(error.value) for word in ("arm.yaml", *words)), str(error.value)


def touching(robot: RobotModel, states: np.ndarray) -> set[frozenset[str]]:
    """Pairs of bodies in contact at any state, by MuJoCo's own collision detection."""
    truth = TrueDistance(robot, [(mujoco.mjtGeom.mjGEOM_SPHERE, [0.01])])
    m, d = truth.model, truth.data
    m.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_FILTERPARENT
    found = set()
    for x in states:
        truth(x, [np.array([50.0, 0, 0])])
        mujoco.mj_comPos(m, d)
        mujoco.mj_collision(m, d)
        bodies = [m.geom_bodyid[list(d.contact[c].geom)] for c in range(d.ncon)]
        found |= {frozenset(str(m.body(int(b)).name) for b in pair) for pair in bodies}
    return found


def test_pairs_that_touch_are_proposed_or_adjacent(tmp_path: Path) -> None:
    robot = load_robot(write_arm(tmp_path))
    proposal = propose_pairs(robot, 300)
    known = {frozenset(p) for p in (*proposal.pairs, *proposal.adjacent, *proposal.always)}
    seen = touching(robot, draw_states(robot, 300))
    assert seen and seen <= known
    assert ("foot", "fore") in proposal.pairs and ("upper", "fore") in proposal.adjacent
    assert {frozenset(p) for p in proposal.never}.isdisjoint(seen)


def test_listed_pairs_come_near_and_are_clear_at_home(tmp_path: Path) -> None:
    """Truth: contacts at the states that were drawn."""
    robot = load_robot(write_arm(tmp_path))
    listing = list_pairs(robot, 300)
    known = {frozenset(p) for p in (*listing.pairs, *listing.rare, *listing.close)}
    adjacent = {frozenset(p) for p in propose_pairs(robot, 2).adjacent}
    assert touching(robot, draw_states(robot, 300)) - adjacent <= known
    assert touching(robot, robot.home[None]).isdisjoint(frozenset(p) for p in listing.pairs)
    assert ("foot", "fore") in listing.pairs


@pytest.mark.parametrize("listed", ["in the file", "by sampling"])
def test_listed_pairs_are_those_without_which_postures_are_missed(listed: str) -> None:
    """41 pairs of this arm come near each other, and 20 are listed: the most frequent ones let the hand into the base. Truth: distances of
    all pairs in other postures."""
    robot = load_robot("vega")
    listing = list_pairs(robot)
    chosen = set(listing.pairs if listed == "by sampling" else self_pairs(robot))
    every = [*listing.pairs, *listing.rare]
    assert len(every) > len(chosen) == 20 and listing.missed < 0.005
    margins = own_margins(robot, every, 0.02)
    near = distances(robot_geometry(robot), every, draw_states(robot, 6000, seed=7)[1:], 0.02) < margins
    missed = near.any(axis=1) & ~near[:, [p in chosen for p in every]].any(axis=1)
    assert missed.sum() < 0.005 * near.any(axis=1).sum()


def test_a_pair_that_nothing_can_keep_apart_is_none() -> None:
    """The ball robot's upper arm is beside its body however its joints turn. Truth: MuJoCo's distances."""
    robot, pair = load_robot("rezero"), ("base", "arm_upper_link")
    near = distances(robot_geometry(robot), [pair], draw_states(robot, 100, seed=1))
    assert near.min() > 0.0 and near.max() < robot.description.collision.self.margin
    assert pair in propose_pairs(robot).always and self_pairs(robot) == (("base", "arm_forearm_link"),)


def test_a_body_stands_for_all_that_is_fixed_to_it() -> None:
    """Truth: MuJoCo's distances of each body alone."""
    robot = load_robot("differential-ur10")  # the arm's foot is fixed to the chassis
    geometry, states = robot_geometry(robot), draw_states(robot, 40, seed=1)
    both = distances(geometry, [("chassis", "wrist_3_link"), ("base_link", "wrist_3_link")], states, 2.0)
    assert np.array_equal(both[:, 0], both[:, 1])
    shapes = {f: [s for s in geometry.shapes if s.frame == f] for f in ("chassis", "base_link", "wrist_3_link")}
    alone = [
        distances(RobotGeometry(robot, [*shapes[f], *shapes["wrist_3_link"]]), [(f, "wrist_3_link")], states, 2.0)
        for f in ("chassis", "base_link")
    ]
    np.testing.assert_allclose(both[:, 0], np.minimum(*alone)[:, 0], atol=1e-9)
    assert (alone[0] < alone[1]).any() and (alone[1] < alone[0]).any()
    assert not any("base_link" in pair for pair in list_pairs(robot, 50).pairs)


def test_pairs_to_ignore_are_left_out_and_the_rest_is_shown(tmp_path: Path) -> None:
    robot = load_robot(write_arm(tmp_path, "collision: {self: {ignore: [[fore, foot]]}}"))
    assert ("foot", "fore") in propose_pairs(robot).pairs and ("foot", "fore") not in self_pairs(robot)
    text = " ".join(f.message for f in diagnose(robot))
    assert "4 shapes on 4 frames" in text and "confirm them" in text and "[shoulder, fore]" in text


def test_a_pair_that_touches_and_is_not_in_the_file_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Truth: MuJoCo's contacts, state by state."""
    monkeypatch.setattr(pairs, "RARE", 0.0)
    section = "collision: {{self: {{pairs: [{}], ignore: [{}]}}}}"
    kept = [("shoulder", "fore"), ("foot", "upper")]
    bare = load_robot(write_arm(tmp_path, section.format("[shoulder, fore], [foot, upper]", "")))
    count, counted, never, found = unlisted(bare)
    states, pair = draw_states(bare, count, seed=1), frozenset(("foot", "fore"))
    apart = distances(robot_geometry(bare), kept, states, 0.05) >= own_margins(bare, kept, 0.02)
    held = states[apart.all(axis=1)]
    assert counted == np.count_nonzero(apart[1:].all(axis=1)) and never == ()
    assert found == {("foot", "fore"): sum(pair in touching(bare, x[None]) for x in held)}
    (said,) = [f for f in diagnose(bare) if f.severity == "warning"]
    assert f"[foot, fore] in {found['foot', 'fore']}" in said.text and "[[foot, fore]]" in said.fix
    for k, lists in enumerate([("[foot, upper], [fore, foot]", ""), ("[foot, upper]", "[fore, foot]")]):
        (tmp_path / str(k)).mkdir()
        known = load_robot(write_arm(tmp_path / str(k), section.format(*lists)))
        assert unlisted(known)[::3] == (count, {}) and [f for f in diagnose(known) if f.severity == "warning"] == []


TELESCOPE = """<mujoco><compiler angle="radian" autolimits="true"/><worldbody><body name="base"><freejoint/>
<inertial pos="0 0 0" mass="20" diaginertia="1 1 1"/>{wheels}
<body name="tube" pos="0 0 0.6"><geom type="box" size="0.2 0.03 0.03" contype="1"/><inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/>
<joint name="a" type="slide" axis="1 0 0" range="0 0.3"/>
<body name="rod"><geom type="box" size="0.2 0.02 0.02"/><inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/>
<joint name="b" type="slide" axis="{second}" range="-0.3 0"/>
<body name="tip"><geom type="box" size="0.2 0.01 0.01"/><inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/>
<joint name="c" type="slide" axis="1 0 0" range="0 0.6"/><site name="tool" pos="0.2 0 0"/></body></body></body></body></worldbody></mujoco>"""


@pytest.mark.parametrize(("second", "nested"), [("-1 0 0", True), ("0 0 1", False)])
def test_sections_of_a_telescope_go_into_each_other(tmp_path: Path, second: str, nested: bool) -> None:
    """Of three boxes that slide, the last is in the first unless it is out by more than 0.4 m; a lift between them makes it no telescope."""
    from wbmpc.bases import base_type
    from wbmpc.simulation.perturbation import Perturbation

    wheels = "".join(
        f'<body name="{n}" pos="0 {y} 0.1"><inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/><joint name="{n}" axis="0 1 0"/></body>'
        for n, y in (("l", 0.3), ("r", -0.3))
    )
    (tmp_path / "robot.xml").write_text(TELESCOPE.format(wheels=wheels, second=second))
    (tmp_path / "robot.yaml").write_text(
        "name: telescope\nmodel: robot.xml\nbase: {type: differential, body: base, wheels: [l, r], wheel_radius: 0.1}\n"
        "arm: {joints: [a, b, c], tool: tool}\nhome: {c: 0.55}\n"
        "limits: {velocity: {l: 10, r: 10, a: 1, b: 1, c: 1}}\n"
    )
    robot = load_robot(tmp_path / "robot.yaml")
    assert telescopes(robot) == ([[0, 1, 2]] if nested else [])
    assert (("tube", "tip") in propose_pairs(robot, 300).adjacent) == nested
    assert (("tube", "tip") in list_pairs(robot, 300).pairs) != nested
    plant = base_type("differential").plant(robot, Perturbation.none(), 0)
    plant.arrange(np.zeros(robot.state.size))  # all the way in
    plant.world.refresh()
    plant.world.contacts.update(1.0)
    found = {(t.first, t.second) for t in plant.world.contacts.touches}
    assert (("tip", "tube") in found) != nested


@pytest.mark.parametrize("lift", [0.055, 0.2])
def test_what_overlaps_in_most_states_is_ignored_by_plans_and_simulation(tmp_path: Path, lift: float) -> None:
    """A tip of half height 0.01 m slides up and down through a tube of half height 0.03 m, from -0.055 m to ``lift``: they overlap in 0.08 m of
    its travel of 0.11 m (most states) or 0.255 m (few). Truth: MuJoCo's contacts with the tip in the middle of the tube."""
    from wbmpc.bases import base_type
    from wbmpc.simulation.perturbation import Perturbation

    wheels = "".join(
        f'<body name="{n}" pos="0 {y} 0.1"><inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/><joint name="{n}" axis="0 1 0"/></body>'
        for n, y in (("l", 0.3), ("r", -0.3))
    )
    text = TELESCOPE.format(wheels=wheels, second="0 1 0").replace(
        'size="0.2 0.02 0.02"', 'size="0.01 0.01 0.01" pos="0 0 -0.3"'
    )
    text = text.replace('range="-0.3 0"', 'range="-0.001 0"').replace(
        'name="c" type="slide" axis="1 0 0" range="0 0.6"', f'name="c" type="slide" axis="0 0 1" range="-0.055 {lift}"'
    )
    (tmp_path / "robot.xml").write_text(text)
    content = (
        "name: telescope\nmodel: robot.xml\nbase: {{type: differential, body: base, wheels: [l, r], wheel_radius: 0.1}}\n"
        "arm: {{joints: [a, b, c], tool: tool}}\nhome: {{c: {lift}}}\nlimits: {{velocity: {{l: 10, r: 10, a: 1, b: 1, c: 1}}}}\n{more}"
    )
    path, often = tmp_path / "robot.yaml", lift < 0.1
    path.write_text(content.format(lift=lift, more=""))
    listing = list_pairs(load_robot(path), 300)
    assert (("tube", "tip") in listing.drawn) == often and (("tube", "tip") in listing.pairs) != often
    for ignored in (False, True):
        more = "collision: {self: {pairs: [], ignore: [[tube, tip]]}}\n" if ignored else ""
        path.write_text(content.format(lift=lift, more=more))
        robot = load_robot(path)
        assert not ignored or ("tube", "tip") not in self_pairs(robot)
        plant = base_type("differential").plant(robot, Perturbation.none(), 0)
        plant.arrange(np.zeros(robot.state.size))
        plant.world.refresh()
        plant.world.contacts.update(1.0)
        assert any({t.first, t.second} == {"tube", "tip"} for t in plant.world.contacts.touches) != ignored


def test_robots_of_hundreds_of_shapes_are_sampled_in_fewer_states(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """480 boxes on 12 links have 105 600 pairs, whose distances in all states at once need gigabytes; what is said is of the states that
    were drawn. Truth: all states, of a robot for which that is no work."""
    robot = load_robot("swerve-ur10")
    geometry, states = robot_geometry(robot), draw_states(robot, 40)
    pairs = list(propose_pairs(robot, 40).pairs)
    everywhere = distances(geometry, pairs, states, 2.0)
    for name, value, drawn in (
        ("AT_ONCE", 1, 40),
        ("MAX_BOUNDS", 7 * len(geometry.shapes) ** 2, 7),
        ("MAX_EXACT", 1, 1),
    ):
        with monkeypatch.context() as patched:
            patched.setattr(f"wbmpc.obstacles.pairs.{name}", value)
            np.testing.assert_array_equal(distances(geometry, pairs, states, 2.0), everywhere[:drawn])
            assert list_pairs(robot, 40).samples == propose_pairs(robot, 40).samples == drawn
    text = ["<robot name='chain'>"]
    for k in range(12):
        shapes = "".join(
            f'<collision><origin xyz="{0.05 * i} 0 0"/><geometry><box size="0.05 0.05 0.05"/></geometry></collision>'
            for i in range(40)
        )
        inertia = '<inertia ixx="0.02" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/>'
        text.append(f'<link name="k{k}"><inertial><mass value="1"/>{inertia}</inertial>{shapes}</link>')
    for k in range(11):
        ends = (
            f'<parent link="k{k}"/><child link="k{k + 1}"/><origin xyz="0 0 0.3"/><axis xyz="{k % 2} {1 - k % 2} 0"/>'
        )
        limit = '<limit lower="-2" upper="2" effort="50" velocity="2"/>'
        text.append(f'<joint name="j{k}" type="revolute">{ends}{limit}</joint>')
    (tmp_path / "chain.urdf").write_text("".join([*text, "</robot>"]))
    out = tmp_path / "chain.yaml"
    with limited_memory(2 * 1024**3):
        assert main(["new", str(tmp_path / "chain.urdf"), "--yes", "--out", str(out)]) == 0
    found = re.search(r"in ([0-9]+) random states", out.read_text())
    assert found is not None and 10 < int(found[1]) < 100
    monkeypatch.setattr("wbmpc.obstacles.pairs.MAX_SHAPES", 400)
    with pytest.raises(InputError, match="the robot has 480 shapes; at most 400 are compared"):
        list_pairs(load_robot(out))


@pytest.mark.parametrize("name", ["panda", "panda-omni", "pr2", "vega"])
def test_a_pair_that_is_near_at_home_keeps_two_thirds_of_its_distance_there(name: str) -> None:
    """They collide in the simulation like any other pair. Truth: MuJoCo's distances."""
    robot, margin = load_robot(name), 0.02
    pairs = list(self_pairs(robot))
    at_home = distances(robot_geometry(robot), pairs, robot.home[None], 0.5)[0]
    term = SelfClearance(robot)
    clear = at_home - term.margins
    assert (clear > at_home / 3.0 - 1e-9).all()
    np.testing.assert_allclose(np.array(term.margins)[at_home > 1.5 * margin], margin)
    np.testing.assert_allclose(
        np.array(term.margins)[at_home < 1.5 * margin], at_home[at_home < 1.5 * margin] / 1.5, atol=1e-9
    )
    assert 0.0 < min(term.margins) < margin
    rows = SelfRows(term)
    kept = rows.refresh(robot.home[None]).reshape(-1, SELF_WIDTH)[:, 9]
    near = at_home < 1.5 * margin
    np.testing.assert_allclose(kept[near], at_home[near] / 1.5, atol=1e-6)
    worst = rows.clearance(np.zeros(1), robot.home[None])
    assert worst.margin == pytest.approx(term.margins[int(np.argmin(at_home - term.margins))])
    assert {frozenset(p) for p in list_pairs(robot).pairs} <= {frozenset(p) for p in pairs}

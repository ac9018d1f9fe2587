"""Support switches. Truth: statics of a table worked out by hand, linear programming for which feet can carry, MuJoCo for a
table that rocks."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from wbmpc import stability
from wbmpc.errors import InputError
from wbmpc.studies.pankert2022.support_switches import resting_triangles, support_shares, support_switches, upright

SQUARE = np.array([[0.5, 0.5], [0.5, -0.5], [-0.5, 0.5], [-0.5, -0.5]])  # LF, RF, LB, RB


def test_a_raised_foot_and_its_opposite_always_carry() -> None:
    faces = resting_triangles(SQUARE, [0.05, 0.0, 0.0, 0.0])
    assert sorted(tuple(sorted(f)) for f in faces) == [(0, 1, 3), (0, 2, 3)]
    assert len(resting_triangles(SQUARE, np.zeros(4))) == 4


@given(st.integers(0, 10_000))
@settings(max_examples=30, deadline=None)
def test_the_resting_triangle_is_that_of_the_lowest_potential_energy(seed: int) -> None:
    """A rigid body rests as low as the ground allows: the plane over all points of the ground that is lowest at the center
    of mass, a linear programme."""
    rng = np.random.default_rng(seed)
    feet, heights = rng.uniform(-1, 1, (rng.integers(3, 7), 2)), rng.uniform(0, 0.02, 8)
    heights = heights[: len(feet)]
    point = rng.dirichlet(np.ones(len(feet))) @ feet
    rows = np.column_stack([-feet, -np.ones(len(feet))])
    plane = linprog([*point, 1.0], A_ub=rows, b_ub=-heights, bounds=[(None, None)] * 3).x
    touching = {int(i) for i in np.flatnonzero(np.abs(feet @ plane[:2] + plane[2] - heights) < 1e-7)}
    faces = [t for t in resting_triangles(feet, heights) if stability.margin(feet[list(t)], point) >= 0.0]
    assert [set(t) for t in faces] == [touching]


def test_shares_are_moments_about_the_edges() -> None:
    shares = support_shares(SQUARE, (0, 2, 1), [0.25, 0.0])
    assert shares @ SQUARE[[0, 2, 1]] == pytest.approx([0.25, 0.0])
    assert shares.sum() == pytest.approx(1.0)
    up = upright(SQUARE, [0.1, 0.0, 0.1, 0.0], (0, 2, 1))
    assert up == pytest.approx([0.0, 0.1, np.sqrt(0.99)])  # 0.1 m over 1 m to the left


def test_a_robot_that_tips_back_at_once_balances_on_the_edge() -> None:
    """A stance in which the load is beyond the common edge on either of two faces: neither carries it."""
    heights = [0.05, 0.0, 0.0, 0.0]
    beyond = lambda face: [0.1, -0.1] if 2 in face else [-0.1, 0.1]
    stance = lambda up, face: (SQUARE, np.tile(beyond(face), (3, 1)), np.ones(3))
    faces = resting_triangles(SQUARE, heights)
    assert all(support_shares(SQUARE, f, beyond(f)).min() < 0.0 for f in faces)
    (found,) = support_switches([0.0, 1.0, 2.0], SQUARE, heights, stance)
    assert {found.previous, found.after} == {tuple(sorted(f)) for f in faces}


# ---------------------------------------------------------------------- a table with a mass that goes round
LEGS, HEIGHT, TOP, LOAD, RADIUS, TURN = 0.3, 0.01, 20.0, 8.0, 0.3, 30.0
SOLID = 'solref="0.004 1"'


def table() -> mujoco.MjModel:
    """A square top on four balls, one of them on a block, and a mass that a hinge carries round."""
    balls = "".join(f'<geom type="sphere" size="0.02" pos="{x} {y} -{LEGS}" mass="0" {SOLID}/>' for x, y in SQUARE)
    return mujoco.MjModel.from_xml_string(f"""
<mujoco><option timestep="0.001"/><worldbody>
  <geom type="plane" size="5 5 1" {SOLID}/>
  <geom type="box" size="0.1 0.1 {HEIGHT / 2}" pos="0.5 0.5 {HEIGHT / 2}" {SOLID}/>
  <body name="top" pos="0 0 {LEGS + 0.02 + HEIGHT / 2}"><freejoint/>
    <inertial pos="0 0 0" mass="{TOP}" diaginertia="1.5 1.5 3"/>{balls}
    <body><joint name="arm" axis="0 0 1" damping="1"/><inertial pos="{RADIUS} 0 0.1" mass="{LOAD}" diaginertia="1e-3 1e-3 1e-3"/>
      <geom type="sphere" size="0.01" mass="0" contype="0" conaffinity="0"/></body>
  </body></worldbody>
  <actuator><velocity joint="arm" kv="200"/></actuator></mujoco>""")


def test_predicted_switches_are_those_of_a_simulated_table() -> None:
    m = table()
    d = mujoco.MjData(m)
    rate, start = 2.0 * np.pi / TURN, 2.0
    times, forces, arm = [], [], []
    for _ in range(round((start + TURN) / m.opt.timestep)):
        d.ctrl[0] = rate if d.time > start else 0.0
        mujoco.mj_step(m, d)
        if d.time > start and len(times) <= (d.time - start) / 0.005:
            times.append(d.time)
            arm.append(d.qpos[7])
            forces.append(_normal_forces(m, d))
    forces, t = np.array(forces), np.array(times)
    heights = np.array([HEIGHT, 0.0, 0.0, 0.0])
    weight = 9.81 * (TOP + LOAD)

    def stance(up: np.ndarray, _: tuple) -> tuple:
        turned = RADIUS * np.stack([np.cos(arm), np.sin(arm)], axis=1)
        com = np.column_stack([LOAD * turned, np.full(t.size, LOAD * 0.1)]) / (TOP + LOAD) + [0.0, 0.0, LEGS]
        load = stability.Load.gravity(TOP + LOAD, com, -9.81 * up)
        return SQUARE, stability.zero_moment_point(load), weight * up[2] + 0.0 * t

    predicted = support_switches(t, SQUARE, heights, stance, unloaded=2.0)
    assert [s.previous for s in predicted] == [(0, 2, 3), (0, 1, 3)] or [s.previous for s in predicted] == [
        (0, 1, 3),
        (0, 2, 3),
    ]
    for s in predicted:
        (lost,) = set(s.previous) - set(s.after)
        near = (t > s.time - 1.0) & (t < s.time + 1.0)
        assert forces[near][0, lost] > 2.0 > forces[near][-1, lost]
        happened = t[near][np.argmax(forces[near][:, lost] < 2.0)]
        assert happened == pytest.approx(s.time, abs=0.05)


def _normal_forces(m: mujoco.MjModel, d: mujoco.MjData) -> np.ndarray:
    out, f = np.zeros(4), np.zeros(6)
    for c in range(d.ncon):
        mujoco.mj_contactForce(m, d, c, f)
        out[max(d.contact[c].geom) - 2] += f[0]
    return out


@pytest.mark.parametrize("times", [[0.0, 2.0, 1.0], [0.0, np.nan], []])
def test_times_that_do_not_rise_are_rejected(times: list[float]) -> None:
    stance = lambda up, face: (SQUARE, np.zeros((len(times), 2)), np.ones(len(times)))
    with pytest.raises(InputError, match="each larger than the one before"):
        support_switches(times, SQUARE, [0.01, 0.0, 0.0, 0.0], stance)


@pytest.mark.parametrize("slope", [np.nan, 1.6, -2.0, np.inf])
def test_slopes_on_which_nothing_stands_are_rejected(slope: float) -> None:
    with pytest.raises(InputError, match=r"slope: less than 1\.57 rad"):
        stability.slope_gravity(slope)


@pytest.mark.parametrize(
    ("points", "forces", "words"),
    [
        ([[0.1, 0.0], [np.nan, np.nan], [0.2, 0.0]], [9.0] * 3, "zero-moment points"),
        ([[0.1, 0.0]] * 2, [9.0] * 2, "zero-moment points"),
        ([[0.1, 0.0]] * 3, [9.0, np.nan, 9.0], "forces"),
        ([[0.1, 0.0]] * 3, [9.0], "forces"),
    ],
)
def test_stances_that_make_no_sense_are_rejected(points: list, forces: list, words: str) -> None:
    stance = lambda up, face: (SQUARE, np.array(points), np.array(forces))
    with pytest.raises(InputError, match=words):
        support_switches([0.0, 1.0, 2.0], SQUARE, [0.01, 0.0, 0.0, 0.0], stance)

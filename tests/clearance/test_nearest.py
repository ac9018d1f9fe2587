"""Compiled nearest points of solids. Truth: MuJoCo's own collision functions, and that both points belong to their solids."""

from __future__ import annotations

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from effort import draws
from wbmpc import lie
from wbmpc.clearance.table import Found, SolidTable
from wbmpc.kernel.step import Backend
from wbmpc.obstacles import solids
from wbmpc.obstacles.solids import KINDS, Solid

GEOMS = [getattr(mujoco.mjtGeom, f"mjGEOM_{kind.upper()}") for kind in KINDS]


def rotation(rng: np.random.Generator) -> np.ndarray:
    q = rng.normal(size=4)
    return lie.quaternion_to_rotation(q / np.linalg.norm(q))


def drawn(kind: str, rng: np.random.Generator) -> Solid:
    """A solid of some centimeters to a meter, flat ones among them, at the origin."""
    if kind == "mesh":
        made = solids.mesh(rng.normal(size=(14, 3)) * rng.uniform(0.05, 0.3, 3))
        return Solid(kind, made.size, vertices=made.vertices)
    return Solid(kind, rng.uniform(0.03, 0.5, 3))


def table(first: Solid, backend: Backend = "compiled") -> SolidTable:
    """Of one shape at the origin of its frame."""
    shape = SimpleNamespace(frame="body", solid=first)
    return SolidTable(SimpleNamespace(shapes=[shape], frame_of=np.zeros(1, int)), backend)  # type: ignore[arg-type]


def found(
    first: Solid, second: Solid, places: np.ndarray, axes: np.ndarray, turn: np.ndarray, limit: float = 10.0,
    backend: Backend = "compiled",
) -> Found:  # fmt: skip
    """``first`` at places (n, 3) and axes (n, 3, 3), ``second`` at the origin."""
    n = len(places)
    made = table(first, backend)
    zeros, limits = np.zeros((n, 1, 3)), np.full((n, 1, 1), limit)
    return made.nearest(places[:, None], axes[:, None], [second], zeros, turn[None], limits)


def by_mujoco(first: Solid, second: Solid, place: np.ndarray, axes: np.ndarray, turn: np.ndarray) -> float:
    spec = mujoco.MjSpec()
    for k, solid in enumerate((first, second)):
        geom = spec.worldbody.add_geom(type=GEOMS[KINDS.index(solid.kind)], size=solid.size)
        if solid.kind == "mesh":
            spec.add_mesh(name=f"m{k}", uservert=solid.vertices.ravel())
            geom.meshname = f"m{k}"
    spec.option.ccd_tolerance, spec.option.ccd_iterations = 1e-10, 200
    model = spec.compile()
    data = mujoco.MjData(model)
    for k, (at, own) in enumerate(((place, axes), (np.zeros(3), turn))):
        offset = lie.quaternion_to_rotation(model.geom_quat[k].copy())  # a mesh's axes are the compiler's
        data.geom_xpos[k], data.geom_xmat[k] = at + own @ model.geom_pos[k], (own @ offset).ravel()
    return float(mujoco.mj_geomDistance(model, data, 0, 1, 10.0, None))


PAIRS = [(a, b) for i, a in enumerate(KINDS) for b in KINDS[i:]]


@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
def test_distances_are_those_of_mujoco(pair: tuple[str, str]) -> None:
    rng = np.random.default_rng(PAIRS.index(pair))
    for _ in range(draws(4, 60)):
        first, second = (drawn(kind, rng) for kind in pair)
        places, turn = rng.uniform(-1.2, 1.2, (8, 3)), rotation(rng)
        axes = np.array([rotation(rng) for _ in places])
        made = found(first, second, places, axes, turn)
        for k, place in enumerate(places):
            d, n = made.distance[k, 0, 0], made.normal[k, 0, 0]
            truth = by_mujoco(first, second, place, axes[k], turn)
            assert d == pytest.approx(truth, abs=2e-6 if truth > 0.0 else 2e-3), (first, second, place)
            p, q = made.own[k, 0, 0], made.other[k, 0, 0]
            assert np.linalg.norm(n) == pytest.approx(1.0, abs=1e-9)
            if truth > 0.0:
                np.testing.assert_allclose(p - q, d * n, atol=1e-6)
                assert first.distance(((p - place) @ axes[k])[None])[0] < 1e-6
                assert second.distance((q @ turn)[None])[0] < 1e-6


def test_balls_and_capsules_inside_of_each_other_are_measured_without_mujoco(monkeypatch: pytest.MonkeyPatch) -> None:
    """Closed form: the distance of a point to a line, minus both radii."""
    monkeypatch.setattr("wbmpc.clearance.table.Collider.distance", lambda *_: pytest.fail("asked MuJoCo"))
    capsule = Solid("capsule", np.array([0.2, 0.5, 0.0]))
    places = np.array([[0.1, 0.0, 0.3], [0.0, 0.15, -0.6], [0.3, 0.1, 0.0]])
    made = found(solids.sphere(0.1, np.zeros(3)), capsule, places, np.tile(np.eye(3), (3, 1, 1)), np.eye(3))
    on_line = np.array([[0, 0, 0.3], [0, 0, -0.5], [0, 0, 0]])
    truth = np.linalg.norm(places - on_line, axis=1) - 0.3
    np.testing.assert_allclose(made.distance[:, 0, 0], truth, atol=1e-9)


def test_what_is_not_nearer_than_asked_for_is_left_alone() -> None:
    box = Solid("box", np.array([0.1, 0.2, 0.3]))
    places = np.array([[1.0, 0.0, 0.0], [0.5, 0.0, 0.0]])
    made = found(box, box, places, np.tile(np.eye(3), (2, 1, 1)), np.eye(3), limit=0.4)
    np.testing.assert_allclose(made.distance[:, 0, 0], [0.4, 0.3])
    assert not made.normal[0].any() and made.compared == 1


def test_the_interpreted_source_finds_the_same() -> None:
    rng = np.random.default_rng(5)
    for pair in (("box", "cylinder"), ("mesh", "capsule"), ("ellipsoid", "box")):
        first, second = (drawn(kind, rng) for kind in pair)
        places, axes = rng.uniform(-1, 1, (4, 3)), np.array([rotation(rng) for _ in range(4)])
        one, other = (found(first, second, places, axes, np.eye(3), backend=b) for b in ("compiled", "interpreted"))
        np.testing.assert_allclose(one.distance, other.distance, atol=1e-9)
        np.testing.assert_allclose(one.normal, other.normal, atol=1e-6)

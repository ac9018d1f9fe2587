"""The push map. Truth: robots of known strength, by formula."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from wbmpc.experiments.push_map import FINE, MOST, Point, impulse_at_failure, points, push_map


@pytest.mark.parametrize("strength", [3.0, 22.0, 161.3])
def test_bisection_brackets_the_strength(strength: float) -> None:
    tried: list[float] = []

    def stands(point: Point, impulse: float) -> bool:
        tried.append(impulse)
        return impulse < strength

    low, high = impulse_at_failure(Point("hand", 0.0, 0.2, 0), stands)
    assert low < strength <= high <= low + FINE
    assert len(tried) < 9
    assert impulse_at_failure(Point("hand", 0.0, 0.2, 0), lambda p, i: True) == (MOST, np.inf)


def test_a_map_has_all_pushes_once() -> None:
    todo = points("ball", 16, (0.05, 0.4), 3)
    assert len({p.key for p in todo}) == 32
    assert todo[4].direction == pytest.approx(np.pi / 2)
    other = points("ball", 16, (0.05, 0.4), 3, ("controller=lqr",))
    assert not {p.key for p in other} & {p.key for p in todo}


def test_an_interrupted_map_goes_on(tmp_path: Path) -> None:
    """What the file has is not measured again; the rest is, and is written at once."""
    work = lambda left: ((p.key, (10.0 * p.direction, np.inf)) for p, _ in left)
    todo, file = points("hand", 4, (0.2,), 0), tmp_path / "map.json"
    file.write_text(json.dumps({todo[1].key: [1.0, 2.0]}))
    seen = push_map(todo, file, work)
    assert next(seen) == (todo[1].key, [1.0, 2.0])
    assert next(seen) == (todo[0].key, [0.0, None])
    assert set(json.loads(file.read_text())) == {todo[0].key, todo[1].key}
    assert dict(seen) == {todo[2].key: [10.0 * np.pi, None], todo[3].key: [15.0 * np.pi, None]}


def test_a_coarse_map_is_made_finer(tmp_path: Path) -> None:
    """Bisections go on from what the file has: no push is tried outside of it, and all end as narrow as is asked for."""
    strength, tried = 161.3, []

    def stands(point: Point, impulse: float) -> bool:
        tried.append(impulse)
        return impulse < strength

    def at(fine: float) -> list[tuple[str, list[float | None]]]:
        work = lambda left: ((p.key, impulse_at_failure(p, stands, fine, known)) for p, known in left)
        return list(push_map(points("hand", 2, (0.2,), 0), tmp_path / "map.json", work, fine))

    assert [v for _, v in at(200.0)] == [[160.0, 320.0]] * 2
    tried.clear()
    for _, (low, high) in at(FINE):
        assert low is not None and high is not None
        assert low < strength <= high <= low + FINE
    assert min(tried) > 160.0 and max(tried) < 320.0
    tried.clear()
    assert len(at(FINE)) == 2 and not tried

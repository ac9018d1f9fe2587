"""What the doctor says where it cannot look for missing pairs. Truth: what the robot file lists, and the limit that is set."""

from __future__ import annotations

from pathlib import Path

import pytest

from clearing import write_arm
from wbmpc.cli.doctor import collisions
from wbmpc.obstacles import pairs


def test_a_robot_of_too_many_shapes_keeps_its_other_findings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_arm(tmp_path, "collision: {self: {pairs: [[foot, fore]]}}")
    monkeypatch.setattr(pairs, "MAX_SHAPES", 3)
    found = collisions(str(path))
    assert [f.severity for f in found] == ["info", "info", "warning"]
    assert "4 shapes on 4 frames" in found[0].message and "1 pairs, confirmed" in found[1].message
    assert "the robot has 4 shapes; at most 3" in found[2].text


def test_a_pair_that_never_keeps_its_margin_is_named(tmp_path: Path) -> None:
    """Two frames of which one is the other's neighbor touch however the joint turns: no state says anything of other pairs."""
    found = collisions(str(write_arm(tmp_path, "collision: {self: {pairs: [[upper, fore], [foot, upper]]}}")))
    (warning,) = [f for f in found if f.severity == "warning"]
    assert "in none of" in warning.text and "never do: [upper, fore]" in warning.text

"""What `wbmpc doctor` says of parts that touch and that no pair keeps apart."""

from __future__ import annotations

from pathlib import Path

import pytest

from clearing import write_arm
from wbmpc.model.robot import load_robot
from wbmpc.obstacles import pairs
from wbmpc.obstacles.pairs import diagnose, unlisted


def test_what_touches_in_few_states_is_a_note(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Truth: the share of states in which it touches, on both sides of the limit."""
    robot = load_robot(write_arm(tmp_path, "collision: {self: {pairs: [[shoulder, fore], [foot, upper]]}}"))
    looked = unlisted(robot)
    share = looked.pairs["foot", "fore"] / looked.counted
    for limit, severity in ((0.99 * share, "warning"), (1.01 * share, "info")):
        monkeypatch.setattr(pairs, "RARE", limit)
        assert [f.severity for f in diagnose(robot) if "[foot, fore]" in f.text] == [severity]


@pytest.mark.parametrize("name", ["pentapod-ur10", "swerve-ur10", "telescope-ur10"])
def test_parts_of_bases_with_legs_are_kept_apart(name: str) -> None:
    assert [f.text for f in diagnose(load_robot(name)) if f.severity == "warning"] == []

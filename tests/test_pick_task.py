"""The scene of `pick-from-shelf`. Truth: where its boxes end."""

from __future__ import annotations

import numpy as np
import pytest

from wbmpc.model.robot import load_robot
from wbmpc.tasks.obstacles import Extent
from wbmpc.tasks.pick import ELSEWHERE, PickSettings, shelf


@pytest.mark.parametrize("name", ["differential-ur10", "fetch"])
@pytest.mark.parametrize("seed", [0, 1])
def test_the_end_effector_has_room_in_the_shelf_and_the_base_has_none(name: str, seed: int) -> None:
    robot, settings = load_robot(name), PickSettings()
    e = Extent(robot, "test")
    ends = {
        o.name: (np.array(o.place["position"]) - o.shape.half, np.array(o.place["position"]) + o.shape.half)
        for o in shelf(settings, robot, seed)
    }
    goal = e.tool + [1.2, 0.0, 0.0]
    low, high = ends["lower-board"][1][2], ends["upper-board"][0][2]
    assert high - low == pytest.approx(settings.opening) and low + 0.2 < goal[2] < high - 0.2
    front = ends["lower-board"][0][0]
    assert goal[0] - front == pytest.approx(settings.inside, abs=ELSEWHERE + 1e-9)
    assert goal[0] + 0.2 < ends["back"][0][0]
    # a base that went as far as the end effector would be in the foot; at home nothing is in the shelf
    assert ends["foot"][0][0] < e.base_high[0] + 1.2 and ends["foot"][0][0] <= front + 1e-9
    assert ends["foot"][0][2] == pytest.approx(e.ground)
    assert e.high[0] < min(front, ends["foot"][0][0])

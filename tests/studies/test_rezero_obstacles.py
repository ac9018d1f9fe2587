"""The scene of `rezero-obstacles`. Truth: straight lines at constant speeds."""

from __future__ import annotations

import numpy as np
import pytest

from wbmpc.model.robot import load_robot
from wbmpc.studies.minniti2019.obstacles import ASIDE, RezeroObstaclesSettings, scene
from wbmpc.tasks.obstacles import IN_THE_WAY, Extent


@pytest.mark.parametrize("seed", [0, 1])
def test_pillars_reach_into_the_way_and_everybody_meets_the_robot(seed: int) -> None:
    settings, robot = RezeroObstaclesSettings(), load_robot("rezero")
    e = Extent(robot, "test")
    found = {o.name: o for o in scene(settings, robot, seed)}
    left, right = (found[f"pillar{k}"].place["position"][1] for k in range(2))
    assert left - 0.1 == pytest.approx(e.high[1] - IN_THE_WAY) and right + 0.1 == pytest.approx(e.low[1] + IN_THE_WAY)
    # after 1 s at rest and a ramp of 2 s that costs 1 s the robot goes on with 0.25 m/s
    for name, way in (("person0", 1.32), ("person1", 2.4), ("head-on", 3.2)):
        one = found[name]
        walked = (2.0 + way / 0.25 - one.appears) * one.place["velocity"]
        there = one.place["position"] + walked - [*e.base[:2], e.ground]
        assert there[0] == pytest.approx(way) and abs(there[1]) <= (ASIDE if name == "head-on" else 1e-9)
    np.testing.assert_allclose(found["head-on"].place["velocity"], [-0.5, 0.0, 0.0], atol=1e-12)

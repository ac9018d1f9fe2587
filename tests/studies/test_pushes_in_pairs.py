"""Pushes in pairs. Truth: the times on paper."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from wbmpc.studies.minniti2019.push import _task
from wbmpc.studies.minniti2019.push_settings import RezeroPushBallSettings


def test_a_second_push_comes_after_the_gap_and_the_next_pair_after_the_pause() -> None:
    task = _task(RezeroPushBallSettings(forces=(50.0, 100.0), gap=0.5, pause=6.0, settle_time=3.0), np.zeros(3))
    assert [p.start for p in task.pushes] == [3.0, 3.5, 9.5, 10.0] and task.duration == 16.0
    assert [p.force for p in task.pushes[:2]] == [(50.0, 0.0, 0.0), (0.0, 50.0, 0.0)]


def test_pushes_of_a_pair_do_not_overlap() -> None:
    with pytest.raises(ValidationError, match=r"gap: 0\.5 s from one push to the next, which are 0\.6 s long"):
        RezeroPushBallSettings(gap=0.5, push_duration=0.6)

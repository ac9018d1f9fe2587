"""The drive that calibrates a robot before its run: who sees it. Truth: the protocol, and a run without watchers."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from wbmpc.experiment import Outcome, Scenario, run_scenario
from wbmpc.log import Log
from wbmpc.model.robot import load_robot
from wbmpc.simulation.any_perturbation import AnyPerturbation
from wbmpc.simulation.lockstep import PREPARATION, Ending, Watch, preparation
from wbmpc.tasks import reference_drive


class Watcher:
    """Keeps the names of the loops that it sees, and how many ticks they had."""

    def __init__(self, live: bool) -> None:
        self.live, self.seen, self.ticks = live, [], 0

    def begin(self, running: Any) -> None:
        self.seen.append(running.name)

    def tick(self, t: float, command: Any, plans: Any) -> None:
        self.ticks += 1

    def end(self, ending: Ending) -> None:
        self.seen.append(ending.reason)


def test_live_watchers_alone_see_the_drive_and_it_is_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, short in (("STRAIGHT", 0.4), ("TURN", 0.5), ("STANDING", 0.4)):
        monkeypatch.setattr(reference_drive, name, short)
    robot, notes = load_robot("differential-ur10"), []
    shown, recorded, driven = Watcher(True), Watcher(False), []

    def build(settings: Any, seed: int) -> Scenario:
        driven.append(reference_drive.drive(robot, AnyPerturbation(), seed))
        return Scenario.single(Log(), lambda _: Outcome(Ending()), lambda _: {}, lambda _: (), ())

    settings = SimpleNamespace(model_dump=lambda mode: {})
    run_scenario("toy", build, settings, 3, Watch(lambda share, note: notes.append(note), (shown, recorded)))
    assert shown.seen == [PREPARATION, ""] and shown.ticks > 1000 and recorded.seen == []
    assert any(note.startswith(PREPARATION) for note in notes)
    assert preparation() is None  # nothing is being built
    alone, reason = reference_drive.drive(robot, AnyPerturbation(), 3)
    assert reason == driven[0][1] == "" and (alone.array("wheel") == driven[0][0].array("wheel")).all()

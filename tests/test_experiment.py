"""The skeleton of experiments: which parts are run, what a run says of those that failed. Parts are made up; truth: the rules that
:class:`wbmpc.experiment.Scenario` states."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from pydantic import BaseModel

from wbmpc.errors import InputError
from wbmpc.experiment import Experiment, Outcome, Part, Run, Scenario, run_parts
from wbmpc.log import Log
from wbmpc.result import Metric, Plot
from wbmpc.simulation.lockstep import Ending

FELL, ENDED = Ending("the robot fell at 1.00 s", fell=True), Ending("interrupted at 1.00 s", interrupted=True)


class Settings(BaseModel):
    weight: float = 2.0


def planner(failures: int = 0) -> Any:
    """An MPC of 10 Hz after ten solves."""
    statistics = SimpleNamespace(solve_times=[0.001] * 10, solves=10, failures=failures, no_step=0)
    return SimpleNamespace(rate=10.0, statistics=statistics)


def scenario(*parts: tuple[str, Outcome, bool], compared: bool = False, record: bool = True) -> Scenario:
    log = Log()

    def run(name: str, outcome: Outcome) -> Any:
        def go(progress: Any) -> Outcome:
            if record:
                log.add(name or "alone", 0.0, 1.0)
            if progress is not None:
                progress(0.5, "half")
            return outcome

        return go

    made = [Part(name, run(name, outcome), baseline) for name, outcome, baseline in parts]
    metrics = lambda run: {"parts": Metric(float(len(run.outcomes)), "1")}
    return Scenario(log, made, metrics, lambda run: [Plot("drawn", "", "", [])], ["nothing is real"], compared)


def ran(*parts: tuple[str, Outcome, bool], compared: bool = False) -> tuple[list[str], str, list[str]]:
    run: Run = run_parts(scenario(*parts, compared=compared))
    return list(run.outcomes), run.ending.reason, run.faults


def test_parts_follow_each_other_until_one_fails() -> None:
    good, bad = Outcome(faults=["a wheel slips"]), Outcome(FELL)
    assert ran(("a", good, False), ("b", good, False)) == (["a", "b"], "", ["a: a wheel slips", "b: a wheel slips"])
    assert ran(("a", bad, False), ("b", good, False)) == (["a"], FELL.reason, [])
    assert ran(("", good, False)) == ([""], "", ["a wheel slips"])


def test_parts_that_are_compared_are_all_run_and_the_first_failure_names_its_part() -> None:
    later = Outcome(Ending("stopped at 2.00 s"))
    found = ran(("a", Outcome(FELL), False), ("b", later, False), ("c", Outcome(), False), compared=True)
    assert found == (["a", "b", "c"], f"a: {FELL.reason}", [])


@pytest.mark.parametrize("compared", [True, False])
def test_a_baseline_that_fails_is_a_fault_and_not_a_failure(compared: bool) -> None:
    names, reason, faults = ran(
        ("mpc", Outcome(), False), ("ik", Outcome(FELL), True), ("x", Outcome(), True), compared=compared
    )
    assert names == ["mpc", "ik", "x"] and not reason
    assert faults == [f"ik: {FELL.reason}; nothing is compared with it"]


def test_what_the_user_ends_is_the_end_of_all_also_in_a_baseline() -> None:
    run = run_parts(
        scenario(("a", Outcome(FELL), False), ("b", Outcome(ENDED), True), ("c", Outcome(), False), compared=True)
    )
    assert list(run.outcomes) == ["a", "b"] and run.ending.interrupted and run.ending.reason == f"b: {ENDED.reason}"
    assert run.faults == []


def result(made: Scenario, **given: Any) -> Any:
    return Experiment.of("fake", "", Settings, lambda settings, seed: made).run(Settings(), 7, **given)


def test_a_result_holds_what_was_measured_drawn_and_assumed() -> None:
    found = result(scenario(("a", Outcome(mpc=planner()), False), ("b", Outcome(), False)))
    assert (found.experiment, found.seed, found.completed, found.settings) == ("fake", 7, True, {"weight": 2.0})
    assert found.metrics["parts"].value == 2.0 and found.plots[0].title == "drawn" and found.mpc.solves == 10
    assert found.idealizations == ["nothing is real"] and found.log.channels == ["a", "b"]


def test_solves_are_those_of_the_last_part_that_has_some_and_too_many_that_fail_end_a_run() -> None:
    found = result(scenario(("a", Outcome(mpc=planner()), False), ("b", Outcome(mpc=planner(failures=2)), False)))
    assert not found.completed and found.mpc.failures == 2 and "20 % of the MPC's 10 solves" in found.reason
    assert result(scenario(("a", Outcome(), False))).mpc is None


def test_nothing_is_measured_of_a_run_without_a_record() -> None:
    found = result(scenario(("", Outcome(FELL), False), record=False))
    assert not found.completed and found.reason == FELL.reason and found.metrics == {} and found.plots == []


def test_the_progress_is_that_of_the_whole() -> None:
    shown: list[tuple[float, str]] = []
    result(scenario(("a", Outcome(), False), ("b", Outcome(), False)), progress=lambda *given: shown.append(given))
    assert shown == [(0.25, "a: half"), (0.75, "b: half"), (1.0, "")]


@pytest.mark.parametrize("name", ["", "../up", "a b", ".hidden", "a/b"])
def test_a_name_that_is_no_directory_s_is_an_error(name: str) -> None:
    with pytest.raises(InputError, match="valid in a name: letters"):
        Experiment.of(name, "", Settings, lambda settings, seed: scenario())

"""The page of a search. Truth: the trials and the definition that it is made of."""

from __future__ import annotations

from typing import Any

import pytest

from wbmpc.study.definition import Tuning
from wbmpc.study.tune_page import tune_page

TRIALS: list[dict[str, Any]] = [
    {"trial": k, "values": [3.0 - k, 1.5 + k], "feasible": k != 1, "pruned": False, "settings": {"gain": 10.0**k, "offset": 0.5 * k}}
    for k in range(3)
]  # fmt: skip


def tuning(**more: Any) -> Tuning:
    search = {"gain": {"from": 1, "to": 100, "log": True}, "offset": {"from": 0, "to": 1}}
    terms = [{"metric": "error", "limit": 5}, {"metric": "effort", "limit": 9, "maximize": True}]
    return Tuning.model_validate({"seeds": [0], "search": search, "minimize": terms, **more})


def test_objectives_have_names_and_axes_are_as_they_were_searched() -> None:
    pytest.importorskip("plotly")
    page = tune_page("t", tuning(pareto=True), TRIALS, [TRIALS[0]], False)
    assert "trial 0, error and effort, as large as possible: 3, 1.5." in page
    assert "<th class=n>error</th><th class=n>effort, as large as possible</th>" in page
    assert page.count('"type":"log"') == 2  # gain's alone, of each objective, though offset has values far apart too
    assert "effort, as large as possible against error" in page


def test_a_sum_is_one_objective() -> None:
    pytest.importorskip("plotly")
    summed = [{**t, "values": [sum(t["values"])]} for t in TRIALS]
    page = tune_page("t", tuning(), summed, [summed[0]], False)
    assert (
        "Best: trial 0, error + effort, as large as possible: 4.5." in page
        and " against " not in page.partition("<h1>")[2]
    )


def test_a_front_is_listed_and_no_trial_is_called_the_best() -> None:
    pytest.importorskip("plotly")
    front = [TRIALS[2], TRIALS[0]]
    page = tune_page("t", tuning(pareto=True), TRIALS, front, False).partition("<h1>")[2]
    assert "2 trials that none beats in every objective" in page and "Best" not in page and "best" not in page
    listed = page.partition("The front: 2 trials")[2].partition("Trials by")[0]
    assert [cell.partition("<")[0] for cell in listed.split("<tr><td class=n>")[1:]] == ["2", "0"]


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ({"constraints": {"tilt<": 0.3}}, "3 keep the constraints (tilt&lt; ≤ 0.3 and all runs complete)."),
        ({"constraints": {"a": 1, "b": 2}, "allow_failures": True}, "3 keep the constraints (a ≤ 1, b ≤ 2)."),
        ({}, "3 keep the constraints (all runs complete)."),
        ({"allow_failures": True}, "3 keep the constraints."),
    ],
)
def test_a_page_says_on_which_seeds_and_under_which_constraints(more: dict[str, Any], says: str) -> None:
    pytest.importorskip("plotly")
    trials = [{**t, "values": t["values"][:1], "feasible": True} for t in TRIALS]
    page = tune_page("t", tuning(**{"seeds": "4-6", **more}), trials, trials[:1], False)
    assert "3 trials on the seeds 4, 5, 6, which are not reported. 0 pruned" in page and says in page


def test_a_trial_that_breaks_constraints_does_not_flatten_the_others() -> None:
    """It counts as its limit, here a hundred times the others. Truth: the span of those that keep them, and 8 % around it."""
    pytest.importorskip("plotly")
    trials = [{**t, "values": [100.0 if k == 1 else 1.0 + k]} for k, t in enumerate(TRIALS)]
    page = tune_page("t", tuning(), trials, trials[:1], False)
    assert page.count('"range":[0.84,3.16]') == 3

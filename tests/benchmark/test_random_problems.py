"""A few seeds of the random round. Truth: IPOPT, which gets the L1 slacks as unknowns; a roll-out, which has no gaps."""

from __future__ import annotations

import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))

import random_problems
from ipopt_baseline import IpoptBaseline

from wbmpc.solver import Status


@pytest.mark.parametrize("seed", [2, 4])
def test_ours_is_ipopts(seed: int) -> None:
    drawn = random_problems.draw(seed)
    solver, ours = random_problems.attempt(drawn, drawn.settings)
    assert random_problems.outcome(ours, IpoptBaseline(solver, drawn.x0), drawn.x0)[0] == "same"


@pytest.mark.parametrize(
    "seed", [
        1204,  # beside a saddle: the KKT residual grew while the direction went on, and steps became short
        1169,  # the curvature of full steps opens gaps: the line search cut them until it failed
        1506,  # far from the solution the violation got a weight of 8e9, under which no step was accepted later
        1103,  # rk4: Gauss-Newton's error falls by 6 % per iteration, and there was no exact Hessian
    ],
)  # fmt: skip
def test_what_was_lost_is_solved(seed: int) -> None:
    """Within fewer iterations than the 300 at which these stopped."""
    drawn = random_problems.draw(seed)
    solver, ours = random_problems.attempt(drawn, replace(drawn.settings, iterations=250))
    assert ours.status in (Status.CONVERGED, Status.RELAXED), ours
    assert random_problems.outcome(ours, IpoptBaseline(solver, drawn.x0), drawn.x0)[0].startswith("same")


def test_slacks_that_have_not_settled_are_named() -> None:
    """Obstacles of structured problem 261: rows are met, slacks are not theirs. It said that nothing had settled."""
    drawn = random_problems.draw(261, "structured")
    _, ours = random_problems.attempt(drawn, replace(drawn.settings, iterations=60))
    assert ours.status is Status.ITERATION_LIMIT
    assert re.match(r"the slack of .*all\[\d\].* at node \d+ is off by .* slacks cut steps to", ours.detail), ours


def test_another_answer_is_reported() -> None:
    drawn = random_problems.draw(2)
    solver, ours = random_problems.attempt(drawn, drawn.settings)
    other = IpoptBaseline(solver, drawn.x0)
    moved = replace(ours, x=ours.x + 1e-3 * np.arange(len(ours.x))[:, None])
    assert random_problems.outcome(moved, other, drawn.x0)[0] == "ours violates"
    wrong = replace(ours, status=Status.RELAXED)
    assert random_problems.outcome(wrong, other, drawn.x0)[0] == "wrong about giving way"


def test_a_limit_of_state_and_input_with_a_slack_is_not_infeasible() -> None:
    """Of seed 3 a row of x and u has to give way; IPOPT's slack is as large."""
    drawn = random_problems.draw(3)
    solver, ours = random_problems.attempt(drawn, drawn.settings)
    assert ours.status is Status.RELAXED
    other = IpoptBaseline(solver, drawn.x0)
    assert other.solve(other.vector(ours.x, ours.u), near=False).slack > 0.1


def test_gaps_alone_are_not_infeasible() -> None:
    """Seed 1132 has limits of inputs alone."""
    drawn = random_problems.draw(1132)
    _, ours = random_problems.attempt(drawn, replace(drawn.settings, iterations=20))
    assert ours.status is Status.ITERATION_LIMIT and ours.detail.startswith("gaps of the dynamics"), ours


def test_short_steps_where_the_merit_drowns_in_rounding() -> None:
    """Seed 95 needs steps below 0.1 there: it did not end within 1000 iterations."""
    drawn = random_problems.draw(95)
    _, ours = random_problems.attempt(drawn, replace(drawn.settings, iterations=250))
    assert ours.status is Status.RELAXED


def test_a_round_of_which_none_converges_says_so(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its largest number of iterations was sought among none: IndexError."""
    attempt = random_problems.attempt
    monkeypatch.setattr(
        random_problems, "attempt", lambda drawn, settings: attempt(drawn, replace(settings, iterations=1))
    )
    random_problems.main(["--seeds", "95"])
    assert capsys.readouterr().out.endswith("none of ours converged\n")

"""Problems of the size of OCS2's published figures, beside those figures."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from wbmpc.benchmark.ours import ours
from wbmpc.benchmark.problems import race_problems, suite_bench


def size_race(repeat: int, note: Callable[[str], None]) -> list[dict[str, Any]]:
    """One row per problem."""
    rows = []
    for name, (make, milliseconds, goal) in race_problems().sizes.items():
        note(name)
        problem = suite_bench(make())
        t, figures = problem.solver.problem, ours(problem, repeat)[2]
        best = figures["iteration_ms"]
        rows.append(
            {
                "problem": problem.name,
                "nx": t.nx,
                "nu": t.nu,
                "intervals": t.ocp.intervals,
                "rows": t.equality.shape[0],
                "success": figures["success"],
                "iteration_ms": best,
                "ocs2_ms": milliseconds,
                "ratio": milliseconds / best,
                "goal": goal,
            }
        )
    return rows

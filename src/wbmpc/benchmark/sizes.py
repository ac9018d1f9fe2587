"""Problems of the size of OCS2's published figures, beside those figures."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from wbmpc.benchmark.ours import ours
from wbmpc.benchmark.problems import suite_bench
from wbmpc.benchmark.test_problems import MAKERS

#: Milliseconds of one SQP iteration of OCS2 (C++, one thread, quiet, on an AMD Zen 5) on problems of the same sizes, not
#: the same problems; and how many times faster we want to be.
OCS2 = {
    "ballbot": (0.62, 5.0),
    "differential-manipulator": (0.26, 5.0),
    "swerve-base": (3.1, 5.0),
    "swerve-arm": (4.7, 4.0),
}


def size_race(repeat: int, note: Callable[[str], None]) -> list[dict[str, Any]]:
    """One row per problem."""
    rows = []
    for name, (milliseconds, goal) in OCS2.items():
        note(name)
        problem = suite_bench(MAKERS[name]())
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

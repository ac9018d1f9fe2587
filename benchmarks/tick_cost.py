"""What ticks of an MPC cost after pushes and jumps of the goal, counted and timed: the distribution, and its worst.

Usage: python benchmarks/tick_cost.py [--robot rezero swerve arm] [--ticks 2000] [--extra 10 1 0]

The state follows the plan with noise. Every 40 ticks, in turn, the state is pushed (ball robot: its speed; swerve robot: its place; arm:
a joint) or the end effector's goal jumps. ``--extra``: values of ``max_extra_iterations`` to compare. Counts do not depend on the
machine: a direction is one linearization and factorization, a trial point one evaluation of cost and constraints.
"""

from __future__ import annotations

import argparse
import collections
from dataclasses import replace
from typing import Any

import numpy as np
from soak import MAKE, NOISE, PERIOD

from wbmpc.mpc.mpc import MPC
from wbmpc.ocp import Reference
from wbmpc.types import Observation

#: Ticks between two disturbances; jump of the end effector [m]; state that a push changes, and by how much.
EVERY, JUMP = 40, 0.1
PUSH = {"rezero": ("base_velocity", 0, 0.4), "swerve": ("base", 1, 0.05), "arm": ("arm", 1, 0.05)}


def disturb(name: str, mpc: MPC, x: np.ndarray, count: int, reference: Reference) -> None:
    """The disturbance number ``count``: pushes and jumps in turn, with changing signs."""
    sign = 1.0 if count % 4 < 2 else -1.0
    if count % 2 == 0:
        group, i, size = PUSH[name]
        x[mpc.ocp.dynamics.state[group].start + i] += sign * size
        return
    values = reference.values.copy()
    values[:, 1] += 0.5 * sign * JUMP
    mpc.reference["end_effector"] = replace(reference, values=values)


def run(name: str, ticks: int, extra: int) -> dict[str, Any]:
    """Costs of all ticks, and what was said of those beyond twice the median."""
    mpc = MAKE[name](ticks * PERIOD + 10.0)
    settings = mpc.solver.settings
    interior = replace(settings.interior_point, max_extra_iterations=extra)
    mpc.solver.settings = replace(settings, interior_point=interior)
    mpc.solver.numbers[:] = mpc.solver.settings.numbers()
    rng, plan = np.random.default_rng(0), mpc.solver.trajectory(copy=False)
    reference = mpc.reference["end_effector"]
    x, rows, said = plan.x[0].copy(), [], []
    for i in range(ticks):
        if i > EVERY and i % EVERY == 0:
            disturb(name, mpc, x, i // EVERY, reference)
        mpc.advance(Observation(i * PERIOD, x))
        rows.append((*mpc.solver.effort, 1e3 * mpc.solve_time))
        says = mpc.fault or ("a planned state is outside a limit" if mpc.solver.limit_violation else "")
        said.append(says.split(":")[0] or ("more than twice the iterations" if mpc.extended else ""))
        share = PERIOD / (plan.grid[1] - plan.grid[0])
        x = (1.0 - share) * plan.x[0] + share * plan.x[1] + NOISE * PERIOD * rng.normal(size=x.size)
    costs = np.array(rows)[1:]  # the first plan takes many calls
    slow = costs[:, 0] > 2.0 * np.median(costs[:, 0])
    listed = lambda chosen: ", ".join(f"{n} × {s or 'nothing'}" for s, n in collections.Counter(chosen).most_common())
    late = [s for s, is_slow in zip(said[1:], slow, strict=True) if is_slow]
    return {"costs": costs, "slow": int(slow.sum()), "slow say": listed(late), "all say": listed(said[1:])}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robot", nargs="*", default=list(MAKE), choices=list(MAKE))
    parser.add_argument("--ticks", type=int, default=2000)
    parser.add_argument("--extra", type=int, nargs="*", default=[10, 1, 0], help="values of max_extra_iterations")
    given = parser.parse_args()
    for name in given.robot:
        for extra in given.extra:
            found = run(name, given.ticks, extra)
            print(f"\n{name}, max_extra_iterations={extra}, {given.ticks} ticks, a disturbance every {EVERY}")
            for label, column in zip(("directions", "trial points", "time [ms]"), found["costs"].T, strict=True):
                shares = ", ".join(f"{q:g} %: {np.percentile(column, q):.3g}" for q in (50, 90, 99, 99.9, 100))
                print(f"  {label:13} {shares}")
            print(f"  plans say: {found['all say']}")
            print(
                f"  {found['slow']} ticks took more than twice the median; their plans say: {found['slow say'] or '–'}",
                flush=True,
            )


if __name__ == "__main__":
    main()

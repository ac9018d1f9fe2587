"""What an exported controller has in its memory to keep a robot's own parts apart."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from wbmpc.clearance.depth_step import Hull
from wbmpc.clearance.own_pairs import Parts, Places
from wbmpc.clearance.pairs_step import Gaps
from wbmpc.clearance.support_step import Solids
from wbmpc.embedded.keeps_clear import Guard
from wbmpc.mpc.braking import rate_limits, rated_states
from wbmpc.mpc.clearance import BARRIER_SHARE, BRAKING_SOLVES, FIRST_BARRIER
from wbmpc.mpc.mpc import MPC
from wbmpc.solver.memory_layout import ALIGN, GRID, GRID_BASE, GRID_OLD, N

_RECORDS: dict[str, Any] = {"parts": Parts, "places": Places, "solids": Solids, "gaps": Gaps, "hull": Hull}
#: What of these is written.
_WRITTEN = frozenset((*Places._fields, *Gaps._fields, *Hull._fields))


@dataclass(frozen=True)
class OwnParts:
    """As of :class:`wbmpc.embedded.image.Image`, by the names of :mod:`wbmpc.embedded.keeps_clear`'s records and their fields."""

    areas: dict[str, np.ndarray] = field(default_factory=dict)
    constants: dict[str, np.ndarray] = field(default_factory=dict)
    numbers: dict[str, int | float] = field(default_factory=dict)
    poses: ca.Function | None = None


def own_parts(mpc: MPC) -> OwnParts:
    """Of the one term of an MPC that keeps parts of its robot apart."""
    ((name, rows),) = mpc._clear.within.items()
    (n, nu), nx = mpc.solver.ws.u.shape, mpc.solver.ws.x.shape[1]
    arrays, counts = rows.own.memory(n + 1)
    found = OwnParts(poses=rows.own.poses)
    for record, kind in _RECORDS.items():
        for part in kind._fields:
            if part in arrays:
                (found.areas if part in _WRITTEN else found.constants)[f"{record}.{part}"] = _filled(arrays[part])
            elif part in counts:
                found.numbers[f"{record}.{part}"] = counts[part]
    zeros = lambda *shape: np.zeros(int(np.prod(shape)))
    guard = zeros(len(Guard))
    guard[Guard.STOPS_AT] = guard[Guard.SEARCH_AT] = np.inf
    areas = {
        "guard": guard, "own_states": arrays["states"], "parameters": arrays["parameters"], "work": arrays["work"],
        "grids": zeros(3, n + 1), "ahead": zeros(n + 1, nx), "stop_x": zeros(n + 1, nx), "stop_u": zeros(n, nu),
        "kept_x": zeros(n + 1, nx), "kept_u": zeros(n, nu), "active": zeros(nu), "state": zeros(nx),
        "tuned": zeros(len(mpc.solver.numbers)),
    }  # fmt: skip
    dynamics, robot = mpc.ocp.dynamics, rows.geometry.robot
    rates, sources = rate_limits(dynamics, robot)
    constants = {
        "margins": arrays["margins"], "of_a": arrays["of_a"], "of_b": arrays["of_b"], "above": arrays["above"],
        "grid_table": _grid_table(n, mpc.ocp.align_events), "rates": rates, "sources": sources,
        "state_of": rated_states(dynamics), "barriers": np.array([FIRST_BARRIER * BARRIER_SHARE**k for k in range(BRAKING_SOLVES)]),
    }  # fmt: skip
    numbers = {
        "reach": counts["reach"], "limited": len(rates), "slot": list(mpc.solver.problem.references.slices).index(name),
        "balances": int(robot.base.balances),
    }  # fmt: skip
    found.areas.update({f"w.{key}": _filled(value) for key, value in areas.items()})
    found.constants.update({f"w.{key}": _filled(value) for key, value in constants.items()})
    found.numbers.update({f"w.{key}": value for key, value in numbers.items()})
    return found


def _grid_table(n: int, aligned: bool) -> np.ndarray:
    """The entries of a solver's table that :func:`wbmpc.solver.receding.align` reads, for three grids in a row."""
    table = np.zeros(max(N, GRID, GRID_BASE, GRID_OLD, ALIGN) + 1, np.int64)
    table[[N, GRID_BASE, GRID_OLD, ALIGN]] = n, n + 1, 2 * (n + 1), int(aligned)
    return table


def _filled(values: np.ndarray) -> np.ndarray:
    """Flat, with one entry at least."""
    return np.ascontiguousarray(values).ravel() if values.size else np.zeros(1, dtype=values.dtype)

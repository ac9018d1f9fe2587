"""How far arm joints move a robot's own parts against each other, and what its slack has to cost for a pair to stay apart."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from wbmpc.arrays import Array
from wbmpc.clearance.rows import SelfRows
from wbmpc.obstacles.pairs import NEAR, draw_states
from wbmpc.ocp import Cost, OptimalControlProblem
from wbmpc.ocp.clearance_residuals import SelfClearance
from wbmpc.ocp.scaling import reach
from wbmpc.ocp.symbols import Symbols

#: Random states in which levers are looked at, and the share of those near each other that have a smaller one than what counts.
STATES, SMALL = 300, 0.1
#: Levers count as this share of the arm's reach at least.
LEAST = 0.05
#: Error [m] of the end effector up to which pairs are worth more than it is.
FARTHEST = 3.0


def levers(term: SelfClearance) -> Array:
    """By pair, how fast arm joints change its distance [m/rad, or m/m of slides; all joints together by the root of the sum of squares],
    where it is near in random states and at home; not a number for one that is near in none."""
    robot, rows, states = term.robot, SelfRows(term), draw_states(term.robot, STATES)
    parameters = rows.refresh(states)
    x, u, r = (ca.SX.sym(n, k) for n, k in (("x", robot.state.size), ("u", robot.input.size), ("r", term.reference)))
    none = ca.SX(0, 1)
    distance = replace(term, approach=0.0)(Symbols(x, u, none, none, r, x, u))
    slopes = ca.jacobian(distance, x)[:, robot.state["arm"]]
    lengths = ca.Function("lengths", [x, r], [ca.sqrt(ca.sum2(slopes**2))])
    found = np.array(lengths.map(len(states))(states.T, parameters.T)).reshape(term.size, -1)
    apart = rows.measure(states).T
    found[(apart > NEAR) | (apart < 0.0)] = np.nan
    known = np.isfinite(found).any(axis=1)
    result = np.full(term.size, np.nan)
    result[known] = np.nanquantile(found[known], SMALL, axis=1)
    return result


def prices(ocp: OptimalControlProblem, term: SelfClearance, least: float) -> tuple[float, ...]:
    """Of the rows' slacks [1/m, per second], no less than ``least``: more than what the cost "end_effector" (of a problem with a path:
    "contour") pulls joints with whose end effector is :data:`FARTHEST` from its goal. Weights that are raised later do not raise them.

    Joints that move parts against each other by little move the end effector by much: at one price for all pairs a goal a meter away
    presses those in each other that a joint turns beside its axis.
    """
    cost = ocp.terms.get("end_effector", ocp.terms.get("contour"))
    if not isinstance(cost, Cost) or not term.approach:
        return (least,) * term.size
    path, end = (
        float(cost.expand(w).max()) if at in cost.at else 0.0
        for at, w in (
            ("path", cost.weight),
            ("terminal", cost.weight if cost.terminal_weight is None else cost.terminal_weight),
        )
    )
    arm = reach(term.robot)
    ratio = arm / np.clip(np.nan_to_num(levers(term), nan=arm), LEAST * arm, arm)
    pull = FARTHEST * (path * ocp.horizon + end) / term.approach
    return tuple(np.maximum(pull * ratio, least).tolist())

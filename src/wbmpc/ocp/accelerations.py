"""Accelerations as inputs: a problem on speeds becomes one whose plans know their inertia.

Speeds of base and arm become states (:class:`wbmpc.model.augment.InputRate`). Equalities that then have no input left, as those that keep
wheels from slipping sideways, ġ + κ g = 0 takes the place of: it holds g where it is zero, and brings it back at the rate κ.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from wbmpc.arrays import Array
from wbmpc.bases.optional import HasAcceleration
from wbmpc.errors import InputError
from wbmpc.model.augment import InputRate
from wbmpc.model.robot import RobotModel
from wbmpc.ocp import sets
from wbmpc.ocp.norms import RelaxedBarrier
from wbmpc.ocp.problem import OptimalControlProblem
from wbmpc.ocp.residuals import AccelerationLimit, ProblemInput
from wbmpc.ocp.symbols import Symbols, Wrapping
from wbmpc.ocp.terms import Constraint, Cost

#: Rate κ [1/s] at which wheels that slip sideways in a plan come to roll, and softness of such rows. (With κ = 5 and 1e-4 plans slip by
#: several cm/s.)
RETURN_RATE, SOFTNESS = 20.0, 1e-5
#: Cost per second of an acceleration as large as its limit.
ACCELERATION_COST = 10.0
#: Of what accelerations may be, what plans use: arms that carry a payload have less torque left for it.
SHARES: Mapping[str, float] = {"base": 0.9, "arm": 0.4}


@dataclass(frozen=True)
class RateRows(Wrapping):
    """The rows of an equality ``inner``; of those that have no input of the problem while brakes are closed ġ + ``rate`` g [1/s], in the
    row's unit over a second; inputs behind open brakes count as constant."""

    dynamics: InputRate
    rate: float = RETURN_RATE

    def __call__(self, s: Symbols) -> ca.SX:
        rows = self.inner(s)
        rates = s.rate_of(rows, self.dynamics) + self.rate * rows
        # an input behind a closed brake is none
        braked = ca.substitute(rows, s.mode, ca.SX.zeros(s.mode.shape)) if s.mode.numel() else rows
        chosen = [rows[i] if ca.depends_on(braked[i], s.all_u) else rates[i] for i in range(rows.shape[0])]
        return ca.vertcat(*chosen)


def accelerations(robot: RobotModel, group: str) -> Array:
    """(n) [1/s²] how fast inputs of a group may change, infinite where nothing says it; of a base what its wheels allow."""
    limits = robot.limits
    rates = limits.input_rate[robot.input[group]]
    if group == "base" and not np.isfinite(rates).all() and isinstance(robot.base, HasAcceleration):
        return np.asarray(robot.base.acceleration(limits), float)
    return np.asarray(rates, float)


def with_accelerations(
    ocp: OptimalControlProblem, robot: RobotModel, shares: Mapping[str, float] = SHARES
) -> OptimalControlProblem:
    """The same problem with speeds of some groups of inputs as states and their accelerations as inputs, which cost a little and stay
    within ``shares`` of the robot's limits, by group; ``ocp`` is left as it is.

    ``dynamics`` of the result is an :class:`wbmpc.model.augment.InputRate` of those of ``ocp``, which must be the robot's own. Costs and
    inequalities go on as they are; limits that come from the last command (:class:`wbmpc.residuals.AccelerationLimit`) go on for the other
    groups, but for wheels, which roll with the base. Raises :class:`InputError` for other dynamics, and for groups that do not exist.
    """
    own = ocp.dynamics
    if (own.state.names, own.input.names) != (robot.state.names, robot.input.names):
        raise InputError("accelerations: a problem on the robot's own dynamics (robot.dynamics()) is needed")
    dynamics = InputRate(own, tuple(shares))
    wrapped = ocp.on(dynamics)
    for term in ocp.terms.values():
        if isinstance(term, Constraint) and term.equality:
            softness = max(term.softness, SOFTNESS)
            wrapped.add(replace(term, residual=RateRows(term.residual, dynamics), softness=softness))
        elif isinstance(term, Constraint) and isinstance(term.residual, AccelerationLimit):
            rest = [g for g in term.residual.names if g not in shares and g not in robot.base.rolling_groups]
            if rest:
                kept = AccelerationLimit(robot, rest, term.residual.share)
                wrapped.add(replace(term, name="other accelerations", residual=kept))
        else:
            wrapped.add(term)
    _limit(wrapped, robot, dynamics, shares)
    return wrapped


def _limit(ocp: OptimalControlProblem, robot: RobotModel, dynamics: InputRate, shares: Mapping[str, float]) -> None:
    limits = np.concatenate([share * accelerations(robot, group) for group, share in shares.items()])
    rows = ProblemInput(dynamics, [f"{group}_rate" for group in dynamics.groups])
    typical = np.where(np.isfinite(limits), limits, 10.0)
    ocp.add(Cost("acceleration", rows, list(ACCELERATION_COST / typical**2)))
    box = sets.Box(-limits, limits)
    ocp.add(Constraint("accelerations", rows, box, penalty=RelaxedBarrier(3e-3, 0.02), hard=True))

"""From an optimal control problem to stage functions on SX.

Per node there are two parameter vectors. ``p`` changes along the horizon: the terms' references, the model's mode
values, and a switch (0 or 1) for every term that counts in some modes only. ``w`` is constant over the horizon: the
model's parameters and all weights, so that weights change without a new compilation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import cast

import casadi as ca
import numpy as np

from wbmpc.errors import InputError, unknown_name
from wbmpc.ocp.constraint_classification import (
    BoxRow,
    RowGroup,
    depends,
    equality_rows,
    inequality_rows,
    missed,
    nonlinear_equalities,
    nonlinear_in_inputs,
)
from wbmpc.ocp.derivatives import stage_derivatives
from wbmpc.ocp.input_rows import InputPlanes, input_bounds, input_planes, nonlinear_rows
from wbmpc.ocp.norms import AugmentedLagrangian, RelaxedBarrier
from wbmpc.ocp.problem import OptimalControlProblem
from wbmpc.ocp.residuals import Symbols
from wbmpc.ocp.schedule import DEFAULT, ModeSchedule
from wbmpc.ocp.terms import Constraint, Cost


@dataclass(frozen=True)
class _Slots:
    """Slices of a parameter vector."""

    slices: Mapping[str, slice]
    size: int

    @classmethod
    def of(cls, sizes: Mapping[str, int]) -> _Slots:
        slices, start = {}, 0
        for name, size in sizes.items():
            slices[name] = slice(start, start + size)
            start += size
        return cls(slices, start)


#: Equality rows of more than this softness are variables of their own in the line search.
MIN_SOFTNESS = 1e-5


class Transcription:
    """Stage functions of a problem and the meaning of their parameter vectors."""

    def __init__(self, ocp: OptimalControlProblem, exact: bool = False) -> None:
        """``exact``: second derivatives too, for an exact Hessian of the Lagrangian."""
        self.ocp, self.exact = ocp, exact
        d = ocp.dynamics
        self.nx, self.nu = d.state.size, d.input.size
        if self.nx == 0 or self.nu == 0:
            raise InputError(f"dynamics: a state and an input are needed, got {self.nx} states and {self.nu} inputs")
        self.references = _Slots.of({t.name: t.residual.reference for t in ocp.terms.values() if t.residual.reference})
        self.switched = [t.name for t in ocp.terms.values() if t.modes is not None]
        self.node = _Slots.of(
            {
                **{f"reference.{k}": v.stop - v.start for k, v in self.references.slices.items()},
                "mode": d.mode.size,
                "switch": len(self.switched),
            }
        )
        self.constant = _Slots.of(
            {
                "parameters": d.parameters.size,
                **{f"path.{c.name}": c.residual.size for c in ocp.costs if c.at != "terminal"},
                **{f"terminal.{c.name}": c.residual.size for c in ocp.costs if c.at != "path"},
            }
        )
        self.x, self.u = ca.SX.sym("x", self.nx), ca.SX.sym("u", self.nu)
        self.p, self.w = ca.SX.sym("p", self.node.size), ca.SX.sym("w", self.constant.size)
        self.h = ca.SX.sym("h")
        self.z = ca.vertcat(self.x, self.u)
        self.path, self.end = RowGroup(), RowGroup()
        self._residuals: dict[str, tuple[Cost | Constraint, ca.SX]] = {}
        sort = lambda terms: [(t, self.residual(t), self._switch(t.name)) for t in terms]
        inequalities = sort(ocp.inequalities)
        self.equalities = equality_rows(sort(ocp.equalities), inequalities, self.x, self.u, self.path, self.end)
        inequality_rows(inequalities, self.x, self.u, self.path, self.end)
        #: whether hard rows are nonlinear in the inputs: those of a circle are, bounds and planes are not
        self.nonlinear_input_rows = nonlinear_in_inputs(self.path, self.u)
        #: whether any equality is soft
        self.soft_equalities = bool((self.softness > MIN_SOFTNESS).any())
        #: whether equalities, or rows with multipliers, have second derivatives by the inputs
        self.nonlinear_equalities = not exact and nonlinear_equalities(self.equality, self.path, self.u)

    # ------------------------------------------------------------------ parameters
    def default_weights(self) -> np.ndarray:
        """The vector ``w`` with the weights as the terms state them and the model's parameters at zero."""
        w = np.zeros(self.constant.size)
        for cost in self.ocp.costs:
            if cost.at != "terminal":
                w[self.constant.slices[f"path.{cost.name}"]] = cost.expand(cost.weight)
            if cost.at != "path":
                end = cost.weight if cost.terminal_weight is None else cost.terminal_weight
                w[self.constant.slices[f"terminal.{cost.name}"]] = cost.expand(end)
        return w

    def mode_tables(self, schedule: ModeSchedule) -> np.ndarray:
        """One row of [mode values, switches] per mode of the schedule."""
        rows = []
        for mode in schedule.modes:
            values = self.ocp.dynamics.mode.vector(mode.values)
            names = [self.ocp.terms[t].modes or () for t in self.switched]
            rows.append(np.concatenate([values, [float(mode.name in n) for n in names]]))
        return np.array(rows).reshape(len(schedule.modes), -1)

    def check_schedule(self, schedule: ModeSchedule) -> None:
        """Raise :class:`InputError` for mode values out of range, or a mode that a term names and no schedule has: one that is
        neither among the problem's ``modes`` nor, if it has none, in this schedule."""
        declared, used = self.ocp.modes, list(dict.fromkeys(mode.name for mode in schedule.modes))
        for name in used if declared and schedule is not DEFAULT else ():
            if name not in declared:
                raise unknown_name("mode", name, declared, where="mode schedule")
        unset = " (no mode schedule is set)" if schedule is DEFAULT else ""
        for term in (self.ocp.terms[t] for t in self.switched):
            for name in term.modes or ():
                if name not in (declared or used):
                    raise unknown_name("mode", name, declared or used, where=f"term '{term.name}', modes{unset}")
        bounds = getattr(self.ocp.dynamics, "mode_bounds", {})
        for mode, (group, (low, high)) in product(schedule.modes, bounds.items()):
            values = np.atleast_1d(np.asarray(mode.values.get(group, low), float))
            if np.any((values < low) | (values > high)):
                raise InputError(
                    f"mode '{mode.name}': values of '{group}' must be from {low:g} to {high:g}, got {values}"
                )

    def symbols(self, name: str) -> Symbols:
        d = self.ocp.dynamics
        reference = self.node.slices.get(f"reference.{name}", slice(0, 0))
        parameters = self.w[self.constant.slices["parameters"]] if d.parameters.size else ca.SX(0, 1)
        view = getattr(d, "view", lambda x, u: (x, u))
        x, u = view(self.x, self.u)
        return Symbols(x, u, parameters, self._mode(), self.p[reference], self.x, self.u)

    def _mode(self) -> ca.SX:
        return self.p[self.node.slices["mode"]]

    def _switch(self, name: str) -> ca.SX | float:
        if name not in self.switched:
            return 1.0
        return self.p[self.node.slices["switch"].start + self.switched.index(name)]

    # ------------------------------------------------------------------ terms
    def residual(self, term: Cost | Constraint) -> ca.SX:
        """The term's residual in the problem's symbols, (rows, 1)."""
        if self._residuals.get(term.name, (None,))[0] is not term:
            self._residuals[term.name] = term, self._expressed(term)
        return self._residuals[term.name][1]

    def _expressed(self, term: Cost | Constraint) -> ca.SX:
        r = ca.SX(term.residual(self.symbols(term.name)))
        if r.shape != (term.residual.size, 1):
            raise InputError(
                f"term '{term.name}': its residual has shape {r.shape}, its size says {term.residual.size}"
            )
        return r

    @property
    def path_boxes(self) -> list[BoxRow]:
        """Relaxed barriers on single variables along the path."""
        return self.path.barriers

    @property
    def terminal_boxes(self) -> list[BoxRow]:
        """Relaxed barriers on single states at the end."""
        return self.end.barriers

    def input_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """(lower, upper) (nu): bounds of single inputs by hard constraints of all modes; infinite where there is none."""
        return input_bounds(self.path, self.x, self.u)

    def input_planes(self) -> InputPlanes:
        """Straight hard rows of inputs alone beyond those bounds: of several inputs, and of single ones in some modes only or
        around a reference."""
        return input_planes(self.path, self.x, self.u, self.p, self.w, self._switch_symbols())

    def unclipped_input_rows(self) -> list[str]:
        """Names of hard rows of inputs alone that are not among those bounds and rows."""
        return nonlinear_rows(self.path, self.x, self.u, self.p, self.w, self._switch_symbols())

    def _switch_symbols(self) -> list[ca.SX]:
        """The elements of p that switch terms with modes."""
        switch = self.node.slices["switch"]
        return [self.p[i] for i in range(switch.start, switch.stop)]

    def with_input(self, term: Constraint) -> np.ndarray:
        """For every row of a term, whether it depends on the input."""
        return depends(self.residual(term), self.u)

    def with_state(self, term: Constraint) -> np.ndarray:
        """The same of the state."""
        return depends(self.residual(term), self.x)

    def broken(self, term: Constraint) -> ca.SX:
        """How far every row of a constraint is from being met, in the residual's unit; 0 in modes where it does not count."""
        return self._switch(term.name) * ca.fabs(missed(term, self.residual(term)))

    @property
    def rates(self) -> ca.SX:
        """ẋ, (nx, 1)."""
        return self.linearized[0]

    def term_values(self, stage: str) -> dict[str, ca.SX]:
        """The weighted value of every cost, and the residual of every constraint, at ``stage`` (path or terminal)."""
        at = (stage, "path+terminal")
        out = {t.name: self.residual(t) for t in self.ocp.terms.values() if isinstance(t, Constraint) and t.at in at}
        for cost in self.ocp.costs:
            if cost.at in at:
                weight = self.w[self.constant.slices[f"{stage}.{cost.name}"]] * self._switch(cost.name)
                out[cost.name] = weight * cost.norm.value(self.residual(cost))
        return out

    def pieces(self, stage: str) -> list[tuple[ca.SX, ca.SX, ca.SX, ca.SX]]:
        """(residual, value, gradient by the residual, curvature) of every cost and general barrier at ``stage``."""
        out = []
        for cost in self.ocp.costs:
            if cost.at not in (stage, "path+terminal"):
                continue
            weight = self.w[self.constant.slices[f"{stage}.{cost.name}"]] * self._switch(cost.name)
            r, norm = self.residual(cost), cost.norm
            if stage == "terminal" and ca.depends_on(r, self.u):
                raise InputError(
                    f"cost '{cost.name}', at: its residual depends on the input, which ends before the horizon does; valid: path"
                )
            out.append((r, weight * norm.value(r), weight * norm.gradient(r), weight * norm.curvature(r)))
        for term, h in (self.path if stage == "path" else self.end).general_barriers:
            switch, b = self._switch(term.name), cast(RelaxedBarrier, term.penalty)
            out.append((h, switch * b.value(h), switch * b.gradient(h), switch * b.curvature(h)))
        return out

    def value(self, stage: str) -> ca.SX:
        """The cost at ``stage``, with general barriers."""
        return sum((ca.sum1(v) for _, v, _, _ in self.pieces(stage)), ca.SX(0))

    # ------------------------------------------------------------------ stage functions
    @cached_property
    def linearized(self) -> tuple[ca.SX, ca.SX]:
        """ẋ (nx, 1) and its derivatives by z."""
        parameters = self.symbols("").parameters
        f, jacobian = self.ocp.dynamics.jacobian(self.x, self.u, parameters, self._mode())
        return ca.SX(f), ca.SX(jacobian)

    @property
    def equality(self) -> ca.SX:
        """The rows of the Riccati recursion, (ng, 1)."""
        return self.equalities.expression

    @property
    def softness(self) -> np.ndarray:
        """Softness of every row of the Riccati recursion."""
        return self.equalities.softness

    def equality_names(self) -> list[str]:
        """A name for every row of the Riccati recursion: term.group[i]."""
        return self.equalities.names

    @cached_property
    def jump(self) -> ca.SX:
        """The state after an event, in terms of the state before it and the new mode."""
        jump = getattr(self.ocp.dynamics, "jump", None)
        return self.x if jump is None else ca.SX(jump(self.x, self.symbols("").parameters, self._mode()))

    @property
    def jumps(self) -> bool:
        """Whether the state changes at events."""
        return getattr(self.ocp.dynamics, "jump", None) is not None

    @cached_property
    def values(self) -> dict[str, ca.Function]:
        """Functions without derivatives: what identifies the problem, and what the line search evaluates."""
        args, end = [self.x, self.u, self.p, self.w], [self.x, self.p, self.w]
        f = self.ocp.dynamics(self.x, self.u, self.symbols("").parameters, self._mode())
        make = lambda name, inputs, out: ca.Function(name, inputs, ca.cse([ca.densify(ca.SX(out))]))
        return {
            "dynamics": make("dynamics", args, f), "cost": make("cost", args, self.value("path")),
            "equality": make("equality", args, self.equality), "rows": make("rows", args, self.path.expression()),
            "terminal": make("terminal", end, self.value("terminal")),
            "end_rows": make("end_rows", end, self.end.expression()), "jump": make("jump", end, self.jump),
        }  # fmt: skip

    @cached_property
    def derivatives(self) -> dict[str, ca.Function]:
        """See :func:`wbmpc.ocp.derivatives.stage_derivatives`."""
        return stage_derivatives(self)

    def bent_terms(self) -> set[str]:
        """Names of the equalities, and of constraints with multipliers, that have second derivatives by the inputs."""
        own = [t for t in self.ocp.terms.values() if isinstance(t, Constraint) and not t.hard]
        own = [t for t in own if t.equality or isinstance(t.penalty, AugmentedLagrangian)]
        return {t.name for t in own if nonlinear_equalities(self.residual(t), RowGroup(), self.u)}

    @property
    def second(self) -> bool:
        """Whether there are second derivatives at all."""
        return self.exact or self.nonlinear_input_rows or self.nonlinear_equalities

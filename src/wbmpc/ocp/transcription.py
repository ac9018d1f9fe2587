"""From an optimal control problem to stage functions on SX.

:class:`Transcription` has the symbols and expressions of a problem. What is made of them stands by its purpose: values of the
parameter vectors in ``parameters.py``, costs in ``stage_costs.py``, derivatives in ``derivatives.py``, rows of single terms in
``term_rows.py``, what hard rows allow the inputs in ``input_rows.py``.

Per node there are two parameter vectors. ``p`` changes along the horizon: the terms' references, the model's mode
values, and a switch (0 or 1) for every term that counts in some modes only. ``w`` is constant over the horizon: the
model's parameters and all weights, so that weights change without a new compilation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from wbmpc.errors import InputError
from wbmpc.ocp.constraint_classification import (
    RowGroup,
    equality_rows,
    inequality_rows,
    nonlinear_equalities,
    nonlinear_in_inputs,
)
from wbmpc.ocp.derivatives import stage_derivatives
from wbmpc.ocp.problem import OptimalControlProblem
from wbmpc.ocp.residuals import Symbols
from wbmpc.ocp.stage_costs import stage_cost
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
        sort = lambda terms: [(t, self.residual(t), self.switch(t.name)) for t in terms]
        inequalities = sort(ocp.inequalities)
        self.equalities = equality_rows(sort(ocp.equalities), inequalities, self.x, self.u, self.path, self.end)
        inequality_rows(inequalities, self.x, self.u, self.path, self.end)
        #: whether hard rows are nonlinear in the inputs: those of a circle are, bounds and planes are not
        self.nonlinear_input_rows = nonlinear_in_inputs(self.path, self.u)
        #: whether any equality is soft
        self.soft_equalities = bool((self.softness > MIN_SOFTNESS).any())
        #: whether equalities, or rows with multipliers, have second derivatives by the inputs
        self.nonlinear_equalities = not exact and nonlinear_equalities(self.equality, self.path, self.u)

    def symbols(self, name: str) -> Symbols:
        """What the residual of the term ``name`` may use."""
        d = self.ocp.dynamics
        reference = self.node.slices.get(f"reference.{name}", slice(0, 0))
        parameters = self.w[self.constant.slices["parameters"]] if d.parameters.size else ca.SX(0, 1)
        view = getattr(d, "view", lambda x, u: (x, u))
        x, u = view(self.x, self.u)
        return Symbols(x, u, parameters, self.mode, self.p[reference], self.x, self.u)

    @property
    def mode(self) -> ca.SX:
        """The model's mode values, elements of p."""
        return self.p[self.node.slices["mode"]]

    @property
    def switches(self) -> list[ca.SX]:
        """The elements of p that switch the terms with modes, in the order of ``switched``."""
        part = self.node.slices["switch"]
        return [self.p[i] for i in range(part.start, part.stop)]

    def switch(self, name: str) -> ca.SX | float:
        """1 in modes in which a term counts, and 0 in others."""
        return self.switches[self.switched.index(name)] if name in self.switched else 1.0

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
    def rates(self) -> ca.SX:
        """ẋ, (nx, 1)."""
        return self.linearized[0]

    @cached_property
    def linearized(self) -> tuple[ca.SX, ca.SX]:
        """ẋ (nx, 1) and its derivatives by z."""
        parameters = self.symbols("").parameters
        f, jacobian = self.ocp.dynamics.jacobian(self.x, self.u, parameters, self.mode)
        return ca.SX(f), ca.SX(jacobian)

    @property
    def equality(self) -> ca.SX:
        """The rows of the Riccati recursion, (ng, 1)."""
        return self.equalities.expression

    @property
    def softness(self) -> np.ndarray:
        """Softness of every row of the Riccati recursion."""
        return self.equalities.softness

    @cached_property
    def jump(self) -> ca.SX:
        """The state after an event, in terms of the state before it and the new mode."""
        jump = getattr(self.ocp.dynamics, "jump", None)
        return self.x if jump is None else ca.SX(jump(self.x, self.symbols("").parameters, self.mode))

    @property
    def jumps(self) -> bool:
        """Whether the state changes at events."""
        return getattr(self.ocp.dynamics, "jump", None) is not None

    @cached_property
    def values(self) -> dict[str, ca.Function]:
        """Functions without derivatives: what identifies the problem, and what the line search evaluates."""
        args, end = [self.x, self.u, self.p, self.w], [self.x, self.p, self.w]
        f = self.ocp.dynamics(self.x, self.u, self.symbols("").parameters, self.mode)
        make = lambda name, inputs, out: ca.Function(name, inputs, ca.cse([ca.densify(ca.SX(out))]))
        return {
            "dynamics": make("dynamics", args, f), "cost": make("cost", args, stage_cost(self, "path")),
            "equality": make("equality", args, self.equality), "rows": make("rows", args, self.path.expression()),
            "terminal": make("terminal", end, stage_cost(self, "terminal")),
            "end_rows": make("end_rows", end, self.end.expression()), "jump": make("jump", end, self.jump),
        }  # fmt: skip

    @cached_property
    def derivatives(self) -> dict[str, ca.Function]:
        """See :func:`wbmpc.ocp.derivatives.stage_derivatives`."""
        return stage_derivatives(self)

    @property
    def second(self) -> bool:
        """Whether there are second derivatives at all."""
        return self.exact or self.nonlinear_input_rows or self.nonlinear_equalities

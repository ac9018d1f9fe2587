"""From an optimal control problem to stage functions on SX.

Per node there are two parameter vectors. ``p`` changes along the horizon: the terms' references, the model's mode
values, and a switch (0 or 1) for every term that counts in some modes only. ``w`` is constant over the horizon: the
model's parameters and all weights, so that weights change without a new compilation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from wbmpc.errors import InputError
from wbmpc.ocp.norms import RelaxedBarrier
from wbmpc.ocp.problem import OptimalControlProblem
from wbmpc.ocp.residuals import Symbols
from wbmpc.ocp.schedule import ModeSchedule
from wbmpc.ocp.sets import Box, NonNegative
from wbmpc.ocp.terms import Constraint, Cost

#: Node row of a box: (index into [x; u], sign s, offset c, μ, δ) for the relaxed barrier on h = s z + c.
BoxRow = tuple[int, float, float, float, float]


@dataclass(frozen=True)
class _Slots:
    """Places in a parameter vector."""

    slices: Mapping[str, slice]
    size: int

    @classmethod
    def of(cls, sizes: Mapping[str, int]) -> _Slots:
        slices, start = {}, 0
        for name, size in sizes.items():
            slices[name] = slice(start, start + size)
            start += size
        return cls(slices, start)


class Transcription:
    """Stage functions of a problem and the meaning of their parameter vectors."""

    def __init__(self, ocp: OptimalControlProblem) -> None:
        self.ocp = ocp
        d = ocp.dynamics
        self.nx, self.nu = d.state.size, d.input.size
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
        self.path_boxes, self.terminal_boxes, self._general = self._sort_inequalities()

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
    def _residual(self, term: Cost | Constraint) -> ca.SX:
        r = ca.SX(term.residual(self.symbols(term.name)))
        if r.shape != (term.residual.size, 1):
            raise InputError(
                f"term '{term.name}': its residual has shape {r.shape}, its size says {term.residual.size}"
            )
        return r

    def _rows(self, term: Constraint) -> tuple[ca.SX, np.ndarray, np.ndarray]:
        """An inequality as h = s r + c ≥ 0: residual, and arrays of (row, sign) and offset."""
        r = self._residual(term)
        if isinstance(term.set, NonNegative):
            return r, np.array([(i, 1.0) for i in range(r.shape[0])]), np.zeros(r.shape[0])
        assert isinstance(term.set, Box)
        lower, upper = term.set.bounds(r.shape[0])
        if np.any(lower > upper):
            raise InputError(f"constraint '{term.name}': a lower bound is above its upper bound")
        rows = [(i, 1.0) for i in np.flatnonzero(np.isfinite(lower))]
        rows += [(i, -1.0) for i in np.flatnonzero(np.isfinite(upper))]
        offsets = [-lower[i] if s > 0 else upper[i] for i, s in rows]
        return r, np.array(rows).reshape(-1, 2), np.array(offsets)

    def _sort_inequalities(self) -> tuple[list[BoxRow], list[BoxRow], list[tuple[Constraint, ca.SX]]]:
        """Bounds on single states and inputs become box rows of the kernel; the rest stays symbolic."""
        path: list[BoxRow] = []
        terminal: list[BoxRow] = []
        general: list[tuple[Constraint, ca.SX]] = []
        for term in self.ocp.inequalities:
            r, rows, offsets = self._rows(term)
            selection = None if term.modes is not None else _selection(r, self.z)
            if selection is None:
                h = ca.vertcat(*[s * r[int(i)] + c for (i, s), c in zip(rows, offsets, strict=True)])
                general.append((term, h))
                continue
            for (i, s), c in zip(rows, offsets, strict=True):
                index, scale, shift = selection[int(i)]
                box = (index, s * scale, c + s * shift, term.penalty.mu, term.penalty.delta)
                if term.at != "terminal":
                    path.append(box)
                if term.at != "path" and index < self.nx:
                    terminal.append(box)
        order = lambda b: (b[3], b[0])
        return sorted(path, key=order), sorted(terminal, key=order), general

    def _pieces(self, place: str) -> list[tuple[ca.SX, ca.SX, ca.SX, ca.SX]]:
        """(residual, value, gradient by the residual, curvature) of every cost and general barrier at ``place``."""
        out = []
        for cost in self.ocp.costs:
            if cost.at not in (place, "all"):
                continue
            weight = self.w[self.constant.slices[f"{place}.{cost.name}"]] * self._switch(cost.name)
            r, norm = self._residual(cost), cost.norm
            out.append((r, weight * norm.value(r), weight * norm.gradient(r), weight * norm.curvature(r)))
        for term, h in self._general:
            if term.at in (place, "all"):
                switch, b = self._switch(term.name), term.penalty
                out.append((h, switch * b.value(h), switch * b.gradient(h), switch * b.curvature(h)))
        return out

    def _value(self, place: str) -> ca.SX:
        return sum((ca.sum1(v) for _, v, _, _ in self._pieces(place)), ca.SX(0))

    def _quadratic(self, place: str, z: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Value, gradient and Gauss-Newton Hessian (upper triangle with a full diagonal) by z."""
        n = z.shape[0]
        value, gradient, hessian = ca.SX(0), ca.SX(n, 1), ca.SX(n, n)
        for r, v, g, c in self._pieces(place):
            jacobian = ca.jacobian(r, z)
            value += ca.sum1(v)
            gradient += jacobian.T @ g
            hessian += jacobian.T @ (ca.repmat(c, 1, n) * jacobian)
        structural = ca.SX(ca.Sparsity.diag(n), ca.SX.zeros(n))
        return value, ca.densify(gradient), ca.triu(hessian) + structural

    # ------------------------------------------------------------------ stage functions
    @cached_property
    def _f(self) -> tuple[ca.SX, ca.SX]:
        parameters = self.symbols("").parameters
        f, jacobian = self.ocp.dynamics.jacobian(self.x, self.u, parameters, self._mode())
        return ca.SX(f), ca.SX(jacobian)

    @cached_property
    def equality(self) -> ca.SX:
        """All state-input equality rows, (ng, 1)."""
        parts = [self._switch(t.name) * self._residual(t) for t in self.ocp.equalities]
        return ca.vertcat(*parts) if parts else ca.SX(0, 1)

    @property
    def compliance(self) -> np.ndarray:
        """Compliance of every equality row."""
        parts = [np.full(t.residual.size, t.compliance) for t in self.ocp.equalities]
        return np.concatenate(parts) if parts else np.zeros(0)

    def equality_names(self) -> list[str]:
        """A name for every equality row: term.group[i]."""
        names = []
        for term in self.ocp.equalities:
            rows = [""] * term.residual.size
            for group, part in term.residual.groups.items():
                for i, row in enumerate(range(part.start, part.stop)):
                    rows[row] = f"{term.name}.{group}[{i}]"
            names += rows
        return names

    @cached_property
    def values(self) -> dict[str, ca.Function]:
        """Functions without derivatives: what identifies the problem, and what the line search evaluates."""
        args = [self.x, self.u, self.p, self.w]
        f = self.ocp.dynamics(self.x, self.u, self.symbols("").parameters, self._mode())
        make = lambda name, inputs, out: ca.Function(name, inputs, ca.cse([ca.densify(ca.SX(out))]))
        return {
            "dynamics": make("dynamics", args, f),
            "cost": make("cost", args, self._value("path")),
            "equality": make("equality", args, self.equality),
            "terminal": make("terminal", [self.x, self.p, self.w], self._value("terminal")),
        }

    @cached_property
    def derivatives(self) -> dict[str, ca.Function]:
        """Functions with derivatives. Path costs come multiplied by the interval h [s]."""
        args = [self.x, self.u, self.p, self.w]
        f, jacobian = self._f
        value, gradient, hessian = self._quadratic("path", self.z)
        end = self._quadratic("terminal", self.x)
        rows = self.equality
        make: Any = lambda name, inputs, out: ca.Function(name, inputs, [ca.SX(e) for e in ca.cse(out)])
        h = self.h
        return {
            "dynamics_jacobian": make("dynamics_jacobian", args, [ca.densify(f), jacobian]),
            "cost_quadratic": make("cost_quadratic", [*args, h], [h * value, h * gradient, h * hessian]),
            "equality_jacobian": make("equality_jacobian", args, [ca.densify(rows), ca.jacobian(rows, self.z)]),
            "terminal_quadratic": make("terminal_quadratic", [self.x, self.p, self.w], list(end)),
        }


def _selection(r: ca.SX, z: ca.SX) -> list[tuple[int, float, float]] | None:
    """(index, scale, offset) of every row if each is an affine function of one state or input, else None."""
    jacobian = ca.jacobian(r, z)
    if ca.symvar(jacobian):
        return None
    dense = np.array(ca.DM(ca.densify(jacobian)))
    if np.any((dense != 0.0).sum(axis=1) != 1):
        return None
    offset = ca.substitute(r, z, ca.DM.zeros(z.shape[0]))
    if ca.symvar(offset):
        return None
    shift = np.array(ca.DM(ca.densify(offset))).ravel()
    index = np.argmax(dense != 0.0, axis=1)
    return [(int(i), float(dense[k, i]), float(shift[k])) for k, i in enumerate(index)]


__all__ = ["BoxRow", "RelaxedBarrier", "Transcription"]

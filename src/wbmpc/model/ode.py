"""A system of your own: ẋ = f(x, u) from a function on CasADi SX, with named states and inputs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import casadi as ca

from wbmpc.errors import InputError
from wbmpc.model.layout import Layout

Groups = Mapping[str, Sequence[str]]
#: Units by group: one text for all of its components, or one for each.
Units = Mapping[str, str | Sequence[str]]


class Ode:
    """Dynamics for :class:`wbmpc.ocp.OptimalControlProblem` from ``f(x, u)``, or ``f(x, u, w, m)`` with parameters or modes.

    ``state`` and ``inputs``: names of the components by group, in the order of x (nx) and u (nu); ``parameters`` w hold over
    the horizon, ``mode`` values m come from the mode schedule.
    ``state_units`` and ``input_units``: units by group, one text for all of its components or one for each, for plots and logs.
    As attributes all four are layouts, that of u is ``input``. f returns ẋ (nx), in the units of x per second.
    Raises :class:`InputError` if it returns another number of rows.
    """

    unit_quaternions: tuple[int, ...] = ()

    def __init__(
        self, state: Groups, inputs: Groups, f: Callable[..., ca.SX], *, parameters: Groups | None = None,
        mode: Groups | None = None, state_units: Units | None = None, input_units: Units | None = None,
    ) -> None:  # fmt: skip
        self.state, self.input = Layout(state, state_units), Layout(inputs, input_units)
        self.parameters, self.mode = Layout(parameters or {}), Layout(mode or {})
        self.f = f

    def __call__(self, x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> ca.SX:
        """ẋ (nx)."""
        more = (w, m) if self.parameters.size or self.mode.size else ()
        rate = ca.SX(self.f(x, u, *more))
        if rate.shape != (self.state.size, 1):
            raise InputError(f"equations: {self.state.size} rows are needed, f gives {rate.shape[0]} x {rate.shape[1]}")
        return rate

    def jacobian(self, x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> tuple[ca.SX, ca.SX]:
        """ẋ and its Jacobian (nx, nx + nu) by [x; u]."""
        f = self(x, u, w, m)
        return f, ca.jacobian(f, ca.vertcat(x, u))

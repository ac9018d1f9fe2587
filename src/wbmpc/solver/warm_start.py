"""Trajectories that users give a solver to start from, checked before they are taken."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from wbmpc.checks import real_numbers
from wbmpc.errors import InputError, NotFinite
from wbmpc.model.layout import Layout
from wbmpc.ocp import OptimalControlProblem

if TYPE_CHECKING:
    from wbmpc.solver.solver import Solver


def start_from(solver: Solver, x: np.ndarray, u: np.ndarray | None = None) -> None:
    """:meth:`Solver.warm_start` by who is in the solver: also in the middle of a call of its own."""
    start = trajectories(solver.ocp, solver._given_grid, x, u)
    with solver.exclusive:
        solver.ws.x[:], solver.ws.u[:] = start


def take_as_result(solver: Solver, x: np.ndarray, u: np.ndarray) -> None:
    """Take states x (N + 1, nx) and inputs u (N, nu) as the result of the last solve, without feedback."""
    with solver.exclusive:
        start_from(solver, x, u)
        solver.ws.k[:] = 0.0


def restart_from(solver: Solver, x: np.ndarray, u: np.ndarray | None = None) -> None:
    """:meth:`Solver.warm_start` and :meth:`Solver.reset`, likewise."""
    with solver.exclusive:
        start_from(solver, x, u)
        solver._backend.reset()


def trajectories(
    ocp: OptimalControlProblem, own: np.ndarray, x: np.ndarray, u: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """States (nx,) or (N + 1, nx) and inputs (nu,) or (N, nu), zero when left out, on the problem's grid; given on that or on the
    coarser grid ``own``.

    Raises :class:`InputError` for other shapes, and :class:`NotFinite` for numbers that are not finite.
    """
    d, fine = ocp.dynamics, ocp.grid
    nx, nu = d.state.size, d.input.size
    states = _finite("x", d.state, x)
    inputs = np.zeros(nu) if u is None else _finite("u", d.input, u)
    if own.size < fine.size and states.shape == (own.size, nx):
        states = np.stack([np.interp(fine, own, column) for column in states.T], axis=1)
    if own.size < fine.size and inputs.shape == (own.size - 1, nu):
        inputs = inputs[np.searchsorted(own, fine[:-1] + 1e-9) - 1]
    for name, values, shape in (("x", states, (fine.size, nx)), ("u", inputs, (fine.size - 1, nu))):
        if values.shape not in (shape, shape[1:]):
            raise InputError(f"warm start, {name}: {shape} numbers are needed, got {values.shape}")
    return states, inputs


def _finite(name: str, layout: Layout, value: np.ndarray) -> np.ndarray:
    """A guess as numbers, all of them finite."""
    values = real_numbers(f"warm start, {name}", value)
    bad = np.argwhere(~np.isfinite(np.atleast_1d(values)))
    if not bad.size:
        return values
    *node, i = (int(k) for k in bad[0])
    component = f"{name}[{i}]" + (f" ('{layout.names[i]}')" if i < layout.size else "")
    where = f" at node {node[-1]}" if node else ""
    raise NotFinite(
        f"warm start, {name}: {component}{where} must be finite, got {np.atleast_1d(values)[tuple(bad[0])]}"
    )

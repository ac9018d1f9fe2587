"""The optimal control problem: dynamics, a time grid, named terms."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, Protocol

import casadi as ca
import numpy as np

from wbmpc import trajectory
from wbmpc.checks import quoted, real_numbers
from wbmpc.errors import InputError, unknown_name
from wbmpc.model.layout import Layout
from wbmpc.ocp.terms import Constraint, Cost
from wbmpc.trajectory import MAX_INTERVALS

Term = Cost | Constraint
#: A finer grid is a mistake of units: its matrices alone would fill the memory.


class SystemDynamics(Protocol):
    """What a problem needs of a system ẋ = f(x, u; w, m); ``model.Dynamics`` is one, a wrapper or your own another.

    A system that also has ``jump(x, w, m)`` maps its state at every event of the mode schedule; m: the mode after it.
    """

    state: Layout
    input: Layout
    parameters: Layout
    mode: Layout
    unit_quaternions: tuple[int, ...]

    def __call__(self, x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> ca.SX:
        """ẋ (nx)."""
        ...

    def jacobian(self, x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> tuple[ca.SX, ca.SX]:
        """ẋ and its Jacobian (nx, nx + nu) by [x; u]."""
        ...


class OptimalControlProblem:
    """minimize Σ ∫ cost dt + terminal cost, subject to ẋ = f(x, u) and constraints, over ``horizon`` [s].

    ``dynamics``: the system, ẋ = f(x, u) with x (nx), u (nu); ``terms``: costs and constraints by name, in the order in which they were added.

    ``intervals``: number of intervals N. ``first_interval`` [s]: geometric grid, fine near now; uniform when left out;
    or ``grid``: the times of the N + 1 nodes from 0 [s]. ``integrator``: "rk2" (midpoint) or "rk4" steps.
    ``align_events``: move the nearest node onto every event of the mode schedule, so that no interval sees two modes.
    ``modes``: names of all modes that schedules may have, for problems whose schedule changes; left out, the modes that a term
    names have to be in the active schedule.
    """

    def __init__(
        self, dynamics: SystemDynamics, horizon: float, intervals: int, *, first_interval: float | None = None,
        grid: Sequence[float] | None = None, integrator: Literal["rk2", "rk4"] = "rk2", align_events: bool = False,
        modes: Sequence[str] = (),
    ) -> None:  # fmt: skip
        if integrator not in ("rk2", "rk4"):
            raise unknown_name("integrator", integrator, ("rk2", "rk4"))
        _check_dynamics(dynamics)
        self.dynamics = dynamics
        self.integrator = integrator
        self.align_events = align_events
        if isinstance(modes, str) or not all(isinstance(name, str) for name in modes):
            raise InputError(f"modes: a sequence of names is needed, got {modes!r}")
        self.modes = tuple(modes)
        self.grid = _grid(horizon, intervals, first_interval, grid)
        self.terms: dict[str, Term] = {}

    @property
    def intervals(self) -> int:
        """Number of intervals N."""
        return len(self.grid) - 1

    @property
    def horizon(self) -> float:
        """Length of the horizon [s]."""
        return float(self.grid[-1])

    @property
    def costs(self) -> list[Cost]:
        """The costs, in the order in which they were added."""
        return [t for t in self.terms.values() if isinstance(t, Cost)]

    @property
    def equalities(self) -> list[Constraint]:
        """Constraints whose residual has to vanish, in their order."""
        return [t for t in self.terms.values() if isinstance(t, Constraint) and t.equality]

    @property
    def inequalities(self) -> list[Constraint]:
        """The other constraints, in their order."""
        return [t for t in self.terms.values() if isinstance(t, Constraint) and not t.equality]

    def refined(self, step: float) -> OptimalControlProblem:
        """The same problem on a grid whose intervals are cut so that none is longer than ``step`` [s]."""
        cuts = np.maximum(np.ceil(np.diff(self.grid) / step - 1e-9), 1.0)
        if cuts.sum() > MAX_INTERVALS:
            raise InputError(
                f"step: {step:g} s cuts a horizon of {self.horizon:g} s into {cuts.sum():.3g} intervals; "
                f"valid: at most {MAX_INTERVALS}, at least {self.horizon / MAX_INTERVALS:.2g} s"
            )
        cuts = cuts.astype(int)
        grid = [t for k, c in enumerate(cuts) for t in np.linspace(self.grid[k], self.grid[k + 1], c, endpoint=False)]
        other = self._rebuilt(self.dynamics, [*grid, self.horizon])
        other.terms = self.terms
        return other

    def on(self, dynamics: SystemDynamics) -> OptimalControlProblem:
        """A problem for other ``dynamics`` with the same grid, integrator and modes, and no terms."""
        return self._rebuilt(dynamics, [float(t) for t in self.grid])

    def _rebuilt(self, dynamics: SystemDynamics, grid: Sequence[float]) -> OptimalControlProblem:
        return OptimalControlProblem(
            dynamics, self.horizon, len(grid) - 1, grid=grid, integrator=self.integrator, align_events=self.align_events,
            modes=self.modes,
        )  # fmt: skip

    def __repr__(self) -> str:
        d, count = self.dynamics, len(self.terms)
        return (
            f"OptimalControlProblem({self.horizon:g} s, {self.intervals} intervals, {d.state.size} states, {d.input.size} inputs; "
            f"{count} {'term' if count == 1 else 'terms'}: {', '.join(self.terms)})"
        )

    def _repr_html_(self) -> str:
        from wbmpc.plots.notebook import html_table

        rows = [
            [name, "cost" if isinstance(term, Cost) else "equality" if term.equality else "inequality", type(term.residual).__name__,
             term.residual.size, term.at, ", ".join(term.modes or ())]
            for name, term in self.terms.items()
        ]  # fmt: skip
        return html_table(repr(self).partition(";")[0] + ")", ["term", "kind", "residual", "rows", "at", "modes"], rows)

    def plot(self) -> Any:
        """Its grid as a Plotly figure: how long each interval is, over the horizon."""
        from wbmpc.plots.figures import Plot, Series
        from wbmpc.plots.notebook import figure

        held = np.repeat(self.grid, 2)[1:-1]
        lines = [Series("interval", held, np.repeat(1e3 * np.diff(self.grid), 2))]
        return figure([Plot(f"{self.intervals} intervals", "time [s]", "length [ms]", lines)])

    def add(self, term: Term) -> None:
        """Add a term; its name must be new. Solvers that were made before raise :class:`InputError` at their next solve."""
        if not isinstance(term, Cost | Constraint):
            raise InputError(f"term: a wb.Cost or a wb.Constraint is needed, got {quoted(term)!r}")
        if term.name in self.terms:
            raise InputError(f"term '{term.name}' is already there; valid: a new name")
        self.terms[term.name] = term

    def term(self, name: str) -> Term:
        """The term of that name."""
        if name not in self.terms:
            raise unknown_name("term", name, self.terms)
        return self.terms[name]


def check_problem(who: str, ocp: object) -> None:
    """Raise :class:`InputError` of ``who`` for what is no problem."""
    if not isinstance(ocp, OptimalControlProblem):
        raise InputError(f"{who}: an OptimalControlProblem is needed, got {quoted(ocp)!r}")


def _check_dynamics(dynamics: object) -> None:
    """Raise :class:`InputError` for what is no :class:`SystemDynamics`."""
    if isinstance(dynamics, type) or not (callable(dynamics) and hasattr(dynamics, "unit_quaternions")):
        raise InputError(
            f"dynamics: a system is needed, such as robot.dynamics() or wb.Ode(…), got {quoted(dynamics)!r}"
        )


def _grid(horizon: float, intervals: int, first: float | None, grid: Sequence[float] | None) -> np.ndarray:
    if grid is not None:
        times = real_numbers("grid", grid)
        shaped = times.ndim == 1 and times.size >= 2 and times[0] == 0.0
        if not (shaped and np.isfinite(times).all() and np.all(np.diff(times) > 0)):
            raise InputError("grid: needs at least two finite, increasing times that start at 0")
        if times.size > MAX_INTERVALS + 1 or times[-1] > trajectory.MAX_HORIZON:
            raise InputError(f"grid: at most {MAX_INTERVALS} intervals and {trajectory.MAX_HORIZON:g} s are possible")
        return times
    if first is not None:
        return trajectory.geometric_grid(horizon, intervals, first)
    return trajectory.uniform_grid(horizon, intervals)

"""Wrappers that add states: rates of inputs (acceleration limits, input-rate costs), lagging drives, filters; progress along a path.

The wrapped state is [x, the groups' states]; residuals keep seeing the robot's own x and u (:meth:`view`). A group may be
wrapped only if no equality is left without an input: with hard side-slip rows the twist of a base on steered wheels may not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from wbmpc.checks import positive
from wbmpc.errors import InputError, unknown_name
from wbmpc.model.layout import Layout
from wbmpc.units import rate_unit


class _Augmented:
    """What both wrappers share. ``suffix`` names the added groups of the state."""

    def __init__(self, dynamics: Any, groups: Sequence[str], suffix: str, renamed: str) -> None:
        for group in groups:
            if group not in dynamics.input:
                raise unknown_name("input group", group, dynamics.input.groups)
        self.dynamics, self.groups = dynamics, tuple(groups)
        names, own = dynamics.input.groups, dynamics.state
        units = {
            g: [self._units(u) for u in known] for g, known in dynamics.input.unit_groups.items() if g in self.groups
        }
        self.state = Layout(
            {**own.groups, **{f"{g}{suffix}": names[g] for g in groups}},
            {**own.unit_groups, **{f"{g}{suffix}": [state for state, _ in units[g]] for g in groups}},
        )
        inputs = {**dynamics.input.unit_groups, **{g: [decided for _, decided in units[g]] for g in groups}}
        renaming = {g: f"{g}{renamed}" if g in self.groups else g for g in names}
        self.input = Layout({renaming[g]: n for g, n in names.items()}, {renaming[g]: u for g, u in inputs.items()})
        self.parameters, self.mode = dynamics.parameters, dynamics.mode
        self.unit_quaternions = dynamics.unit_quaternions
        self.mode_bounds = getattr(dynamics, "mode_bounds", {})
        self._inner = dynamics.state.size
        if hasattr(dynamics, "jump"):
            self.jump = self._jump

    def _units(self, unit: str) -> tuple[str, str]:
        """Units of the state that is added for an input in ``unit``, and of the input that takes its place."""
        return unit, unit

    def _jump(self, x: ca.SX, w: ca.SX, m: ca.SX) -> ca.SX:
        """The inner state's jump at an event; the added states go on."""
        return ca.vertcat(self.dynamics.jump(x[: self._inner], w, m), x[self._inner :])

    def view(self, x: ca.SX, u: ca.SX) -> tuple[ca.SX, ca.SX]:
        """The robot's own state and input: the wrapped groups come from the state."""
        own = x[: self._inner], self._inputs(x, u)
        view = getattr(self.dynamics, "view", None)
        return own if view is None else view(*own)

    def _own(self, x: ca.SX, u: ca.SX) -> ca.SX:
        """Derivative of the added states."""
        raise NotImplementedError

    def __call__(self, x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> ca.SX:
        """ẋ of the wrapped state."""
        inner_x, inner_u = x[: self._inner], self._inputs(x, u)
        return ca.vertcat(self.dynamics(inner_x, inner_u, w, m), self._own(x, u))

    def _inputs(self, x: ca.SX, u: ca.SX) -> ca.SX:
        parts, start = {}, self._inner
        for group in self.groups:
            size = len(self.dynamics.input.groups[group])
            parts[group] = x[start : start + size]
            start += size
        return ca.vertcat(*[parts[g] if g in parts else u[self.dynamics.input[g]] for g in self.dynamics.input.groups])

    def jacobian(self, x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> tuple[ca.SX, ca.SX]:
        """ẋ and its Jacobian by [x; u], through the inner dynamics' own Jacobian."""
        inner_x = ca.SX.sym("xi", self._inner)
        inner_u = ca.SX.sym("ui", self.dynamics.input.size)
        f, j = self.dynamics.jacobian(inner_x, inner_u, w, m)
        inputs = self._inputs(x, u)
        f, j = ca.substitute([f, j], [inner_x, inner_u], [x[: self._inner], inputs])
        outer = ca.vertcat(x, u)
        own = self._own(x, u)
        chain = ca.jacobian(ca.vertcat(x[: self._inner], inputs), outer)
        return ca.vertcat(f, own), ca.vertcat(j @ chain, ca.jacobian(own, outer))


class InputRate(_Augmented):
    """Groups of the input become states ``GROUP_input``; the new inputs, named ``GROUP_rate``, are their time derivatives.

    ``dynamics``: what is wrapped, ``groups`` of its input; ``state`` and ``input``: layouts of the wrapped x (nx) and u (nu).
    ``parameters``, ``mode``, ``mode_bounds``, ``unit_quaternions`` and ``jump`` (what an event does to x, where it does) are those of
    what is wrapped.
    """

    def __init__(self, dynamics: Any, groups: Sequence[str]) -> None:
        super().__init__(dynamics, groups, "_input", "_rate")

    def _units(self, unit: str) -> tuple[str, str]:
        return unit, rate_unit(unit)

    def _own(self, x: ca.SX, u: ca.SX) -> ca.SX:
        return ca.vertcat(*[u[self.input[f"{g}_rate"]] for g in self.groups])


class DriveLag(_Augmented):
    """Groups of the input follow their commands with a first-order lag: ẏ = (u − y) / T. ``time_constants`` [s] by group. The inputs keep
    their names and are the commands; the state ``GROUP_actual`` is the input that acts.

    ``dynamics``: what is wrapped, ``groups`` of its input; ``state`` and ``input``: layouts of the wrapped x (nx) and u (nu).
    ``parameters``, ``mode``, ``mode_bounds``, ``unit_quaternions`` and ``jump`` (what an event does to x, where it does) are those of
    what is wrapped.
    """

    def __init__(self, dynamics: Any, time_constants: Mapping[str, float]) -> None:
        for group, value in time_constants.items():
            if not value > 0.0:
                raise InputError(f"drive lag: the time constant of '{group}' must be positive, got {value}")
        self.time_constants = dict(time_constants)
        super().__init__(dynamics, tuple(time_constants), "_actual", "")

    def _own(self, x: ca.SX, u: ca.SX) -> ca.SX:
        rows = []
        for group, constant in self.time_constants.items():
            rows.append((u[self.input[group]] - x[self.state[f"{group}_actual"]]) / constant)
        return ca.vertcat(*rows)


@dataclass(frozen=True)
class InputFilter:
    """Weight of an input over frequency: ν = ``gain`` (s + zero) / (s + pole) u, with ``zero`` [rad/s] and ``pole`` [rad/s].

    A cost on ν² costs u² times the squared magnitude. With zero < pole and the default gain, pole / zero, slow inputs cost 1
    and inputs faster than the pole (pole / zero)². For a drive of bandwidth ω₁: zero ω₁, pole 5 to 10 ω₁. Equal degrees of
    both polynomials keep D ≠ 0 in u = C x + D ν, so that equalities of the input keep their rank.
    """

    zero: float
    pole: float
    gain: float | None = None

    def __post_init__(self) -> None:
        positive("input filter", **{name: value for name, value in vars(self).items() if value is not None})

    @property
    def high(self) -> float:
        """Magnitude at high frequencies."""
        return self.pole / self.zero if self.gain is None else self.gain

    def weight(self, frequency: np.ndarray | float) -> np.ndarray:
        """|ν / u| at ``frequency`` (any shape) [rad/s]."""
        s = 1j * np.asarray(frequency)
        return np.abs(self.high * (s + self.zero) / (s + self.pole))


class FrequencyShaping(_Augmented):
    """Frequency-aware inputs (Grandia et al., arXiv 1809.04539): ν is the decision variable, u = C x_s + D ν acts, and costs may weigh
    both.

    ``filters`` by group: one for all its inputs, or one for each. State group ``GROUP_filter``, input group ``GROUP_shaped``;
    residuals keep seeing u. :func:`wbmpc.ocp.frequency_aware` wraps a whole problem; without it, add a cost for drives that cannot follow
    fast inputs, on ``ProblemInput(dynamics, ["GROUP_shaped"])``.
    ``zero`` (k) [rad/s], ``pole`` (k) [rad/s] and ``high`` (k), the magnitude at high frequencies: of all k filtered inputs.

    ``dynamics``: what is wrapped, ``groups`` of its input; ``state`` and ``input``: layouts of the wrapped x (nx) and u (nu).
    ``parameters``, ``mode``, ``mode_bounds``, ``unit_quaternions`` and ``jump`` (what an event does to x, where it does) are those of
    what is wrapped.
    """

    def __init__(self, dynamics: Any, filters: Mapping[str, InputFilter | Sequence[InputFilter]]) -> None:
        super().__init__(dynamics, tuple(filters), "_filter", "_shaped")
        self.filters = {group: self._each(group, own) for group, own in filters.items()}
        every = [f for group in self.groups for f in self.filters[group]]
        self._own_input = np.concatenate(
            [np.arange(dynamics.input.size)[dynamics.input[g]] for g in self.groups] or [[]]
        )
        self._own_input = self._own_input.astype(int)
        self.zero, self.pole, self.high = (np.array([getattr(f, n) for f in every]) for n in ("zero", "pole", "high"))

    def _units(self, unit: str) -> tuple[str, str]:
        return "", unit  # the states are input times seconds

    def _each(self, group: str, filters: InputFilter | Sequence[InputFilter]) -> tuple[InputFilter, ...]:
        size = len(self.dynamics.input.groups[group])
        each = (filters,) * size if isinstance(filters, InputFilter) else tuple(filters)
        if len(each) != size:
            raise InputError(f"filters of '{group}': one or {size} are needed, got {len(each)}")
        return each

    def _inputs(self, x: ca.SX, u: ca.SX) -> ca.SX:
        acting = ca.SX(self.shaped_input(x, u))
        for k, i in enumerate(self._own_input):
            acting[i] = (u[i] + (self.pole[k] - self.zero[k]) * x[self._inner + k]) / self.high[k]
        return acting

    def shaped_input(self, x: ca.SX, u: ca.SX) -> ca.SX:
        """The inner input (nu) with ν in the place of the filtered entries: what frequency-aware costs see."""
        return u  # the groups have other names and the same places

    def _own(self, x: ca.SX, u: ca.SX) -> ca.SX:
        return ca.vertcat(*[u[i] - self.zero[k] * x[self._inner + k] for k, i in enumerate(self._own_input)])

    def equilibrium(self, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(wrapped state, wrapped input) of the inner x (nx), u (nu) with the filters at rest: u goes on acting."""
        wrapped = np.array(u, float)
        states = self.high * wrapped[self._own_input] / self.pole
        wrapped[self._own_input] = self.zero * states
        return np.concatenate([x, states]), wrapped

    def acting(self, states: np.ndarray, wrapped: np.ndarray) -> np.ndarray:
        """The inner input u (nu) that acts for filter ``states`` (k) and the wrapped input ``wrapped`` (nu)."""
        u = np.array(wrapped, float)
        u[self._own_input] = (u[self._own_input] + (self.pole - self.zero) * states) / self.high
        return u

    def advance(self, states: np.ndarray, u: np.ndarray, h: float) -> np.ndarray:
        """Filter ``states`` (k) after the inner input ``u`` (nu) has acted for ``h`` [s]; exact: ẋ_s = g u − p x_s."""
        kept = np.exp(-self.pole * h)
        return kept * states + (1.0 - kept) * self.high / self.pole * u[self._own_input]


class WithPath:
    """A model with progress along a path beside it: arc length s [m] and its speed [m/s] join the state, its acceleration [m/s²] the input.

    Group ``path`` of state and input, both at the end. Residuals keep seeing the robot's own x and u; those of
    :class:`wbmpc.residuals.Contour` and :class:`wbmpc.residuals.Progress` see the path. Nothing of it is measured or commanded:
    an :class:`wbmpc.MPC` goes on from its own plan.

    ``dynamics``: what is wrapped; ``state`` and ``input``: layouts of the wrapped x (nx + 2) and u (nu + 1). ``parameters``, ``mode``,
    ``mode_bounds``, ``unit_quaternions`` and ``jump`` (what an event does to x, where it does) are those of what is wrapped.
    """

    def __init__(self, dynamics: Any) -> None:
        if "path" in dynamics.state or "path" in dynamics.input:
            raise InputError("with path: the model has a group 'path' already; valid: a model without")
        self.dynamics = dynamics
        state, inputs = dynamics.state, dynamics.input
        self.state = Layout(
            {**state.groups, "path": ("position", "speed")}, {**state.unit_groups, "path": ("m", "m/s")}
        )
        self.input = Layout({**inputs.groups, "path": ("acceleration",)}, {**inputs.unit_groups, "path": "m/s²"})
        self.parameters, self.mode = dynamics.parameters, dynamics.mode
        self.unit_quaternions = dynamics.unit_quaternions
        self.mode_bounds = getattr(dynamics, "mode_bounds", {})
        self._nx, self._nu = dynamics.state.size, dynamics.input.size
        if hasattr(dynamics, "jump"):
            self.jump = self._jump

    def _jump(self, x: ca.SX, w: ca.SX, m: ca.SX) -> ca.SX:
        return ca.vertcat(self.dynamics.jump(x[: self._nx], w, m), x[self._nx :])

    def view(self, x: ca.SX, u: ca.SX) -> tuple[ca.SX, ca.SX]:
        """The robot's own state and input."""
        own = x[: self._nx], u[: self._nu]
        view = getattr(self.dynamics, "view", None)
        return own if view is None else view(*own)

    def __call__(self, x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> ca.SX:
        """ẋ of the wrapped state."""
        return ca.vertcat(self.dynamics(x[: self._nx], u[: self._nu], w, m), x[self._nx + 1], u[self._nu])

    def jacobian(self, x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> tuple[ca.SX, ca.SX]:
        """ẋ and its Jacobian by [x; u], through the inner dynamics' own Jacobian."""
        nx, nu = self._nx, self._nu
        inner_x, inner_u = ca.SX.sym("xi", nx), ca.SX.sym("ui", nu)
        f, j = self.dynamics.jacobian(inner_x, inner_u, w, m)
        f, j = ca.substitute([f, j], [inner_x, inner_u], [x[:nx], u[:nu]])
        own = ca.vertcat(x[nx + 1], u[nu])
        rows = ca.horzcat(j[:, :nx], ca.SX(nx, 2), j[:, nx:], ca.SX(nx, 1))
        return ca.vertcat(f, own), ca.vertcat(rows, ca.jacobian(own, ca.vertcat(x, u)))

"""Wrappers that make inputs into states: rates of inputs (acceleration limits, input-rate costs) and lagging drives.

The wrapped state is [x, the groups' inputs]; residuals keep seeing the robot's own x and u (:meth:`view`). A group may be
wrapped only if no equality is left without an input: with hard side-slip rows the base twist of a swerve robot may not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca

from wbmpc.errors import InputError, unknown_name
from wbmpc.model.layout import Layout


class _Augmented:
    """What both wrappers share. ``suffix`` names the added groups of the state."""

    def __init__(self, dynamics: Any, groups: Sequence[str], suffix: str, renamed: str) -> None:
        for group in groups:
            if group not in dynamics.input:
                raise unknown_name("input group", group, dynamics.input.groups)
        self.dynamics, self.groups = dynamics, tuple(groups)
        names = dynamics.input.groups
        self.state = Layout({**dynamics.state.groups, **{f"{g}{suffix}": names[g] for g in groups}})
        self.input = Layout({(f"{g}{renamed}" if g in groups else g): n for g, n in names.items()})
        self.parameters, self.mode = dynamics.parameters, dynamics.mode
        self.unit_quaternions = dynamics.unit_quaternions
        self.mode_bounds = getattr(dynamics, "mode_bounds", {})
        self._inner = dynamics.state.size

    def view(self, x: ca.SX, u: ca.SX) -> tuple[ca.SX, ca.SX]:
        """The robot's own state and input: the wrapped groups come from the state."""
        return self.dynamics.view(x[: self._inner], self._inputs(x, u))  # type: ignore[no-any-return]

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
        given = self._inputs(x, u)
        f, j = ca.substitute([f, j], [inner_x, inner_u], [x[: self._inner], given])
        outer = ca.vertcat(x, u)
        own = self._own(x, u)
        chain = ca.jacobian(ca.vertcat(x[: self._inner], given), outer)
        return ca.vertcat(f, own), ca.vertcat(j @ chain, ca.jacobian(own, outer))


class InputRate(_Augmented):
    """Groups of the input become states; the new inputs, named ``GROUP_rate``, are their time derivatives."""

    def __init__(self, dynamics: Any, groups: Sequence[str]) -> None:
        super().__init__(dynamics, groups, "_input", "_rate")

    def _own(self, x: ca.SX, u: ca.SX) -> ca.SX:
        return ca.vertcat(*[u[self.input[f"{g}_rate"]] for g in self.groups])


class DriveLag(_Augmented):
    """Groups of the input follow their commands with a first-order lag: ẏ = (u − y) / T.

    ``time_constants`` [s] by group. The inputs keep their names and are the commands; what acts is the state
    ``GROUP_actual``.
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

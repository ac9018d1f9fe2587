"""Offset-free control of any system: constant parameters of its dynamics estimated along with the state.

The unknown parameter (a generalized force, a bias of a twist) is a state that does not move, and an extended Kalman filter
follows [x; d] by the model itself. The estimate goes into the problem as the same parameter (``set_parameters``), so that plan
and plant agree at rest. What is left of an offset then comes from the costs: an input must be weighed against what holds the
plant under d, not against zero.

Source: Pannocchia and Rawlings 2003, "Disturbance models for offset-free model-predictive control" (AIChE Journal).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from wbmpc.arrays import Array
from wbmpc.checks import numbers
from wbmpc.errors import InputError, NotFinite
from wbmpc.model.numeric import Numeric


class OffsetObserver:
    """Estimates the parameters ``group`` of ``dynamics`` from the measured entries of the state (all when left out).

    ``x`` (nx), ``u`` (nu): where the filter starts, and where it is checked that the parameters can be distinguished; ``mode`` (nm): the
    model's mode values. Standard deviations: ``noise`` (ny) of a measurement; ``process`` (nx) by which a state, and ``walk`` (nd) by
    which a parameter, leaves the model in a second; ``spread`` (nx + nd) of both at the start. Each may be one number for all entries.
    ``known``: the values of the model's other parameters by group, needed if there are any, for the model is only right with
    them; :meth:`set_known` when they change. ``mean`` and ``covariance``: of state and
    parameters, measured are entries ``measured``. Angles are not wrapped.

    Raises :class:`InputError` naming the groups that ``known`` lacks, or a parameter that leaves no trace in the measurements or
    looks like another quantity.
    """

    def __init__(
        self, dynamics: Any, group: str, x: ArrayLike, u: ArrayLike, *, noise: ArrayLike, measured: Sequence[str] | None = None,
        process: ArrayLike = 1e-3, walk: ArrayLike = 1.0, spread: ArrayLike = 1.0, mode: ArrayLike = (),
        known: Mapping[str, ArrayLike] | None = None,
    ) -> None:  # fmt: skip
        self.dynamics, self.group, self._part = dynamics, group, dynamics.parameters[group]
        self.set_known(known or {})
        self._names = dynamics.parameters.names[self._part]
        labels = dynamics.state.names if measured is None else tuple(measured)
        self.measured = np.array([dynamics.state.index(name) for name in labels], int)
        nx, nd = dynamics.state.size, len(self._names)
        modes = np.zeros(dynamics.mode.size) if np.size(mode) == 0 else mode
        m = numbers("offset observer", "mode", modes, dynamics.mode.size)
        self.mode, self._labels = m, labels
        self.noise = _positive("noise", noise, len(labels)) ** 2
        self._walk = np.concatenate([_positive("process", process, nx), _positive("walk", walk, nd)]) ** 2
        self.mean = np.concatenate([numbers("offset observer", "x", x, nx), np.zeros(nd)])
        self.covariance = np.diag(_positive("spread", spread, nx + nd) ** 2)
        self._step, self._rates = self._functions()
        self._reject_unobservable(numbers("offset observer", "u", u, dynamics.input.size))

    @property
    def offset(self) -> Array:
        """The estimated parameters of the group."""
        return self.mean[self.dynamics.state.size :]

    @property
    def state(self) -> Array:
        """The filtered state (nx)."""
        return self.mean[: self.dynamics.state.size]

    def parameters(self) -> Array:
        """All parameters of the model: the estimate in its place, the others as known. For ``set_parameters``."""
        out = self._known.copy()
        out[self._part] = self.offset
        return out

    def set_known(self, values: Mapping[str, ArrayLike]) -> None:
        """The model's other parameters by group, all of them; they hold from the next :meth:`update` on.

        Raises :class:`InputError` naming a group that is missing, unknown, the estimated one, or not finite.
        """
        layout = self.dynamics.parameters
        others = [g for g in layout.groups if g != self.group and layout.groups[g]]
        missing = [f"'{g}'" for g in others if g not in values]
        if missing:
            raise InputError(f"offset observer: 'known' needs the values of the other parameters: {', '.join(missing)}")
        if self.group in values:
            raise InputError(f"offset observer: '{self.group}' is estimated and cannot be in 'known'")
        vector = layout.vector(values)
        if not np.isfinite(vector).all():
            raise InputError(
                f"offset observer: known '{layout.names[int(np.argmin(np.isfinite(vector)))]}' is not finite"
            )
        self._known = vector

    def update(self, y: ArrayLike, u: ArrayLike, h: float) -> Array:
        """The estimate after the measurement ``y`` (measured entries), ``h`` [s] after the last one.

        ``u`` (nu): the input that acted in between. Pass what the plant got, limits included: an input that was cut and is
        believed whole is explained by a disturbance that does not exist, and the estimate winds up.

        Raises :class:`InputError` for another number of entries or a step that is no time, :class:`NotFinite` for NaN.
        """
        y, u = np.atleast_1d(np.asarray(y, float)), np.atleast_1d(np.asarray(u, float))
        for what, value, names in (("measurement", y, self._labels), ("input", u, self.dynamics.input.names)):
            if value.shape != (len(names),):
                raise InputError(
                    f"offset observer: the {what} needs {len(names)} numbers ({', '.join(names)}), got shape {value.shape}"
                )
        if not 0.0 <= h < np.inf:
            raise InputError(f"offset observer: the time h since the last update must be finite, at least 0 s, got {h}")
        if not (np.isfinite(y).all() and np.isfinite(u).all()):
            raise NotFinite("offset observer: the measurement and the input must be finite")
        mean, slope = self._step(self.mean, u, self.mode, h, self._known)
        p = slope @ self.covariance @ slope.T + np.diag(self._walk * h)
        chosen = p[:, self.measured]
        gain = np.linalg.solve(chosen[self.measured] + np.diag(self.noise), chosen.T).T
        self.mean = mean.ravel() + gain @ (y - mean.ravel()[self.measured])
        rest = np.eye(len(p))
        rest[:, self.measured] -= gain
        self.covariance = rest @ p @ rest.T + gain @ np.diag(self.noise) @ gain.T  # Joseph's form stays positive
        return self.offset

    def _functions(self) -> tuple[Numeric, Numeric]:
        """(z, u, m, h, w) to the next z = [x; d] and its Jacobian (midpoint rule); (z, u, m, w) to ∂ẋ/∂z.

        w: all parameters, of which those in d's place do not count.
        """
        d = self.dynamics
        z, u = ca.SX.sym("z", self.mean.size), ca.SX.sym("u", d.input.size)
        m, h = ca.SX.sym("m", d.mode.size), ca.SX.sym("h")
        nx, known = d.state.size, ca.SX.sym("w", d.parameters.size)
        w = ca.SX(known)
        w[self._part] = z[nx:]
        rate = lambda x: ca.SX(d(x, u, w, m))
        after = ca.vertcat(z[:nx] + h * rate(z[:nx] + 0.5 * h * rate(z[:nx])), z[nx:])
        step = ca.Function("step", [z, u, m, h, known], [after, ca.densify(ca.jacobian(after, z))])
        rates = ca.Function("rates", [z, u, m, known], [ca.densify(ca.jacobian(rate(z[:nx]), z))])
        return Numeric(step), Numeric(rates)

    def _reject_unobservable(self, u: Array) -> None:
        """The largest subspace of [x; d] that the measurements never see must not have a part in d."""
        nx, size = self.dynamics.state.size, self.mean.size
        flow = np.vstack([self._rates(self.mean, u, self.mode, self._known)[0], np.zeros((size - nx, size))])
        unseen = np.delete(np.eye(size), self.measured, axis=1)
        while unseen.shape[1]:
            leaving = flow @ unseen
            leaving -= unseen @ (unseen.T @ leaving)
            kept = _null_space(leaving, 1e-9 * (1.0 + np.abs(flow).max()))
            if kept.shape[1] == unseen.shape[1]:
                break
            unseen = unseen @ kept
        hidden = np.linalg.norm(unseen[nx:], axis=1) if unseen.shape[1] else np.zeros(len(self._names))
        if hidden.max(initial=0.0) < 1e-6:
            return
        i = int(np.argmax(hidden))
        direction = unseen @ unseen[nx + i]  # the unseen motion that has most of this parameter
        others = [*self.dynamics.state.names, *self._names]
        like = [f"'{others[k]}'" for k in np.argsort(-np.abs(direction)) if abs(direction[k]) > 1e-3 and k != nx + i]
        how = f"cannot be distinguished from {', '.join(like[:3])}" if like else "leaves no trace"
        raise InputError(f"offset observer: '{self._names[i]}' {how} by measuring {', '.join(self._labels)}")


def _null_space(matrix: Array, tolerance: float) -> Array:
    """Orthonormal columns that the matrix maps to (nearly) nothing."""
    _, size, right = np.linalg.svd(matrix)
    return right[int(np.sum(size > tolerance)) :].T  # type: ignore[no-any-return]


def _positive(name: str, value: ArrayLike, size: int) -> Array:
    values = np.asarray(value, float)
    if values.ndim and values.shape != (size,):
        raise InputError(f"offset observer, {name}: one number or {size} are needed, got {values.size}")
    if not (np.isfinite(values).all() and np.all(values > 0.0)):
        raise InputError(f"offset observer, {name}: must be positive and finite, got {values.tolist()}")
    return np.broadcast_to(values, size).copy()

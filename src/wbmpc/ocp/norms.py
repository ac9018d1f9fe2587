"""Norms that turn a residual into a cost, and the relaxed barrier that turns an inequality into one."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import casadi as ca

from wbmpc.checks import positive
from wbmpc.errors import InputError


class Norm(Protocol):
    """``value(r)``, its first derivative and a non-negative curvature, each row by row."""

    def value(self, r: ca.SX) -> ca.SX:
        """The cost of each row."""

    def gradient(self, r: ca.SX) -> ca.SX:
        """Its derivative by the row."""

    def curvature(self, r: ca.SX) -> ca.SX:
        """What the Hessian has for the second derivative, not negative."""


@dataclass(frozen=True)
class Quadratic:
    """½ r²."""

    def value(self, r: ca.SX) -> ca.SX:
        """The cost of each row."""
        return 0.5 * r * r

    def gradient(self, r: ca.SX) -> ca.SX:
        """Its derivative by each row."""
        return r

    def curvature(self, r: ca.SX) -> ca.SX:
        """What the Gauss-Newton Hessian gets for each row, ≥ 0."""
        return ca.SX.ones(r.shape)


@dataclass(frozen=True)
class SmoothL1:
    """δ² (√(1 + (r/δ)²) − 1): quadratic near zero, linear beyond ``scale`` δ (in the residual's unit; one, or one per row).

    Limits the pull of a large error. The curvature is that of iteratively reweighted least squares, r'/r ≥ r''.
    """

    scale: float | tuple[float, ...]

    def __post_init__(self) -> None:
        scales = self.scale if isinstance(self.scale, tuple) else (self.scale,)
        if not (scales and all(0.0 < s < math.inf for s in scales)):
            raise InputError(f"SmoothL1: scale must be positive and finite, got {self.scale}")

    def _root(self, r: ca.SX) -> ca.SX:
        return ca.sqrt(1.0 + (r / ca.DM(self.scale)) ** 2)

    def value(self, r: ca.SX) -> ca.SX:
        """The cost of each row."""
        return ca.DM(self.scale) ** 2 * (self._root(r) - 1.0)

    def gradient(self, r: ca.SX) -> ca.SX:
        """Its derivative by each row."""
        return r / self._root(r)

    def curvature(self, r: ca.SX) -> ca.SX:
        """What the Gauss-Newton Hessian gets for each row, ≥ 0."""
        return 1.0 / self._root(r)


@dataclass(frozen=True)
class RelaxedBarrier:
    """−μ ln h for h > δ, else μ (½ ((h − 2δ)/δ)² − ½ − ln δ): a soft inequality h ≥ 0.

    ``mu`` μ: cost per second and factor e of h; ``delta`` δ (in h's unit): where the parabola begins.
    Source: Feller and Ebenbauer, "Relaxed logarithmic barrier function based MPC" (2017), quadratic relaxation.
    """

    mu: float = 1e-2
    delta: float = 1e-3

    def __post_init__(self) -> None:
        positive("RelaxedBarrier", mu=self.mu, delta=self.delta)

    def value(self, h: ca.SX) -> ca.SX:
        """The cost of each row."""
        near = self.mu * (0.5 * (((h - 2 * self.delta) / self.delta) ** 2 - 1.0) - ca.log(self.delta))
        return ca.if_else(h > self.delta, -self.mu * ca.log(ca.fmax(h, self.delta)), near)

    def gradient(self, h: ca.SX) -> ca.SX:
        """Its derivative by each row."""
        near = self.mu * (h - 2 * self.delta) / self.delta**2
        return ca.if_else(h > self.delta, -self.mu / ca.fmax(h, self.delta), near)

    def curvature(self, h: ca.SX) -> ca.SX:
        """What the Gauss-Newton Hessian gets for each row, ≥ 0."""
        safe = ca.fmax(h, self.delta)
        return self.mu / (safe * safe)


@dataclass(frozen=True)
class AugmentedLagrangian:
    """The method of multipliers for constraints: a multiplier per row and node, updated in every iteration.

    ``rho``: penalty per squared unit of the residual. For h ≥ 0: (max(0, λ − ρ h)² − λ²) / 2ρ; for g = 0: λ g + ρ g² / 2.
    Source: Nocedal and Wright 2006, sections 17.3 and 17.4.
    """

    rho: float = 1e3

    def __post_init__(self) -> None:
        positive("AugmentedLagrangian", rho=self.rho)

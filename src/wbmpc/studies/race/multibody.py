"""Equations of motion of a tree of joints under generalized forces: ẋ = (v, M⁻¹ (S(q) u − h))."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import casadi as ca

from wbmpc.model.kinematics import Chain, solve_spd
from wbmpc.model.ode import Groups, Ode
from wbmpc.model.tree import Link


class Multibody(Ode):
    """Links of which every one moves on its joint; ``force(q, u)`` gives the generalized forces (nq).

    ``armature`` [kg m² or kg]: inertia of every joint's drive, on the mass matrix's diagonal.
    """

    def __init__(
        self,
        links: Sequence[Link],
        state: Groups,
        inputs: Groups,
        force: Callable[[ca.SX, ca.SX], ca.SX],
        armature: float = 0.0,
    ) -> None:
        super().__init__(state, inputs, self._derivative)
        self.links, self.force, self.nq, self.armature = tuple(links), force, len(links), armature

    def chain(self, q: ca.SX) -> Chain:
        """The tree at joint values q (nq)."""
        return Chain(self.links, {i: q[i] for i in range(self.nq)})

    def _bias(self, q: ca.SX, v: ca.SX, a: ca.SX) -> ca.SX:
        """M a + h."""
        each = range(self.nq)
        return self.chain(q).inverse_dynamics({i: v[i] for i in each}, {i: a[i] for i in each}) + self.armature * a

    def mass_matrix(self, q: ca.SX) -> ca.SX:
        """M(q), (nq, nq), with the drives' inertia."""
        m = self.chain(q).mass_matrix()
        return m + self.armature * ca.SX.eye(self.nq) if self.armature else m

    def _derivative(self, x: ca.SX, u: ca.SX) -> ca.SX:
        q, v = x[: self.nq], x[self.nq :]
        right = self.force(q, u) - self._bias(q, v, ca.SX(self.nq, 1))
        return ca.vertcat(v, solve_spd(self.mass_matrix(q), right))

    def jacobian(self, x: ca.SX, u: ca.SX, w: ca.SX, m: ca.SX) -> tuple[ca.SX, ca.SX]:
        """ẋ and its Jacobian: the derivative of the Newton-Euler residual, solved with one factor of M."""
        n, f = self.nq, self._derivative(x, u)
        a = ca.SX.sym("a", n)
        residual = self._bias(x[:n], x[n:], a) - self.force(x[:n], u)
        slope = ca.substitute(ca.jacobian(residual, ca.vertcat(x, u)), a, f[n:])
        kinematic = ca.horzcat(ca.SX(n, n), ca.SX.eye(n), ca.SX(n, u.shape[0]))
        return f, ca.vertcat(kinematic, -solve_spd(self.mass_matrix(x[:n]), slope))

"""Frequency-aware problems: costs of inputs that depend on their frequency (Grandia et al., RA-L 2019, arXiv 1809.04539).

A drive that cannot follow fast inputs should not be asked for them. ν = s(jω) u with |s| growing with the frequency is what
costs; ν becomes the decision, the filters' states join the state (section III of the paper), and u, which follows from both, acts
in the dynamics and in all constraints.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca

from wbmpc.errors import InputError, unknown_name
from wbmpc.model.augment import FrequencyShaping, InputFilter
from wbmpc.ocp.problem import OptimalControlProblem
from wbmpc.ocp.residuals import Symbols
from wbmpc.ocp.symbols import Wrapping
from wbmpc.ocp.terms import Cost
from wbmpc.ocp.transcription import Transcription


@dataclass(frozen=True)
class _Seen(Wrapping):
    """A residual of the inner problem as it sees the wrapped one; ``weighed``: with ν in the place of u."""

    dynamics: FrequencyShaping
    weighed: bool

    @property
    def row_names(self) -> Any:
        return getattr(self.inner, "row_names", None)

    def __call__(self, s: Symbols) -> ca.SX:
        d = self.dynamics
        x = s.all_x[: d.dynamics.state.size]
        u = d.shaped_input(s.all_x, s.all_u) if self.weighed else d._inputs(s.all_x, s.all_u)
        view = getattr(d.dynamics, "view", None)
        own_x, own_u = (x, u) if view is None else view(x, u)
        return self.inner(replace(s, x=own_x, u=own_u, all_x=x, all_u=u))


def frequency_aware(
    ocp: OptimalControlProblem,
    filters: Mapping[str, InputFilter | Sequence[InputFilter]],
    costs: Sequence[str] | None = None,
) -> OptimalControlProblem:
    """The same problem with frequency-dependent costs of inputs; ``ocp`` is not changed.

    ``filters`` by input group, one for all its entries or one for each: zero and pole [rad/s] and gain of ν / u. ``costs``: names
    of the cost terms that weigh ν in the place of u; left out: all that depend on a filtered input. Constraints and the other
    costs see u. The decision is ν; ``dynamics`` of the result is a :class:`wbmpc.model.augment.FrequencyShaping`: its ``equilibrium``
    gives state and input to start from without a transient, and :class:`wbmpc.mpc.filters.FilterMemory` keeps the filters' states in a
    controller. With the default gain nothing changes for constant inputs, and with ``zero == pole`` nothing at all.

    Raises :class:`InputError` for groups and costs that do not exist and for costs that do not depend on a filtered input.
    """
    if not filters:
        raise InputError(f"filters: at least one is needed; valid: {', '.join(ocp.dynamics.input.groups)}")
    dynamics = FrequencyShaping(ocp.dynamics, filters)
    depending = _depending(ocp, dynamics.groups)
    chosen = depending if costs is None else list(costs)
    for name in chosen:
        if name not in depending:
            raise unknown_name("cost that depends on a filtered input", name, depending)
    if not chosen:
        raise InputError(f"filters: no cost depends on an input of {', '.join(dynamics.groups)}")
    wrapped = ocp.on(dynamics)
    nested = hasattr(ocp.dynamics, "view")
    for name, term in ocp.terms.items():
        weighed = name in chosen
        seen = _Seen(term.residual, dynamics, weighed) if weighed or nested else term.residual
        wrapped.add(replace(term, residual=seen))
    return wrapped


def _depending(ocp: OptimalControlProblem, groups: Sequence[str]) -> list[str]:
    """Names of the costs along the path that depend on inputs of the groups."""
    t = Transcription(ocp)
    filtered = ca.vertcat(*[t.u[ocp.dynamics.input[g]] for g in groups])
    names = [c.name for c in ocp.costs if c.at == "path"]
    return [n for n in names if ca.depends_on(_residual(t, ocp, n), filtered)]


def _residual(t: Transcription, ocp: OptimalControlProblem, name: str) -> ca.SX:
    term = ocp.term(name)
    assert isinstance(term, Cost)
    return ca.SX(term.residual(t.symbols(name)))

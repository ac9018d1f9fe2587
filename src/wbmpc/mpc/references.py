"""References of an MPC by name."""

from __future__ import annotations

from collections.abc import Iterator

from wbmpc.errors import unknown_name
from wbmpc.ocp import Reference
from wbmpc.solver import Solver


class References:
    """``mpc.reference["end_effector"] = Reference...``: what the terms compare with.

    Set it between two updates, from the thread that updates. Another thread gets :class:`SolverBusy` while an update is under way
    (it does not wait, and the reference is not changed); what sets it in an MPC's own thread is a guess (:class:`Bound`).
    """

    def __init__(self, solver: Solver) -> None:
        self._solver = solver

    def __setitem__(self, name: str, reference: Reference) -> None:
        self._solver.set_reference(name, reference)

    def __getitem__(self, name: str) -> Reference:
        if name not in self:
            raise unknown_name("reference", name, self)
        return self._solver.references[name]

    def __contains__(self, name: object) -> bool:
        return name in self._solver.references

    def __iter__(self) -> Iterator[str]:
        return iter(self._solver.references)

"""Which Hessian a solver's iterations have: Gauss-Newton's, the exact one, or the second after the first."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from wbmpc.errors import InputError, UnsupportedOperation
from wbmpc.kernel.compiled import problem_key
from wbmpc.kernel.second_derivatives import SECOND, ExactHessian, build_exact_hessian
from wbmpc.ocp import OptimalControlProblem
from wbmpc.solver.memory_layout import DYNAMICS_H, END_LAGRANGIAN, EXACT, LAGRANGIAN, SCRATCH, TERMINAL, E, H, Setting
from wbmpc.solver.settings import SQP

if TYPE_CHECKING:
    from wbmpc.solver.solver import Solver

_LOG = logging.getLogger("wbmpc")


def _obstacles(ocp: OptimalControlProblem, settings: SQP) -> list[str]:
    """What keeps a problem from an exact Hessian."""
    found = {
        "a state that jumps at events": getattr(ocp.dynamics, "jump", None) is not None,
        "quaternions": bool(ocp.dynamics.unit_quaternions),
        "backend='interpreted'": settings.backend != "compiled",
    }
    return [name for name, keeps in found.items() if keeps]


def exact_from_start(ocp: OptimalControlProblem, settings: SQP) -> bool:
    """Whether the Hessian is the exact one from the first iteration on. Raises :class:`InputError` where there is none."""
    if settings.hessian != "exact":
        return False
    for name in _obstacles(ocp, settings):
        raise InputError(f"hessian='exact' does not go with {name}; valid: hessian='auto'")
    return True


class HessianSwitch:
    """Within its context :meth:`run` may change a solver to the exact Hessian, behind it the solver's own one counts again."""

    def __init__(self, solver: Solver) -> None:
        self._solver = solver
        settings = solver.settings
        #: whether a solve may change to the exact Hessian
        self.automatic = settings.hessian == "auto" and settings.compute_kkt and not _obstacles(solver.ocp, settings)
        self._exact: ExactHessian | None = None

    @property
    def exact(self) -> bool:
        """Whether the present iterations have the exact Hessian."""
        return self._solver.kernel is not None and bool(self._solver.ws.table[EXACT])

    def __enter__(self) -> None:
        self._solver.numbers[Setting.DETECT_STALL] = float(self.automatic)

    def __exit__(self, *_: object) -> None:
        self._solver.numbers[Setting.DETECT_STALL] = 0.0
        kernel = self._solver.kernel
        if kernel is not None and self.exact and not self._solver.problem.exact:
            self._use([kernel.address(name) for name in SECOND], False)

    def run(self, x0: np.ndarray, t0: float) -> tuple[int, int]:
        """As :meth:`Solver.iterate`; where Gauss-Newton stalls, the exact Hessian is compiled and the solve goes on with it."""
        from wbmpc.solver.driver import iterate
        from wbmpc.solver.termination import STALLED

        solver = self._solver
        status, count = solver.iterate(x0, t0)
        if status != STALLED:
            return status, count
        exact = self._compile()
        if exact is not None:
            self._use(exact.addresses, True)
        solver.numbers[Setting.DETECT_STALL] = 0.0
        return iterate(solver.ws.memory, solver.ws.table, solver.x0, solver.numbers, solver.log, count)

    def _use(self, addresses: Sequence[int], exact: bool) -> None:
        table = self._solver.ws.table
        table[[LAGRANGIAN, DYNAMICS_H, END_LAGRANGIAN]] = addresses
        table[EXACT] = int(exact)
        # second derivatives are also where the cost's functions never write
        for block, following in ((H, E), (TERMINAL, SCRATCH)):
            self._solver.ws.memory[table[block] : table[following]] = 0.0

    def _compile(self) -> ExactHessian | None:
        """Code of the exact Hessian; None where there is none."""
        problem, kernel = self._solver.problem, self._solver.kernel
        if self._exact is None and kernel is not None:
            try:
                self._exact = build_exact_hessian(problem, kernel.sizes, problem_key(problem), self._solver.use_cache)
            except UnsupportedOperation as error:
                _LOG.info("the exact Hessian cannot be compiled (%s): Gauss-Newton goes on", error)
                self.automatic = False
        return self._exact

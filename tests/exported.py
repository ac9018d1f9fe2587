"""A small problem with everything that a controller looks at, and an exported controller as a shared library."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from pathlib import Path

import casadi as ca
import numpy as np

import wbmpc as wb

PERIOD, LOWER, UPPER = 0.05, -0.6, 0.9


def trolley(rate: float = 1.0 / PERIOD) -> wb.MPC:
    """ẍ = u0 + u1: references of state and input, a box around the latter, a sum limited in the mode "narrow"."""
    names = {"x": ["position", "speed"]}, {"u": ["drive", "brake"]}
    dynamics = wb.Ode(*names, lambda x, u: ca.vertcat(x[1], u[0] + u[1] - 0.1 * ca.sin(x[0])))
    ocp = wb.OptimalControlProblem(dynamics, horizon=1.0, intervals=10, modes=("wide", "narrow"))
    ocp.add(wb.Cost("state", wb.residuals.State(dynamics), [10.0, 1.0], at="path+terminal"))
    ocp.add(wb.Cost("effort", wb.residuals.Expression(2, lambda s: s.u), 0.1))
    ocp.add(wb.Constraint("limit", wb.residuals.Input(dynamics), wb.sets.Box(LOWER, UPPER), hard=True))
    total = wb.residuals.Expression(1, lambda s: s.u[0] + s.u[1])
    ocp.add(wb.Constraint("sum", total, wb.sets.Box(-0.8, 0.8), hard=True, modes=("narrow",)))
    mpc = wb.MPC(ocp, rate=rate, first_iterations=5)
    mpc.reference["state"] = wb.Reference(np.array([0.0, 2.0]), np.array([[0.0, 0.0], [1.0, 0.5]]))
    mpc.reference["limit"] = wb.Reference.constant([0.05, -0.05])
    mpc.set_schedule(wb.ModeSchedule((wb.Mode("wide"), wb.Mode("narrow")), (0.7,)))
    mpc.reset(np.array([0.3, 0.0]))
    return mpc


class Controller:
    """What C sees, by ctypes; results as they are returned."""

    def __init__(self, done: object, folder: Path) -> None:
        self.prefix: str = done.prefix  # type: ignore[attr-defined]
        library, compiler = folder / "controller.so", shutil.which("cc")
        assert compiler is not None
        command = [compiler, "-shared", "-o", str(library), str(done.directory / f"{self.prefix}.o"), "-lm"]  # type: ignore[attr-defined]
        subprocess.run(command, check=True)
        self.code, self.size = ctypes.CDLL(str(library)), int(done.block_size)  # type: ignore[attr-defined]
        self.memory = np.zeros(self.size + 64, dtype=np.uint8)
        self.block = self.memory[-self.memory.ctypes.data % 64 :][: self.size]

    def __call__(self, name: str, *arguments: object) -> int:
        given = [self._c(a) for a in arguments]
        return int(getattr(self.code, f"{self.prefix}_{name}")(ctypes.c_void_p(self.block.ctypes.data), *given))

    @staticmethod
    def _c(argument: object) -> object:
        if isinstance(argument, np.ndarray):
            return ctypes.c_void_p(argument.ctypes.data)
        return ctypes.c_double(argument) if isinstance(argument, float) else ctypes.c_int(argument)  # type: ignore[arg-type]

    def create(self) -> int:
        return int(
            getattr(self.code, f"{self.prefix}_create")(
                ctypes.c_void_p(self.block.ctypes.data), ctypes.c_size_t(self.size)
            )
        )

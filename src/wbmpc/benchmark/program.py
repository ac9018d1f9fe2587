"""The discretized problem of a :class:`Solver` as other solvers take it: stage by stage (x_k, u_k), with the same
Gauss-Newton Hessian, as one small C file whose stage functions are called in loops.
"""

from __future__ import annotations

import atexit
import hashlib
import logging
import os
import shutil
import signal
import subprocess
import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from wbmpc.kernel.cache import UntrustedCache, trusted_file, trusted_folder
from wbmpc.ocp import RelaxedBarrier, Transcription
from wbmpc.ocp.constraint_classification import BoxRow, Kind, Row
from wbmpc.solver import Solver

_LOG = logging.getLogger("wbmpc")


def library_folder() -> Path:
    """The cache's folder of libraries; one of this process alone, gone at its end, where the cache is not the user's own."""
    try:
        return trusted_folder("peers")
    except (OSError, UntrustedCache) as error:
        return _own_folder(str(error))


@cache
def _own_folder(why: str) -> Path:
    _LOG.warning("compiled libraries are not kept, for %s", why)
    folder = Path(tempfile.mkdtemp(prefix="wbmpc-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


COMPILER_FLAGS = ("-march=native", "-fno-math-errno", "-shared", "-fPIC")
#: Straight-line code of more characters than this takes the compiler many minutes with -O2: it gets -O1.
LARGE = 1_500_000


@dataclass(frozen=True)
class Samples:
    """Parameters of the horizon that starts at time 0: ``p`` (N + 1, np), ``w``, intervals ``h`` (N,) [s]."""

    p: np.ndarray
    w: np.ndarray
    h: np.ndarray


def sampled(solver: Solver, t0: float = 0.0) -> Samples:
    """What the solver's references and modes are at the nodes of a horizon that starts at ``t0`` [s]."""
    from wbmpc.solver.receding import sample

    t, grid, tables = solver.problem, solver.trajectory().grid, solver.data.tables()
    width = max(t.node.size, 1)
    flat = np.zeros(grid.size * width)
    for k, time in enumerate(grid):
        sample(tables.numbers, tables.integers, t0 + float(time), flat, k * width)
    return Samples(flat.reshape(grid.size, width)[:, : t.node.size], solver.constants, np.diff(grid))


# ---------------------------------------------------------------------- stage functions
def _barrier(rows: list[BoxRow], z: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    value, gradient, curvature = ca.SX(0), ca.SX.zeros(z.shape[0]), ca.SX.zeros(z.shape[0])
    for i, sign, offset, mu, delta in rows:
        norm, h = RelaxedBarrier(mu, delta), sign * z[i] + offset
        value += norm.value(h)
        gradient[i] += sign * norm.gradient(h)
        curvature[i] += sign * sign * norm.curvature(h)
    return value, gradient, curvature


def _step(f: ca.Function, x: ca.SX, u: ca.SX, p: Any, w: Any, h: Any, rk4: bool) -> ca.SX:
    k1 = f(x, u, p, w)
    k2 = f(x + h / 2 * k1, u, p, w)
    if not rk4:
        return x + h * k2
    k3 = f(x + h / 2 * k2, u, p, w)
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + f(x + h * k3, u, p, w))


def _normalized(t: Transcription, x: ca.SX) -> ca.SX:
    """Unit length of the quaternions, as the solver's integrator ends a step."""
    for q in t.ocp.dynamics.unit_quaternions:
        part = x[q : q + 4]
        x = ca.vertcat(x[:q], part / ca.norm_2(part), x[q + 4 :])
    return x


def _box_rows(rows: list[Row], z: ca.SX) -> ca.SX:
    return ca.vertcat(*[r.sign * z[r.variable] + r.offset for r in rows]) if rows else ca.SX(0, 1)


def _nonzeros(m: ca.SX) -> ca.SX:
    values: list[Any] = list(m.nonzeros())
    return ca.vertcat(*values)


class Stages:
    """SX functions of one interval: (x, u, p, w, h) to cost, rows [−F(x, u); equality; hard] and their derivatives."""

    def __init__(self, t: Transcription) -> None:
        self.t = t
        self.rk4 = t.ocp.integrator == "rk4"
        self.symbols = [t.x, t.u, t.p, t.w, t.h]

    def _function(self, name: str, out: list[Any]) -> ca.Function:
        return ca.Function(name, self.symbols, ca.cse([ca.SX(o) for o in out]))

    def cost(self) -> ca.Function:
        """h (cost + barriers)."""
        t = self.t
        value = t.values["cost"](*self.symbols[:4]) + _barrier(t.path.barriers, t.z)[0]
        return self._function("stage_cost", [t.h * value])

    def quadratic(self) -> ca.Function:
        """Gradient (nz) and Gauss-Newton Hessian (upper triangle) of the cost."""
        t = self.t
        _, gradient, hessian = t.derivatives["cost_quadratic"](*self.symbols)
        _, slope, curve = _barrier(t.path.barriers, t.z)
        return self._function("stage_quadratic", [gradient + t.h * slope, ca.triu(hessian + t.h * ca.diag(curve))])

    def constraint(self) -> ca.Function:
        """[−F(x, u); equality rows; hard rows]."""
        t, arguments = self.t, self.symbols[:4]
        end = _step(t.values["dynamics"], t.x, t.u, t.p, t.w, t.h, self.rk4)
        hard = [_box_rows(t.path.boxes, t.z), t.values["rows"](*arguments)]
        return self._function("stage_rows", [ca.vertcat(-_normalized(t, end), t.values["equality"](*arguments), *hard)])

    def jacobian(self) -> ca.Function:
        """Jacobian of :meth:`constraint` by (x, u), by the chain rule through the integrator's stages."""
        t, (x, u, p, w, h) = self.t, self.symbols
        slopes, chained = [], []
        inputs = ca.horzcat(ca.SX(t.nu, t.nx), ca.SX.eye(t.nu))
        start = ca.horzcat(ca.SX.eye(t.nx), ca.SX(t.nx, t.nu))
        sensitivity, point = start, x
        for c in (0.5, 0.5, 1.0, 0.0) if self.rk4 else (0.5, 0.0):
            f, j = t.derivatives["dynamics_jacobian"](point, u, p, w)
            slopes.append(f)
            chained.append(j @ ca.vertcat(sensitivity, inputs))
            point, sensitivity = x + c * h * f, start + c * h * chained[-1]
        combine = lambda k: (k[0] + 2 * k[1] + 2 * k[2] + k[3]) / 6 if self.rk4 else k[1]
        end, total = x + h * combine(slopes), start + h * combine(chained)
        if t.ocp.dynamics.unit_quaternions:
            free = ca.SX.sym("end", t.nx)
            turn = ca.substitute(ca.jacobian(_normalized(t, free), free), free, end)
            total = turn @ total
        _, rows = t.derivatives["equality_jacobian"](*self.symbols[:4])
        _, general = t.derivatives["rows_jacobian"](*self.symbols[:4])
        boxes = ca.jacobian(_box_rows(t.path.boxes, t.z), t.z)
        return self._function("stage_jacobian", [ca.vertcat(-total, rows, boxes, general)])

    def end_rows(self) -> tuple[ca.Function, ca.Function]:
        """Hard rows of (x, p, w) at the end of the horizon; their Jacobian."""
        t = self.t
        arguments = [t.x, t.p, t.w]
        boxes = _box_rows(t.end.boxes, t.x)
        value = ca.vertcat(boxes, t.values["end_rows"](*arguments))
        slope = ca.vertcat(ca.jacobian(boxes, t.x), t.derivatives["end_rows_jacobian"](*arguments)[1])
        return ca.Function("end_rows", arguments, [value]), ca.Function("end_slope", arguments, [slope])

    def end(self) -> tuple[ca.Function, ca.Function]:
        """Terminal cost of (x, p, w); its gradient and Hessian."""
        t = self.t
        arguments = [t.x, t.p, t.w]
        value, slope, curve = _barrier(t.end.barriers, t.x)
        _, gradient, hessian = t.derivatives["terminal_quadratic"](*arguments)
        quadratic = ca.cse([gradient + slope, ca.triu(hessian + ca.diag(curve))])
        cost = ca.Function("end_cost", arguments, [t.values["terminal"](*arguments) + value])
        return cost, ca.Function("end_quadratic", arguments, quadratic)


# ---------------------------------------------------------------------- the whole program
class Program:
    """The nonlinear program: unknowns (x_0, u_0, …, x_N), parameter x0; rows [gap; start (k = 0); equality; hard] per stage.

    Hard rows are h ≥ 0; those of the state alone do not count at the measured state and are left out there.
    ``functions``: what CasADi's ``nlpsol`` asks for, with the names under which it looks for them in a library; the
    Hessian is Gauss-Newton's, which does not depend on the multipliers.
    """

    def __init__(self, solver: Solver) -> None:
        t = self.t = solver.problem
        self.samples, self.stages = sampled(solver), Stages(t)
        self.n, self.nx, self.nu = t.ocp.intervals, t.nx, t.nu
        self.width, self.ng = self.nx + self.nu, t.equality.shape[0]
        local = self.nx + self.ng
        #: Rows of a stage that count at node 0.
        self.first = [*range(local), *(local + i for i, r in enumerate(t.path.rows) if not r.state_only)]
        self.per_stage = local + len(t.path.rows)
        self.rows = len(self.first) + self.nx + (self.n - 1) * self.per_stage + len(t.end.rows)
        self.x, self.p = ca.MX.sym("x", self.n * self.width + self.nx), ca.MX.sym("p", self.nx)

    def equality(self) -> np.ndarray:
        """Which rows (rows,) are to be zero; the others are to be non-negative."""
        kinds = np.array([r.kind == Kind.EQUAL for r in self.t.path.rows], bool)
        stage = np.concatenate([np.ones(self.nx + self.ng, bool), kinds])
        first = stage[self.first]
        start = [first[: self.nx], np.ones(self.nx, bool), first[self.nx :]]
        end = np.array([r.kind == Kind.EQUAL for r in self.t.end.rows], bool)
        return np.concatenate([*start, np.tile(stage, self.n - 1), end])

    def trajectory(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """States (N + 1, nx) and inputs (N, nu) of a vector of unknowns."""
        table = z[: self.n * self.width].reshape(self.n, self.width)
        return np.vstack([table[:, : self.nx], z[-self.nx :]]), table[:, self.nx :]

    def _path(self) -> list[Any]:
        """Arguments of the stage functions, one column per interval."""
        s, z = self.samples, ca.reshape(self.x[: self.n * self.width], self.width, self.n)
        w = ca.repmat(ca.DM(s.w), 1, self.n)
        return [z[: self.nx, :], z[self.nx :, :], ca.DM(s.p[:-1].T), w, ca.DM(s.h[None, :])]

    def _end(self) -> list[Any]:
        return [self.x[-self.nx :], ca.DM(self.samples.p[-1]), ca.DM(self.samples.w)]

    def cost(self) -> ca.MX:
        return ca.sum2(self.stages.cost().map(self.n)(*self._path())) + self.stages.end()[0](*self._end())

    def constraints(self) -> ca.MX:
        path = self._path()
        rows = self.stages.constraint().map(self.n)(*path)
        gaps = rows[: self.nx, :] + ca.horzcat(path[0][:, 1:], self.x[-self.nx :])
        blocks = ca.vec(ca.vertcat(gaps[:, 1:], rows[self.nx :, 1:]))
        start = [gaps[:, 0], self.x[: self.nx] - self.p, rows[self.first[self.nx :], 0]]
        return ca.vertcat(*start, blocks, self.stages.end_rows()[0](*self._end()))

    def _gap(self, k: int) -> int:
        """First row of stage k; k = N: of the end's rows."""
        return 0 if k == 0 else len(self.first) + self.nx + (k - 1) * self.per_stage

    def _column_patterns(self) -> tuple[list[list[int]], list[list[int]], list[int]]:
        """Rows of every column of stage 0 and of a later stage, counted from the stage's first row (the unit entry of a
        later stage belongs to the gap before it); and where stage 0 finds its values in a later stage's order."""
        nx, local = self.nx, self.stages.jacobian().sparsity_out(0)
        place = {r: i for i, r in enumerate(self.first)}
        first, later, order, start = [], [], [], 0
        for c in range(self.width):
            rows = list(local.row()[local.colind()[c] : local.colind()[c + 1]])
            unit = c < nx
            later.append([c] * unit + rows)
            values = {r: start + unit + i for i, r in enumerate(rows) if r in place}
            gap, rest = [r for r in values if r < nx], [r for r in values if r >= nx]
            first.append([place[r] for r in gap] + [nx + c] * unit + [place[r] + nx for r in rest])
            order += [values[r] for r in gap] + [start] * unit + [values[r] for r in rest]
            start += len(rows) + unit
        return first, later, order

    def _jacobian_pattern(self) -> tuple[ca.Sparsity, list[int]]:
        nx, n = self.nx, self.n
        first, later, order = self._column_patterns()
        rows: list[int] = []
        ends = [0]
        for k in range(n):
            for c, pattern in enumerate(later if k else first):
                unit = int(k > 0 and c < nx)
                rows += [self._gap(k - 1) + c] * unit + [self._gap(k) + r for r in pattern[unit:]]
                ends.append(len(rows))
        last = self.stages.end_rows()[1].sparsity_out(0)
        for c in range(nx):
            own = last.row()[last.colind()[c] : last.colind()[c + 1]]
            rows += [self._gap(n - 1) + c, *(self._gap(n) + r for r in own)]
            ends.append(len(rows))
        return ca.Sparsity(self.rows, self.x.shape[0], ends, rows), order

    def jacobian(self) -> ca.MX:
        """Of :meth:`constraint`: the columns of a stage follow each other, so its values are one block of non-zeros."""
        pattern, order = self._jacobian_pattern()
        unit = ca.horzcat(ca.SX.eye(self.nx), ca.SX(self.nx, self.nu))
        stacked = ca.vertcat(unit, ca.SX(self.stages.jacobian()(*self.stages.symbols)))
        values = ca.Function("stage_columns", self.stages.symbols, [_nonzeros(stacked)])
        table = values.map(self.n)(*self._path())
        slope = self.stages.end_rows()[1]
        last = ca.vertcat(ca.SX.eye(self.nx), ca.SX(slope(self.t.x, self.t.p, self.t.w)))
        end = ca.Function("end_columns", [self.t.x, self.t.p, self.t.w], [_nonzeros(last)])
        return ca.MX(pattern, ca.vertcat(table[order, 0], ca.vec(table[:, 1:]), end(*self._end())))

    def _quadratic(self, full: bool) -> tuple[ca.MX, ca.MX]:
        """Gradient and Hessian (both triangles if ``full``) of the cost."""
        both = ca.triu2symm if full else lambda h: h
        g, h = self.stages.quadratic()(*self.stages.symbols)
        h = ca.SX(both(h))
        name = f"stage_values_{'full' if full else 'upper'}"
        values = ca.Function(name, self.stages.symbols, [g, _nonzeros(h)])
        gradients, hessians = values.map(self.n)(*self._path())
        g_end, h_end = self.stages.end()[1](*self._end())
        h_end = both(h_end)
        pattern = ca.diagcat(*[h.sparsity()] * self.n, h_end.sparsity())
        return ca.vertcat(ca.vec(gradients), g_end), ca.MX(pattern, ca.vertcat(ca.vec(hessians), h_end.nz[:]))

    def gradient(self) -> ca.MX:
        """Of :meth:`cost`."""
        return self._quadratic(full=False)[0]

    def functions(self) -> dict[str, ca.Function]:
        """The program and its derivatives; ``nlp_hess_l`` in the form that Fatrop asks for, ``hess_lag`` in IPOPT's."""
        arguments, f, g = [self.x, self.p], self.cost(), self.constraints()
        gradient, hessian = self._quadratic(full=True)
        upper = self._quadratic(full=False)[1]
        lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", self.rows)
        second = [*arguments, lam_f, lam_g]
        names = (["x", "p"], ["x", "p", "lam_f", "lam_g"])
        nothing, none = ca.DM.zeros(self.x.shape[0]), ca.DM.zeros(self.nx)
        unused = ["f", "g", "grad_gamma_x", "grad_gamma_p"]  # asked for, but only for multipliers that are not read
        full = ("nlp_hess_l", second, [nothing, lam_f * hessian], names[1], ["grad_gamma_x", "hess_gamma_x_x"])
        target = (
            ("nlp", arguments, [f, g], names[0], ["f", "g"]), ("nlp_f", arguments, [f], names[0], ["f"]),
            ("nlp_g", arguments, [g], names[0], ["g"]), ("nlp_grad_f", arguments, [gradient], names[0], ["grad_f_x"]),
            ("nlp_jac_g", arguments, [g, self.jacobian()], names[0], ["g", "jac_g_x"]), full,
            ("nlp_grad", second, [f, g, nothing, none], names[1], unused),
            ("grad_f", arguments, [f, gradient], names[0], ["f", "grad_f_x"]),
            ("hess_lag", second, [lam_f * upper], names[1], ["triu_hess_gamma_x_x"]),
        )  # fmt: skip
        return {entry[0]: ca.Function(*entry) for entry in target}


def compiler() -> str | None:
    """The C compiler's path, if there is one."""
    return shutil.which("cc") or shutil.which("gcc")


def run_whole(command: list[str], seconds: float) -> None:
    """Run a program for at most ``seconds``; whatever ends the wait, also Ctrl-C, ends all processes that it has started: a compiler
    starts others, which may work on for minutes. Raises :class:`subprocess.SubprocessError` where it fails or takes longer."""
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, process_group=0) as process:
        try:
            code = process.wait(seconds)
        finally:
            if process.returncode is None:
                os.killpg(process.pid, signal.SIGKILL)
    if code:
        raise subprocess.CalledProcessError(code, command)


def compiled_library(functions: dict[str, ca.Function], seconds: float = 600.0) -> Path | str:
    """A shared library of the functions, kept beside the kernels' cache; a message when it cannot be made."""
    found = compiler()
    if found is None:
        return "no C compiler (cc, gcc) was found"
    generator = ca.CodeGenerator("program.c", {"with_header": False, "verbose": False})
    for function in functions.values():
        generator.add(function)
    code = generator.dump()
    flags = ("-O1" if len(code) > LARGE else "-O2", *COMPILER_FLAGS)
    key = hashlib.sha256((code + found + " ".join(flags)).encode()).hexdigest()[:32]
    folder = library_folder()
    library = folder / f"{key}.so"
    if trusted_file(library):
        return library
    source, partial = folder / f"{key}.c", folder / f"{key}.part.so"
    source.write_text(code)
    command = [found, *flags, "-o", str(partial), str(source), "-lm"]
    try:
        run_whole(command, seconds)
    except subprocess.SubprocessError as error:
        return f"the C compiler failed: {str(error)[:200]}"
    partial.chmod(0o700)
    partial.replace(library)
    return library

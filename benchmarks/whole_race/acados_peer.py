"""acados on the program of the race: its own build, found by ``ACADOS_INSTALL_DIR`` (benchmarks/README.md says how to build it).

The same functions as the other peers', compiled with the same flags, stage by stage: cost with our Gauss-Newton Hessian, one
step of the same integrator, bounds as bounds, equality and other hard rows as nonlinear rows.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import re
import subprocess
import time
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from wbmpc.benchmark.program import COMPILER_FLAGS, LARGE, Program, Samples, compiler, library_folder
from wbmpc.kernel.cache import trusted_file
from wbmpc.ocp.constraint_classification import Kind, Row

Array = np.ndarray
VARIABLE = "ACADOS_INSTALL_DIR"
SHIM = Path(__file__).with_name("acados_shim.c")
#: No bound, as acados reads it.
NONE = 1e10
#: What of CMake's cache a figure depends on.
_FLAGS = ("BLASFEO_TARGET", "HPIPM_TARGET", "LA", "CMAKE_BUILD_TYPE", "CMAKE_C_FLAGS_RELEASE", "ACADOS_WITH_OPENMP")


class NoAcados(Exception):
    """acados is not there, or nothing can be compiled against it: why."""


@dataclass(frozen=True)
class Settings:
    """What of acados is searched. ``blocks``: stages of the partially condensed QP (0: as many as the problem has, −1: full condensing);
    ``mode``: HPIPM's; ``warm``: the QP solver starts from the last solution (2: multipliers too); ``merit``: backtracking instead of full steps;
    ``tolerance``: of the QP; ``mu0``: its first barrier parameter."""

    blocks: int = 0
    mode: str = "SPEED_ABS"
    warm: int = 0
    merit: bool = False
    tolerance: float = 1e-8
    mu0: float = 1.0

    def __str__(self) -> str:
        parts = {"N2": self.blocks or "N", "mode": self.mode, "warm": self.warm, "tol": f"{self.tolerance:g}"}
        parts |= {"mu0": f"{self.mu0:g}", "step": "merit" if self.merit else "full"}
        return " ".join(f"{k}={v}" for k, v in parts.items())


def installation() -> Path:
    """The directory of acados. Raises :class:`NoAcados`."""
    given = os.environ.get(VARIABLE)
    if not given:
        raise NoAcados(f"{VARIABLE} is not set")
    folder = Path(given).expanduser()
    needed = [folder / "lib" / f"lib{n}.so" for n in ("acados", "hpipm", "blasfeo")]
    missing = [str(p) for p in [*needed, folder / "include" / "acados_c" / "ocp_nlp_interface.h"] if not p.is_file()]
    if missing:
        raise NoAcados(f"{VARIABLE}: there is no {missing[0]}")
    if compiler() is None:
        raise NoAcados("no C compiler (cc, gcc) was found")
    return folder


def build_description() -> dict[str, str]:
    """Commit and flags of the build, as far as its files name them."""
    folder = installation()
    commit, flags = folder / "lib" / "git_commit_hash", folder / "build" / "CMakeCache.txt"
    out = {"commit": commit.read_text().strip() if commit.is_file() else "unknown"}
    text = flags.read_text() if flags.is_file() else ""
    for name in _FLAGS:
        found = re.search(rf"^{name}:\w+=(.*)$", text, re.MULTILINE)
        out[name] = found[1] if found else "unknown"
    return out


# ---------------------------------------------------------------------- functions of the stages
def _one_sided(rows: list[Row], size: int, start: int) -> tuple[list[int], Array, Array]:
    """Variables (counted from ``start``) of box rows, with the tightest bounds: indices, lower, upper."""
    bounds: dict[int, list[float]] = {}
    for row in rows:
        i = row.variable - start
        if not 0 <= i < size:
            continue
        low, high = bounds.setdefault(i, [-NONE, NONE])
        at = -row.offset / row.sign
        equal = row.kind == Kind.EQUAL
        if row.sign > 0.0 or equal:
            low = max(low, at)
        if row.sign < 0.0 or equal:
            high = min(high, at)
        bounds[i] = [low, high]
    index = sorted(bounds)
    return index, np.array([bounds[i][0] for i in index]), np.array([bounds[i][1] for i in index])


class StageFunctions:
    """What acados asks for of a program: functions of (x, u, [z], parameters), with derivatives by [u; x], transposed.

    Parameters of a stage: [p; w; h]. ``rows``: how many nonlinear rows of the first, the middle and the last stages.
    """

    def __init__(self, program: Program) -> None:
        self.program, t, stages = program, program.t, program.stages
        self.parameter = ca.vertcat(t.p, t.w, t.h)
        self.size = int(self.parameter.shape[0])
        value, slope = stages.constraint()(*stages.symbols), stages.jacobian()(*stages.symbols)
        nx, boxes = t.nx, len(t.path.boxes)
        rows = [*range(nx, nx + program.ng), *range(nx + program.ng + boxes, program.per_stage)]
        own = [None] * program.ng + list(t.path.general)
        first = [r for r, row in zip(rows, own, strict=True) if row is None or not row.state_only]
        kinds = [row is None or row.kind == Kind.EQUAL for row in own]
        self.equal = [[e for e, r in zip(kinds, rows, strict=True) if r in first], kinds]
        self.equal.append([row.kind == Kind.EQUAL for row in t.end.general])
        self.rows = [len(e) for e in self.equal]
        gradient, hessian = stages.quadratic()(*stages.symbols)
        turn = lambda m: ca.horzcat(m[:, nx:], m[:, :nx])
        full = ca.triu2symm(hessian)
        full = turn(turn(full).T)
        cost = stages.cost()(*stages.symbols)
        make = self._function
        self.functions = [
            make("step_value", [-value[:nx]], False),
            make("step_slope", [-value[:nx], -turn(slope[:nx, :]).T], False),
            make("first_rows", [value[first]]),
            make("first_rows_slope", [value[first], turn(slope[first, :]).T]),
            make("path_rows", [value[rows]]),
            make("path_rows_slope", [value[rows], turn(slope[rows, :]).T]),
            make("path_cost", [cost]),
            make("path_cost_quadratic", [cost, ca.vertcat(gradient[nx:], gradient[:nx]), full]),
            *self._last(),
        ]

    def _last(self) -> list[ca.Function]:
        t, stages = self.program.t, self.program.stages
        arguments = [t.x, t.p, t.w]
        value, slope = (f(*arguments) for f in stages.end_rows())
        value, slope = value[len(t.end.boxes) :], slope[len(t.end.boxes) :, :]
        cost, quadratic = stages.end()
        gradient, hessian = quadratic(*arguments)
        make = lambda name, out: self._function(name, out, inputs=0)
        return [
            make("last_rows", [value]),
            make("last_rows_slope", [value, slope.T]),
            make("last_cost", [cost(*arguments)]),
            make("last_cost_quadratic", [cost(*arguments), gradient, ca.triu2symm(hessian)]),
        ]

    def _function(self, name: str, out: list[Any], algebraic: bool = True, inputs: int | None = None) -> ca.Function:
        t = self.program.t
        u = t.u if inputs is None else ca.SX.sym("u", inputs)
        arguments = [t.x, u, *([ca.SX.sym("z", 0)] if algebraic else []), self.parameter]
        return ca.Function(name, arguments, ca.cse([ca.densify(o) if o.is_column() else o for o in map(ca.SX, out)]))

    def parameters(self, samples: Samples) -> Array:
        """Of all stages (N + 1, size)."""
        h = np.append(samples.h, 0.0)[:, None]
        w = np.tile(np.asarray(samples.w, float).ravel(), (len(h), 1))
        return np.ascontiguousarray(np.hstack([samples.p, w, h]))


def _compiled(functions: list[ca.Function], folder: Path, seconds: float = 600.0) -> Path:
    """The shared library of the functions and the shim, linked with acados."""
    found = compiler()
    assert found is not None
    generator = ca.CodeGenerator("program.c", {"with_header": False, "verbose": False, "casadi_int": "int"})
    for function in functions:
        generator.add(function)
    code = generator.dump()
    text = code + "\n" + SHIM.read_text()
    include, library = folder / "include", folder / "lib"
    paths = [f"-I{include / p}" for p in ("", "acados", "blasfeo/include", "hpipm/include")]
    links = [f"-L{library}", f"-Wl,--disable-new-dtags,-rpath,{library}", "-lacados", "-lhpipm", "-lblasfeo", "-lm"]
    flags = ["-O1" if len(code) > LARGE else "-O2", *COMPILER_FLAGS, *paths]
    stamp = str((library / "libacados.so").stat().st_mtime_ns)
    key = hashlib.sha256("\n".join([text, found, *flags, *links, stamp]).encode()).hexdigest()[:32]
    target = library_folder() / f"acados-{key}.so"
    if not trusted_file(target):
        source, partial = target.with_suffix(".c"), target.with_suffix(".part.so")
        source.write_text(text)
        command = [found, *flags, "-o", str(partial), str(source), *links]
        try:
            subprocess.run(command, check=True, capture_output=True, text=True, timeout=seconds)
        except subprocess.TimeoutExpired:
            raise NoAcados(f"the C compiler took more than {seconds:.0f} s") from None
        except subprocess.CalledProcessError as error:
            raise NoAcados(f"the C compiler failed: {error.stderr[:400]}") from None
        partial.chmod(0o700)
        partial.replace(target)
    return target


class _Handle(ctypes.Structure):
    """``Peer`` of the shim."""

    _fields_ = [(n, ctypes.c_void_p) for n in ("plan", "config", "dims", "opts", "in_", "out", "solver")]


@cache
def _library(path: Path) -> ctypes.CDLL:
    library = ctypes.CDLL(str(path))
    pointer = ctypes.c_void_p
    library.peer_create.restype = ctypes.POINTER(_Handle)
    library.peer_create.argtypes = [ctypes.c_int] * 4 + [pointer] + [ctypes.c_int] * 3
    library.peer_solve.argtypes = [ctypes.POINTER(_Handle), pointer]
    for name in ("peer_finish", "peer_reset", "peer_free"):
        getattr(library, name).argtypes = [ctypes.POINTER(_Handle)]
    text = ctypes.c_char_p
    library.ocp_nlp_solver_opts_set.argtypes = [pointer, pointer, text, pointer]
    library.ocp_nlp_constraints_model_set.argtypes = [pointer] * 4 + [ctypes.c_int, text, pointer]
    library.ocp_nlp_in_set.argtypes = [pointer] * 3 + [ctypes.c_int, text, pointer]
    for name in ("ocp_nlp_set_all", "ocp_nlp_get_all"):
        getattr(library, name).argtypes = [pointer] * 3 + [text, pointer]
    library.ocp_nlp_get.argtypes = [pointer, text, pointer]
    return library


class AcadosProblem:
    """A program compiled for acados; solvers with different settings share it."""

    def __init__(self, program: Program) -> None:
        self.program, self.stages = program, StageFunctions(program)
        self.library = _library(_compiled(self.stages.functions, installation()))
        t, nx, nu = program.t, program.nx, program.nu
        boxes = list(t.path.boxes)
        self.u_bounds = _one_sided(boxes, nu, nx)
        self.x_bounds = _one_sided(boxes, nx, 0)
        self.end_bounds = _one_sided(list(t.end.boxes), nx, 0)


class Acados:
    """One acados solver. ``iterations``: at most this many (one and real-time: prepare and feed back in one call)."""

    def __init__(
        self, problem: AcadosProblem, settings: Settings, iterations: int = 100, *, real_time: bool = False
    ) -> None:
        self.problem, self.settings, program = problem, settings, problem.program
        self.n, self.nx, self.nu = program.n, program.nx, program.nu
        stages, self._library = problem.stages, problem.library
        bounds = [(self.nx, len(problem.u_bounds[0])), (len(problem.x_bounds[0]), len(problem.u_bounds[0]))]
        bounds.append((len(problem.end_bounds[0]), 0))
        sizes = np.array([[*b, r] for b, r in zip(bounds, stages.rows, strict=True)], np.int32)
        self._peer = self._library.peer_create(
            self.n, self.nx, self.nu, stages.size, sizes.ctypes.data, real_time, settings.merit, settings.blocks < 0
        )
        self._free = self._library.peer_free
        self._options(iterations, real_time)
        self._set_bounds()
        self.set_parameters(program.samples)
        if self._library.peer_finish(self._peer):
            raise NoAcados("its solver could not be set up")
        self.x, self.u = np.zeros((self.n + 1, self.nx)), np.zeros((self.n, self.nu))

    def __del__(self) -> None:
        if hasattr(self, "_peer") and self._peer.contents.solver:
            self._free(self._peer)

    def _option(self, name: str, value: Any) -> None:
        kinds: dict[type, Any] = {bool: ctypes.c_bool, int: ctypes.c_int, float: ctypes.c_double}
        held = ctypes.create_string_buffer(value.encode()) if isinstance(value, str) else kinds[type(value)](value)
        peer = self._peer.contents
        self._library.ocp_nlp_solver_opts_set(peer.config, peer.opts, name.encode(), ctypes.addressof(held))

    def _options(self, iterations: int, real_time: bool) -> None:
        s = self.settings
        self._option("qp_hpipm_mode", s.mode)  # first, for it sets others
        for name in ("stat", "eq", "ineq", "comp"):
            self._option(f"qp_tol_{name}", s.tolerance)
            self._option(f"tol_{name}", 1e-9)  # the race stops it, by the common measure
        self._option("qp_iter_max", 200)
        self._option("qp_mu0", s.mu0)
        self._option("qp_warm_start", s.warm)
        self._option("warm_start_first_qp", s.warm > 0)
        if s.blocks >= 0:
            self._option("qp_cond_N", s.blocks or self.n)
        if real_time:
            self._option("rti_phase", 0)
        else:
            self._option("max_iter", iterations)

    def _bound(self, stage: int, name: str, values: Array) -> None:
        if not values.size:
            return
        values = np.ascontiguousarray(values, np.int32 if name.startswith("idx") else float)
        p = self._peer.contents
        self._library.ocp_nlp_constraints_model_set(
            p.config, p.dims, p.in_, p.out, stage, name.encode(), values.ctypes.data
        )

    def _set_bounds(self) -> None:
        problem, nx = self.problem, self.nx
        for k in range(self.n + 1):
            index, low, high = problem.end_bounds if k == self.n else problem.x_bounds
            if k == 0:
                index, low, high = list(range(nx)), np.zeros(nx), np.zeros(nx)
                self._bound(0, "idxbxe", np.arange(nx))
            for name, values in (("idxbx", np.array(index)), ("lbx", low), ("ubx", high)):
                self._bound(k, name, values)
            if k < self.n:
                for name, values in zip(("idxbu", "lbu", "ubu"), problem.u_bounds, strict=True):
                    self._bound(k, name, np.array(values))
            equal = np.array(problem.stages.equal[0 if k == 0 else 2 if k == self.n else 1], bool)
            self._bound(k, "lh", np.zeros(equal.size))
            self._bound(k, "uh", np.where(equal, 0.0, NONE))

    def set_parameters(self, samples: Samples) -> None:
        """References and modes of all stages."""
        p, values = self._peer.contents, self.problem.stages.parameters(samples)
        for k, row in enumerate(values):
            self._library.ocp_nlp_in_set(p.config, p.dims, p.in_, k, b"parameter_values", row.ctypes.data)

    def _all(self, call: Any, field: bytes, values: Array) -> None:
        p = self._peer.contents
        call(p.solver, p.in_, p.out, field, values.ctypes.data)

    def reset(self) -> None:
        """Forget multipliers and the QP solver's memory (and the trajectory)."""
        self._library.peer_reset(self._peer)

    def warm_start(self, x: Array, u: Array) -> None:
        """States (N + 1, nx) and inputs (N, nu); multipliers stay."""
        self.x[:], self.u[:] = x, u
        self._all(self._library.ocp_nlp_set_all, b"x", self.x)
        self._all(self._library.ocp_nlp_set_all, b"u", self.u)

    def solve(self, x0: Array) -> tuple[int, float]:
        """acados' status, and processor time [ms] of the call."""
        x0 = np.ascontiguousarray(x0, float)
        address = x0.ctypes.data
        start = time.process_time()
        status = self._library.peer_solve(self._peer, address)
        return int(status), 1e3 * (time.process_time() - start)

    def trajectory(self) -> tuple[Array, Array]:
        """Copies of states and inputs."""
        self._all(self._library.ocp_nlp_get_all, b"x", self.x)
        self._all(self._library.ocp_nlp_get_all, b"u", self.u)
        return self.x.copy(), self.u.copy()

    def number(self, field: str) -> float:
        """A time [s] or residual that acados measured."""
        out = ctypes.c_double()
        self._library.ocp_nlp_get(self._peer.contents.solver, field.encode(), ctypes.addressof(out))
        return out.value

    def count(self, field: str) -> int:
        """A count of acados: "sqp_iter", "qp_iter"."""
        out = ctypes.c_int()
        self._library.ocp_nlp_get(self._peer.contents.solver, field.encode(), ctypes.addressof(out))
        return out.value


def described(settings: Settings) -> dict[str, Any]:
    """Settings for the figures."""
    return asdict(settings)

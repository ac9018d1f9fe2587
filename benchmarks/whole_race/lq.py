"""The quadratic problem of one iteration, from CasADi's interpreter, and its solution by our Riccati kernel alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca
import numpy as np

from wbmpc.benchmark.program import Program
from wbmpc.kernel import Kernel
from wbmpc.solver.workspace import aligned
from whole_race import loops

Array = np.ndarray


@dataclass(frozen=True)
class LQProblem:
    """minimize Σ ½ δzᵀ H δz + gᵀ δz, δx⁺ = AB δz + b, CD δz + e = 0, δx_0 given; z = (x, u).

    ``ab`` (N, nx, nz), ``b`` (N, nx), ``h`` (N, nz, nz), ``g`` (N, nz), ``cd`` (N, ng, nz), ``e`` (N, ng), terminal
    ``h_end`` (nx, nx), ``g_end`` (nx,), ``dx0`` (nx,).
    """

    ab: Array
    b: Array
    h: Array
    g: Array
    cd: Array
    e: Array
    h_end: Array
    g_end: Array
    dx0: Array


def linearize(program: Program, x: Array, u: Array, x0: Array) -> LQProblem:
    """The quadratic problem at the trajectory x (N + 1, nx), u (N, nu)."""
    s, stages, nx = program.samples, program.stages, program.nx
    if program.t.path.rows or program.t.end.rows:
        raise ValueError("the quadratic problem has no hard rows: use limits='soft'")
    rows, jacobian, quadratic = stages.constraint(), stages.jacobian(), stages.quadratic()
    dense = lambda m: np.array(ca.DM(ca.densify(m)))
    out: dict[str, list[Array]] = {k: [] for k in ("ab", "b", "h", "g", "cd", "e")}
    for k in range(program.n):
        a = (x[k], u[k], s.p[k], s.w, s.h[k])
        value, slope = dense(rows(*a)).ravel(), dense(jacobian(*a))
        gradient, hessian = (dense(m) for m in quadratic(*a))
        out["ab"].append(-slope[:nx])
        out["b"].append(-value[:nx] - x[k + 1])
        out["cd"].append(slope[nx:])
        out["e"].append(value[nx:])
        out["h"].append(hessian + np.triu(hessian, 1).T)
        out["g"].append(gradient.ravel())
    g_end, h_end = (dense(m) for m in stages.end()[1](x[-1], s.p[-1], s.w))
    arrays = {k: np.array(v) for k, v in out.items()}
    return LQProblem(**arrays, h_end=h_end + np.triu(h_end, 1).T, g_end=g_end.ravel(), dx0=x0 - x[0])


class Packed(NamedTuple):
    """A quadratic problem in the kernel's layout, room for its solution, and the kernel, whose code must not go away."""

    kernel: Kernel
    ab: Array
    h: Array
    e: Array
    eps: Array
    end: Array
    value: Array
    k: Array
    scratch: Array
    dx: Array
    du: Array
    sizes: Array


def pack(kernel: Kernel, lq: LQProblem, softness: Array) -> Packed:
    """Matrices as the Riccati kernel reads them: the node vector is [x, 1, u], vectors padded to eight."""
    s, n = kernel.sizes, len(lq.ab)
    nx, nu, ng, lx, lz, lg = s.nx, s.nu, s.ng, s.lx, s.lz, s.lg
    place = [*range(nx), *range(nx + 1, s.nz)]
    new = lambda *shape: aligned(int(np.prod(shape))).reshape(shape)
    ab, h, e = new(n, nx + 1, lz), new(n, s.nz, lz), new(n, max((s.equality_buffer() + 7) // 8 * 8, 8))
    ab[:, nx, nx] = 1.0
    ab[:, :nx, place], ab[:, :nx, nx] = lq.ab, lq.b
    h[np.ix_(range(n), place, place)] = lq.h
    h[:, nx, :nx], h[:, :nx, nx] = lq.g[:, :nx], lq.g[:, :nx]
    h[:, nx + 1 :, nx] = lq.g[:, nx:]
    for k in range(n if ng else 0):
        rows, transposed = e[k, : ng * lz].reshape(ng, lz), e[k, ng * lz :][: nu * lg].reshape(nu, lg)
        rows[:, place], rows[:, nx] = lq.cd[k], lq.e[k]
        transposed[:, :ng] = lq.cd[k, :, nx:].T
    end, eps = new(nx + 1, lx), new(lg)
    end[:nx, :nx], end[nx, :nx], end[:nx, nx] = lq.h_end, lq.g_end, lq.g_end
    eps[:ng] = softness + 1e-14
    dx = new(n + 1, lx)
    dx[:, nx] = 1.0
    dx[0, :nx] = lq.dx0
    node = [ab[0].size, h[0].size, e[0].size, nu * lx]
    sizes = np.array([n, nx, nu, lx, lz, *node], dtype=np.int64)
    return Packed(
        kernel, ab, h, e, eps, end, new(nx + 1, lx), new(n, nu, lx), new(s.scratch()["total"]), dx, new(n, nu), sizes
    )


def our_step(m: Packed) -> Array:
    """The step (x_0, u_0, …, x_N) of the Riccati kernel."""
    eliminate(m)
    substitute(m)
    nx = int(m.sizes[loops.NX])
    return np.concatenate([np.hstack([m.dx[:-1, :nx], m.du]).ravel(), m.dx[-1, :nx]])


def eliminate(m: Packed) -> None:
    """The backward pass."""
    address = m.kernel.address("riccati_node")
    loops.backward(address, m.sizes, m.ab, m.h, m.e, m.eps, m.end, m.value, m.k, m.scratch)


def substitute(m: Packed) -> None:
    """The forward pass."""
    loops.forward(m.sizes, m.ab, m.k, m.dx, m.du)

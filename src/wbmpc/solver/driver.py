"""One sequential quadratic programming solve as compiled code: linearise, Riccati, step, trial point.

The letters are those of docs/derivations.md. Every function works on the memory ``m`` (doubles) and the table ``o``
(integers) of :mod:`wbmpc.solver.workspace` and allocates nothing. ``at(o, B, i)`` style offsets are written out.
"""

from __future__ import annotations

import numpy as np

from wbmpc.kernel.compiled import ADDRESSES as _FUNCTIONS
from wbmpc.solver import workspace as _w
from wbmpc.solver.compilation import call2, call5, call7, compiled

CONVERGED, ITERATION_LIMIT, NO_STEP, NOT_FINITE = 0, 1, 2, 3

N, NX, NU, NG, LX, LZ, LG, NP, RK4, PATH_BOXES, END_BOXES, QUATERNIONS, BASE = range(len(_w.DIMENSIONS))
_place = {name: _w.OFFSETS + i for i, name in enumerate(_w.BLOCKS)}
GRID, X, U, XT, UT = (_place[n] for n in ("grid", "x", "u", "x_trial", "u_trial"))
DX, DU, P, W, AB, H, E, EPS, K = (_place[n] for n in ("dx", "du", "p", "w", "ab", "h", "e", "eps", "k"))
VALUE, TERMINAL, SCRATCH, G = (_place[n] for n in ("value", "terminal", "scratch", "gradient"))
J1, J2, S1, S2, F, SMALL, BOXES = (_place[n] for n in ("j1", "j2", "s1", "s2", "f", "small", "boxes"))
_call = {name: _w.ADDRESSES + i for i, name in enumerate(_FUNCTIONS)}
DYNAMICS, COST, EQUALITY, END_COST = (_call[n] for n in ("dynamics", "cost", "equality", "terminal"))
DYNAMICS_J, COST_Q, EQUALITY_J = (_call[n] for n in ("dynamics_jacobian", "cost_quadratic", "equality_jacobian"))
END_Q, RICCATI, CHAIN = (_call[n] for n in ("terminal_quadratic", "riccati_node", "chain"))
ARG, RES, INDEX = _w.POINTERS, _w.POINTERS + 8, _w.INDICES


@compiled
def stage(o, function, x, u, p, r0, r1, r2):  # type: ignore[no-untyped-def]
    """Call a stage function of (x, u, p, w, h); all arguments are offsets into the memory."""
    base = o[BASE]
    o[ARG], o[ARG + 1], o[ARG + 2] = base + 8 * x, base + 8 * u, base + 8 * p
    o[ARG + 3], o[ARG + 4] = base + 8 * o[W], base + 8 * (o[SMALL] + 2)
    o[RES], o[RES + 1], o[RES + 2] = base + 8 * r0, base + 8 * r1, base + 8 * r2
    call2(o[function], o.ctypes.data + 8 * ARG, o.ctypes.data + 8 * RES)


@compiled
def stage_end(o, function, x, p, r0, r1):  # type: ignore[no-untyped-def]
    """Call a terminal stage function of (x, p, w)."""
    base = o[BASE]
    o[ARG], o[ARG + 1], o[ARG + 2] = base + 8 * x, base + 8 * p, base + 8 * o[W]
    o[RES], o[RES + 1], o[RES + 2] = base + 8 * r0, base + 8 * r1, base + 8 * r1
    call2(o[function], o.ctypes.data + 8 * ARG, o.ctypes.data + 8 * RES)


@compiled
def barrier_value(m, o, start, count, x, u):  # type: ignore[no-untyped-def]
    """Σ barrier(h) of boxes ``start`` … ; logarithms of products of h with the same μ."""
    total, product, mu, first = 0.0, 1.0, 0.0, o[NX] + 1
    for r in range(start, start + count):
        i, b = o[INDEX + r], o[BOXES] + 4 * r
        value = m[x + i] if i < first else m[u + i - first]
        h, delta = m[b] * value + m[b + 1], m[b + 3]
        if h > delta:
            if m[b + 2] != mu or product > 1e100 or product < 1e-100:
                total -= mu * np.log(product)
                product, mu = 1.0, m[b + 2]
            product *= h
        else:
            q = (h - 2.0 * delta) / delta
            total += m[b + 2] * (0.5 * (q * q - 1.0) - np.log(delta))
    return total - mu * np.log(product)


@compiled
def add_barrier(m, o, start, count, x, u, scale, matrix, ld):  # type: ignore[no-untyped-def]
    """Gradient and curvature of the boxes, times ``scale``, onto a matrix of the extended node vector."""
    constant = o[NX]
    for r in range(start, start + count):
        i, b = o[INDEX + r], o[BOXES] + 4 * r
        sign, mu, delta = m[b], m[b + 2], m[b + 3]
        h = sign * (m[x + i] if i < constant else m[u + i - constant - 1]) + m[b + 1]
        if h > delta:
            slope, curve = -mu / h, mu / (h * h)
        else:
            slope, curve = mu * (h - 2.0 * delta) / (delta * delta), mu / (delta * delta)
        m[matrix + i * ld + i] += scale * curve * sign * sign
        m[matrix + i * ld + constant] += scale * slope * sign
        if i < constant:
            m[matrix + constant * ld + i] += scale * slope * sign


@compiled
def normalise(m, o, x, ab):  # type: ignore[no-untyped-def]
    """Unit length of the quaternions of a state; with ``ab`` ≥ 0 the derivative of that onto its rows."""
    lz, boxes = o[LZ], o[PATH_BOXES] + o[END_BOXES]
    for s in range(o[QUATERNIONS]):
        q = o[INDEX + boxes + s]
        norm = np.sqrt(m[x + q] ** 2 + m[x + q + 1] ** 2 + m[x + q + 2] ** 2 + m[x + q + 3] ** 2)
        for i in range(q, q + 4):
            m[x + i] /= norm
        if ab >= 0:
            for c in range(lz):
                along = 0.0
                for i in range(q, q + 4):
                    along += m[x + i] * m[ab + i * lz + c]
                for i in range(q, q + 4):
                    m[ab + i * lz + c] = (m[ab + i * lz + c] - m[x + i] * along) / norm


@compiled
def offset_state(m, o, out, x, f, c):  # type: ignore[no-untyped-def]
    """out = x + c f."""
    for i in range(o[NX]):
        m[out + i] = m[x + i] + c * m[f + i]


@compiled
def combine(m, o, out, x, k1, h):  # type: ignore[no-untyped-def]
    """out = x + h (k1 + 2 k2 + 2 k3 + k4) / 6 with the slopes one after the other."""
    lx = o[LX]
    for i in range(o[NX]):
        k = k1 + i
        m[out + i] = m[x + i] + h / 6.0 * (m[k] + 2.0 * m[k + lx] + 2.0 * m[k + 2 * lx] + m[k + 3 * lx])


@compiled
def integrate(m, o, x, u, p, h, out):  # type: ignore[no-untyped-def]
    """One Runge-Kutta step of the state at offset ``x`` to ``out``."""
    lx = o[LX]
    k1 = o[F]
    middle = k1 + 4 * lx
    stage(o, DYNAMICS, x, u, p, k1, k1, k1)
    offset_state(m, o, middle, x, k1, 0.5 * h)
    stage(o, DYNAMICS, middle, u, p, k1 + lx, k1, k1)
    if o[RK4] == 0:
        offset_state(m, o, out, x, k1 + lx, h)
    else:
        offset_state(m, o, middle, x, k1 + lx, 0.5 * h)
        stage(o, DYNAMICS, middle, u, p, k1 + 2 * lx, k1, k1)
        offset_state(m, o, middle, x, k1 + 2 * lx, h)
        stage(o, DYNAMICS, middle, u, p, k1 + 3 * lx, k1, k1)
        combine(m, o, out, x, k1, h)
    normalise(m, o, out, -1)


@compiled
def chain(m, o, j, s, t, ab, c, weight):  # type: ignore[no-untyped-def]
    """t = j + c j_x s; ab += weight t."""
    base, small = o[BASE], o[SMALL]
    m[small], m[small + 1] = c, weight
    call5(o[CHAIN], base + 8 * j, base + 8 * s, base + 8 * t, base + 8 * ab, base + 8 * small)


@compiled
def linearise_dynamics(m, o, k):  # type: ignore[no-untyped-def]
    """[A b B] of node k; returns the 1-norm of the gap b."""
    nx, lx, lz = o[NX], o[LX], o[LZ]
    h = m[o[GRID] + k + 1] - m[o[GRID] + k]
    x, u, p = o[X] + k * nx, o[U] + k * o[NU], o[P] + k * o[NP]
    ab, j1, j2, s1, s2 = o[AB] + k * (nx + 1) * lz, o[J1], o[J2], o[S1], o[S2]
    k1 = o[F]
    middle, end = k1 + 4 * lx, k1 + 5 * lx
    for i in range(nx * lz):
        m[ab + i] = 0.0
    for i in range(nx):
        m[ab + i * lz + i] = 1.0
    stage(o, DYNAMICS_J, x, u, p, k1, j1, j1)
    offset_state(m, o, middle, x, k1, 0.5 * h)
    stage(o, DYNAMICS_J, middle, u, p, k1 + lx, j2, j2)
    if o[RK4] == 0:
        chain(m, o, j2, j1, s1, ab, 0.5 * h, h)
        offset_state(m, o, end, x, k1 + lx, h)
    else:
        for i in range(nx * lz):
            m[ab + i] += h / 6.0 * m[j1 + i]
        chain(m, o, j2, j1, s1, ab, 0.5 * h, h / 3.0)
        offset_state(m, o, middle, x, k1 + lx, 0.5 * h)
        stage(o, DYNAMICS_J, middle, u, p, k1 + 2 * lx, j2, j2)
        chain(m, o, j2, s1, s2, ab, 0.5 * h, h / 3.0)
        offset_state(m, o, middle, x, k1 + 2 * lx, h)
        stage(o, DYNAMICS_J, middle, u, p, k1 + 3 * lx, j2, j2)
        chain(m, o, j2, s2, s1, ab, h, h / 6.0)
        combine(m, o, end, x, k1, h)
    normalise(m, o, end, ab)
    gap = 0.0
    for i in range(nx):
        difference = m[end + i] - m[x + nx + i]
        m[ab + i * lz + nx] = difference
        gap += abs(difference)
    return gap


@compiled
def linearise_node(m, o, k, slot):  # type: ignore[no-untyped-def]
    """All of node k, its Hessian into buffer ``slot``: (cost, gap, equality violation)."""
    nx, nu, ng, lz = o[NX], o[NU], o[NG], o[LZ]
    h = m[o[GRID] + k + 1] - m[o[GRID] + k]
    x, u, p = o[X] + k * nx, o[U] + k * nu, o[P] + k * o[NP]
    matrix, small, gradient = o[H] + slot * (nx + 1 + nu) * lz, o[SMALL], o[G] + k * lz
    gap = linearise_dynamics(m, o, k)
    m[small + 2] = h
    stage(o, COST_Q, x, u, p, small + 3, matrix, matrix)
    cost = m[small + 3] + h * barrier_value(m, o, 0, o[PATH_BOXES], x, u)
    add_barrier(m, o, 0, o[PATH_BOXES], x, u, h, matrix, lz)
    for i in range(nx):
        m[gradient + i] = m[matrix + nx * lz + i]
    for i in range(nx + 1, nx + 1 + nu):
        m[gradient + i] = m[matrix + i * lz + nx]
    violation = 0.0
    if ng > 0:
        stage(o, EQUALITY_J, x, u, p, o[E], o[E], o[E])
        for q in range(ng):
            violation += abs(m[o[E] + q * lz + nx])
    return cost, gap, violation


@compiled
def linearise_end(m, o):  # type: ignore[no-untyped-def]
    """Terminal cost's value; its Hessian and gradient into ``terminal`` and the value function."""
    n, nx, lx = o[N], o[NX], o[LX]
    x, end = o[X] + n * nx, o[TERMINAL]
    stage_end(o, END_Q, x, o[P] + n * o[NP], o[SMALL], end)
    add_barrier(m, o, o[PATH_BOXES], o[END_BOXES], x, x, 1.0, end, lx)
    for i in range((nx + 1) * lx):
        m[o[VALUE] + i] = m[end + i]
    for i in range(nx):
        m[o[G] + n * o[LZ] + i] = m[end + nx * lx + i]
    return m[o[SMALL]] + barrier_value(m, o, o[PATH_BOXES], o[END_BOXES], x, x)


@compiled
def symmetrise(m, o):  # type: ignore[no-untyped-def]
    """Mirror the value function: an antisymmetric rounding error would grow with the open loop's unstable modes."""
    value, lx = o[VALUE], o[LX]
    for i in range(o[NX]):
        for j in range(i):
            m[value + j * lx + i] = m[value + i * lx + j]


@compiled
def backward(m, o, keep):  # type: ignore[no-untyped-def]
    """Linearise and eliminate, from the last node to the first: (cost, Σ|gap|, Σ|equality|).

    ``keep``: every node keeps its Hessian (for the KKT residual); else all share one buffer.
    """
    cost, gaps, violations = linearise_end(m, o), 0.0, 0.0
    base, nx, nu, lx, lz = o[BASE], o[NX], o[NU], o[LX], o[LZ]
    for k in range(o[N] - 1, -1, -1):
        slot = k if keep else 0
        c, g, v = linearise_node(m, o, k, slot)
        cost, gaps, violations = cost + c, gaps + g, violations + v
        call7(
            o[RICCATI],
            base + 8 * (o[AB] + k * (nx + 1) * lz),
            base + 8 * (o[H] + slot * (nx + 1 + nu) * lz),
            base + 8 * o[E],
            base + 8 * o[EPS],
            base + 8 * o[VALUE],
            base + 8 * (o[K] + k * nu * lx),
            base + 8 * o[SCRATCH],
        )
        symmetrise(m, o)
    return cost, gaps, violations


@compiled
def forward(m, o, x0):  # type: ignore[no-untyped-def]
    """The step: (largest component, directional derivative of the cost)."""
    n, nx, nu, lx, lz = o[N], o[NX], o[NU], o[LX], o[LZ]
    largest, slope = 0.0, 0.0
    for i in range(nx):
        m[o[DX] + i] = x0[i] - m[o[X] + i]
    for k in range(n):
        dx, du, g = o[DX] + k * lx, o[DU] + k * nu, o[G] + k * lz
        for j in range(nu):
            row, total = o[K] + (k * nu + j) * lx, 0.0
            for i in range(nx + 1):
                total += m[row + i] * m[dx + i]
            m[du + j] = total
            slope += total * m[g + nx + 1 + j]
            largest = max(largest, abs(total))
        for r in range(nx):
            row, total = o[AB] + (k * (nx + 1) + r) * lz, 0.0
            for i in range(nx + 1):
                total += m[row + i] * m[dx + i]
            for j in range(nu):
                total += m[row + nx + 1 + j] * m[du + j]
            m[dx + lx + r] = total
            slope += m[dx + r] * m[g + r]
            largest = max(largest, abs(m[dx + r]))
    for r in range(nx):
        slope += m[o[DX] + n * lx + r] * m[o[G] + n * lz + r]
        largest = max(largest, abs(m[o[DX] + n * lx + r]))
    return largest, slope


@compiled
def kkt_residual(m, o):  # type: ignore[no-untyped-def]
    """(max |H δz|, δzᵀ H δz). With the quadratic problem's multipliers −H δz is the Lagrangian's gradient at the iterate."""
    n, nx, nu, lx, lz = o[N], o[NX], o[NU], o[LX], o[LZ]
    largest, curvature, nz = 0.0, 0.0, nx + 1 + nu
    for k in range(n):
        h, dx, du = o[H] + k * nz * lz, o[DX] + k * lx, o[DU] + k * nu - nx - 1
        for i in range(nz):
            if i == nx:
                continue
            total = 0.0
            for j in range(nz):
                if j != nx:
                    low, high = (j, i) if j < i else (i, j)
                    total += m[h + high * lz + low] * (m[dx + j] if j < nx else m[du + j])
            largest = max(largest, abs(total))
            curvature += total * (m[dx + i] if i < nx else m[du + i])
    for i in range(nx):
        total = 0.0
        for j in range(nx):
            total += m[o[TERMINAL] + i * lx + j] * m[o[DX] + n * lx + j]
        largest = max(largest, abs(total))
        curvature += total * m[o[DX] + n * lx + i]
    return largest, curvature


@compiled
def trial(m, o, x0, alpha):  # type: ignore[no-untyped-def]
    """Cost and violation (1-norm of gaps, equalities and start) at step length ``alpha``; fills the trial trajectories."""
    n, nx, nu, ng, lx = o[N], o[NX], o[NU], o[NG], o[LX]
    small, end = o[SMALL], o[F] + 5 * lx
    for k in range(n + 1):
        for i in range(nx):
            m[o[XT] + k * nx + i] = m[o[X] + k * nx + i] + alpha * m[o[DX] + k * lx + i]
    for i in range(n * nu):
        m[o[UT] + i] = m[o[U] + i] + alpha * m[o[DU] + i]
    cost, violation = 0.0, 0.0
    for i in range(nx):
        violation += abs(x0[i] - m[o[XT] + i])
    for k in range(n):
        h = m[o[GRID] + k + 1] - m[o[GRID] + k]
        x, u, p = o[XT] + k * nx, o[UT] + k * nu, o[P] + k * o[NP]
        integrate(m, o, x, u, p, h, end)
        for i in range(nx):
            violation += abs(m[end + i] - m[x + nx + i])
        stage(o, COST, x, u, p, small, small, small)
        cost += h * (m[small] + barrier_value(m, o, 0, o[PATH_BOXES], x, u))
        if ng > 0:
            stage(o, EQUALITY, x, u, p, small + 16, small, small)
            for q in range(ng):
                violation += abs(m[small + 16 + q])
    last = o[XT] + n * nx
    stage_end(o, END_COST, last, o[P] + n * o[NP], small, small)
    cost += m[small] + barrier_value(m, o, o[PATH_BOXES], o[END_BOXES], last, last)
    return cost, violation


@compiled
def accept(cost, violation, base_cost, base_violation, slope, penalty, alpha):  # type: ignore[no-untyped-def]
    """Armijo's rule on the merit cost + penalty · violation (Nocedal and Wright 2006, equations 18.27 to 18.36)."""
    merit, base = cost + penalty * violation, base_cost + penalty * base_violation
    rounding = 1e-9 * (1.0 + abs(base_cost))  # of a sum of many terms
    return np.isfinite(merit) and merit <= base + 1e-4 * alpha * (slope - penalty * base_violation) + rounding


@compiled
def take(m, o):  # type: ignore[no-untyped-def]
    """The trial point becomes the iterate."""
    n, nx = o[N], o[NX]
    for i in range((n + 1) * nx):
        m[o[X] + i] = m[o[XT] + i]
    for i in range(n * o[NU]):
        m[o[U] + i] = m[o[UT] + i]
    if o[QUATERNIONS] > 0:
        for k in range(n + 1):
            normalise(m, o, o[X] + k * nx, -1)


@compiled
def solve(m, o, x0, iterations, tolerance, feasibility, smallest, certify, force, log):  # type: ignore[no-untyped-def]
    """Up to ``iterations`` steps: (status, steps done). Rows of ``log``: see workspace.LOG.

    ``force``: when no step length is accepted, the full step is taken if it is finite (real-time iterations).
    """
    penalty, first_alpha, last_kkt = 0.0, 1.0, np.inf
    for it in range(iterations):
        cost, gaps, rows = backward(m, o, certify)
        for i in range(o[NX]):
            gaps += abs(x0[i] - m[o[X] + i])
        violation = gaps + rows
        largest, slope = forward(m, o, x0)
        kkt, curvature = kkt_residual(m, o) if certify else (np.nan, 0.0)
        log[it, 0], log[it, 1], log[it, 2], log[it, 3], log[it, 4] = cost, violation, kkt, largest, 0.0
        log[it, 5], log[it, 6] = gaps, rows
        if not (np.isfinite(cost) and np.isfinite(violation) and np.isfinite(largest)):
            return NOT_FINITE, it + 1
        if certify and kkt <= tolerance and violation <= feasibility:
            return CONVERGED, it + 1
        if violation > 1e-12:
            penalty = max(penalty, 2.0 * (slope + 0.5 * curvature) / violation)
        # Where differences of the cost drown in rounding, the KKT residual tells that Gauss-Newton overshoots.
        first_alpha = max(0.5 * first_alpha, 0.1) if kkt > last_kkt else min(1.3 * first_alpha, 1.0)
        last_kkt = kkt
        alpha = first_alpha
        while True:
            new_cost, new_violation = trial(m, o, x0, alpha)
            if accept(new_cost, new_violation, cost, violation, slope, penalty, alpha):
                break
            alpha *= 0.5
            if alpha < smallest:
                alpha = 1.0
                new_cost, new_violation = trial(m, o, x0, alpha)
                if force and np.isfinite(new_cost) and np.isfinite(new_violation):
                    break
                return NO_STEP, it + 1
        take(m, o)
        log[it, 4] = alpha
    return ITERATION_LIMIT, iterations

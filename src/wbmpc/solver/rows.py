"""Compiled code of inequalities and multiplier rows: relaxed barriers, interior point, augmented Lagrangian.

A row h(z) contributes the quadratic ½ w σ (J δz + e)² to its node's subproblem (w: the interval's length) and gets the
multiplier −σ (J δz + e) after the step:

- HARD, slack t, multiplier l, L1 slack s with y = ν − l: σ = 1 / (t/l + s/y), e = h − μ/l + μ/y − l/σ;
- MULTIPLIER: σ = ρ where λ > ρ h, else 0; e = h − λ/ρ;
- EQUAL: σ = ρ, e = h + λ/ρ, multiplier +σ (J δz + e).

Sources: Nocedal and Wright 2006, sections 19.2 and 17.4; derivation in docs/derivations.md.
"""

from __future__ import annotations

import numpy as np

from wbmpc.ocp.rows import Kind
from wbmpc.solver.compilation import BOOL, INT, INT3, INTS, NONE, NUM, NUM2, NUM3, NUM6, NUMS, call3, compiled
from wbmpc.solver.places import (
    ADD_ROWS,
    BASE,
    BOXES,
    DU,
    DUAL,
    DX,
    END_J,
    END_ROW_BOXES,
    END_ROW_GENERAL,
    END_ROW_VALUES,
    END_ROWS_J,
    GRID,
    INDEX,
    LEFT,
    LX,
    LZ,
    MU,
    NP,
    NU,
    NX,
    PRIMAL,
    PRODUCT,
    RESIDUAL,
    RHO,
    ROW_BOXES,
    ROW_C,
    ROW_D,
    ROW_DS,
    ROW_DT,
    ROW_E,
    ROW_GENERAL,
    ROW_H,
    ROW_J,
    ROW_L,
    ROW_N,
    ROW_S,
    ROW_SCALED,
    ROW_SLOPE,
    ROW_T,
    ROW_TABLE,
    ROW_VALUES,
    ROW_Y,
    ROWS,
    ROWS_J,
    SMALL,
    STATE,
    N,
    P,
    U,
    X,
)  # fmt: skip
from wbmpc.solver.stages import row_count, row_index, stage, stage_end

HARD, MULTIPLIER, EQUAL = int(Kind.HARD), int(Kind.MULTIPLIER), int(Kind.EQUAL)


@compiled(NUM, NUMS, INTS, INT, INT, INT, INT)
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


@compiled(NONE, NUMS, INTS, INT, INT, INT, NUM, NUM)
def add_square(m, o, matrix, ld, i, curve, slope):  # type: ignore[no-untyped-def]
    """Curvature and slope of one variable onto a matrix of the extended node vector."""
    constant = o[NX]
    m[matrix + i * ld + i] += curve
    m[matrix + i * ld + constant] += slope
    if i < constant:
        m[matrix + constant * ld + i] += slope


@compiled(NONE, NUMS, INTS, INT, INT, INT, INT, NUM, INT, INT)
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
        add_square(m, o, matrix, ld, i, scale * curve * sign * sign, scale * slope * sign)


# ---------------------------------------------------------------------- one row
@compiled(NUM2, INT, NUM, NUM, NUM, NUM, NUM, NUM, NUM)
def weight(kind, h, t, l, s, y, penalty, mu):  # type: ignore[no-untyped-def]  # noqa: E741
    """(σ, e) of a row."""
    if kind == HARD:
        if np.isinf(penalty):
            inverse = 1.0 / l
            return l / t, h - mu * inverse - t
        inverse = 1.0 / (l * y)  # divisions are what a row costs
        return l * y / (t * y + s * l), h - mu * inverse * (y - l) - t - s * l * l * inverse
    if kind == MULTIPLIER:
        return (penalty if l > penalty * h else 0.0), h - l / penalty
    return penalty, h + l / penalty


@compiled(NUM2, INT, NUM, NUM, NUM, NUM, NUM, NUM)
def smooth_merit(kind, h, t, l, s, penalty, mu):  # type: ignore[no-untyped-def]  # noqa: E741
    """(cost without logarithms, violation) of a row."""
    if kind == HARD:
        if np.isinf(penalty):
            return 0.0, abs(h - t)
        return penalty * s, abs(h + s - t)
    if kind == MULTIPLIER:
        pull = max(0.0, l - penalty * h)
        return 0.5 * (pull * pull - l * l) / penalty, 0.0
    return 0.0, abs(h)


@compiled(NUM6, NUM, NUM, NUM, NUM, NUM, NUM, NUM, NUM)
def steps(t, l, s, y, penalty, mu, following, ahead):  # type: ignore[no-untyped-def]  # noqa: E741
    """(δt, δs, δl, largest −δt/t or −δs/s, largest −δl/l or −δy/y, slope of logarithms and slack) of a hard row.

    ``following``: next multiplier; ``ahead`` = h + J δz.
    """
    dl = following - l
    if np.isinf(penalty):
        by_l, by_t = 1.0 / l, 1.0 / t
        dt = mu * by_l - t - t * dl * by_l
        return dt, 0.0, dl, -dt * by_t, -dl * by_l, -mu * dt * by_t
    inverse, other = 1.0 / (l * y), 1.0 / (t * s)
    by_l, by_y, by_t, by_s = y * inverse, l * inverse, s * other, t * other
    dt, ds = (mu - t * dl) * by_l - t, (mu + s * dl) * by_y - s
    if s * l > t * y:  # the slack carries the row: δl is the small difference of large numbers
        ds = t + dt - ahead - s
        dl = y - (mu - y * ds) * by_s
    slope = ds * (penalty - mu * by_s) - mu * dt * by_t
    return dt, ds, dl, max(-dt * by_t, -ds * by_s), max(-dl * by_l, dl * by_y), slope


@compiled(INT3, INTS, INT)
def node_rows(o, k):  # type: ignore[no-untyped-def]
    """(first row in the row table, rows of one variable, general rows) of node k."""
    if k < o[N]:
        return 0, o[ROW_BOXES], o[ROW_GENERAL]
    return o[ROW_BOXES] + o[ROW_GENERAL], o[END_ROW_BOXES], o[END_ROW_GENERAL]


@compiled(NUM, NUMS, INTS, INT)
def row_penalty(m, o, r):  # type: ignore[no-untyped-def]
    """Weight of a hard row's L1 slack, or ρ of a multiplier row (which grows while its residual does not shrink)."""
    penalty = m[o[ROW_TABLE] + 3 * r + 2]
    return penalty if o[row_index(o) + row_count(o) + r] == HARD else penalty * m[o[STATE] + RHO]


@compiled(BOOL, INTS, INT, INT)
def counts(o, r, k):  # type: ignore[no-untyped-def]
    """Whether row r (of path and end together) counts at node k: rows of the state alone not at the measured state."""
    return k > 0 or o[row_index(o) + 2 * row_count(o) + r] == 0


@compiled(NUM, NUMS, INTS, INT, INT, INT)
def box_value(m, o, r, x, u):  # type: ignore[no-untyped-def]
    """h of a row of one variable."""
    i, b, first = o[row_index(o) + r], o[ROW_TABLE] + 3 * r, o[NX] + 1
    return m[b] * (m[x + i] if i < first else m[u + i - first]) + m[b + 1]


# ---------------------------------------------------------------------- all rows of a node
@compiled(NONE, NUMS, INTS, INT, INT, INT)
def general_values(m, o, k, x, u):  # type: ignore[no-untyped-def]
    """Values of the general rows of node k into ``small`` from entry 16 on."""
    out, p = o[SMALL] + 16, o[P] + k * o[NP]
    if k < o[N]:
        if o[ROW_GENERAL] > 0:
            stage(o, ROW_VALUES, x, u, p, out, out, out)
    elif o[END_ROW_GENERAL] > 0:
        stage_end(o, END_ROW_VALUES, x, p, out, out)


@compiled(NUM2, NUMS, INTS, INT, INT, INT, NUM)
def rows_merit(m, o, k, x, u, alpha):  # type: ignore[no-untyped-def]
    """(cost, violation) of node k's rows at the point x, u with slacks a step of ``alpha`` further; not yet times w."""
    first, boxes, general = node_rows(o, k)
    if boxes + general == 0:
        return 0.0, 0.0
    place, mu, kinds = k * o[ROWS], m[o[STATE] + MU], row_index(o) + row_count(o)
    general_values(m, o, k, x, u)
    cost, violation, product = 0.0, 0.0, 1.0
    for j in range(boxes + general):
        r, q = first + j, place + j
        if not counts(o, r, k):
            continue
        h = box_value(m, o, r, x, u) if j < boxes else m[o[SMALL] + 16 + j - boxes]
        kind, penalty = o[kinds + r], row_penalty(m, o, r)
        t, s = m[o[ROW_T] + q] + alpha * m[o[ROW_DT] + q], m[o[ROW_S] + q] + alpha * m[o[ROW_DS] + q]
        if kind == HARD:
            product *= t if np.isinf(penalty) else t * s
            if not 1e-200 < product < 1e200:
                cost -= mu * np.log(product)
                product = 1.0
        c, v = smooth_merit(kind, h, t, m[o[ROW_L] + q], s, penalty, mu)
        cost, violation = cost + c, violation + v
    return cost - mu * np.log(product), violation


@compiled(NONE, NUMS, INTS, INT, INT, INT, INT, NUM, INT, INT)
def add_general(m, o, k, jacobian, place, general, w, matrix, ld):  # type: ignore[no-untyped-def]
    """Jᵀ w σ J of general rows (with e in the constant's column) onto a matrix of the extended node vector."""
    lz, base = o[LZ], o[BASE]
    if k < o[N]:
        for j in range(general):
            scale = w * m[o[ROW_C] + place + j]
            for c in range(lz):
                m[o[ROW_SCALED] + j * lz + c] = scale * m[jacobian + j * lz + c]
        call3(o[ADD_ROWS], base + 8 * jacobian, base + 8 * o[ROW_SCALED], base + 8 * matrix)
        return
    for j in range(general):
        scale, row = w * m[o[ROW_C] + place + j], jacobian + j * lz
        for a in range(o[NX] + 1):
            for b in range(o[NX] + 1):
                m[matrix + a * ld + b] += scale * m[row + a] * m[row + b]


@compiled(NUM2, NUMS, INTS, INT, INT, INT, INT, INT)
def linearise_rows(m, o, k, x, u, matrix, ld):  # type: ignore[no-untyped-def]
    """σ and e of node k's rows, and their part of the node's Hessian and gradient at ``matrix``: w times (cost, violation)."""
    first, boxes, general = node_rows(o, k)
    if boxes + general == 0:
        return 0.0, 0.0
    w = m[o[GRID] + k + 1] - m[o[GRID] + k] if k < o[N] else 1.0
    mu, place, index = m[o[STATE] + MU], k * o[ROWS], row_index(o)
    kinds, lz = index + row_count(o), o[LZ]
    jacobian = o[ROW_J] + k * o[ROW_GENERAL] * lz if k < o[N] else o[END_J]
    cost, violation, product = 0.0, 0.0, 1.0
    if general > 0:
        out, p = o[SMALL] + 16, o[P] + k * o[NP]
        if k < o[N]:
            stage(o, ROWS_J, x, u, p, out, jacobian, jacobian)
        else:
            stage_end(o, END_ROWS_J, x, p, out, jacobian)
    for j in range(boxes + general):
        r, q = first + j, place + j
        h = box_value(m, o, r, x, u) if j < boxes else m[o[SMALL] + 16 + j - boxes]
        m[o[ROW_H] + q] = h
        sigma, e = 0.0, 0.0
        if counts(o, r, k):
            kind, penalty = o[kinds + r], row_penalty(m, o, r)
            t, l, s = m[o[ROW_T] + q], m[o[ROW_L] + q], m[o[ROW_S] + q]  # noqa: E741
            sigma, e = weight(kind, h, t, l, s, m[o[ROW_Y] + q], penalty, mu)
            if kind == HARD:
                product *= t if np.isinf(penalty) else t * s
                if not 1e-200 < product < 1e200:
                    cost -= mu * np.log(product)
                    product = 1.0
            c, v = smooth_merit(kind, h, t, l, s, penalty, mu)
            cost, violation = cost + c, violation + v
        m[o[ROW_C] + q], m[o[ROW_E] + q] = sigma, e
        if j < boxes:
            sign = m[o[ROW_TABLE] + 3 * r]
            add_square(m, o, matrix, ld, o[index + r], w * sigma * sign * sign, w * sigma * sign * e)
        else:
            m[jacobian + (j - boxes) * lz + o[NX]] = e
    if general > 0:
        add_general(m, o, k, jacobian, place + boxes, general, w, matrix, ld)
    return w * (cost - mu * np.log(product)), w * violation


@compiled(NUM, NUMS, INTS, INT, INT)
def row_change(m, o, k, j):  # type: ignore[no-untyped-def]
    """J δz of row j of node k."""
    first, boxes, _ = node_rows(o, k)
    dx, du, nx = o[DX] + k * o[LX], o[DU] + k * o[NU], o[NX]
    if j < boxes:
        i = o[row_index(o) + first + j]
        return m[o[ROW_TABLE] + 3 * (first + j)] * (m[dx + i] if i < nx else m[du + i - nx - 1])
    lz, total = o[LZ], 0.0
    row = (o[ROW_J] + k * o[ROW_GENERAL] * lz if k < o[N] else o[END_J]) + (j - boxes) * lz
    for i in range(nx):
        total += m[row + i] * m[dx + i]
    if k < o[N]:
        for i in range(o[NU]):
            total += m[row + nx + 1 + i] * m[du + i]
    return total


# ---------------------------------------------------------------------- all nodes
@compiled(NONE, NUMS, INTS, NUM)
def rows_step(m, o, tau):  # type: ignore[no-untyped-def]
    """Steps of slacks and multipliers; what they say of the whole step goes to ``state`` (see places.py).

    ``tau``: fraction to the boundary.
    """
    state, mu = o[STATE], m[o[STATE] + MU]
    primal, dual, slope, product, residual, left = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(o[N] + 1):
        first, boxes, general = node_rows(o, k)
        w = m[o[GRID] + k + 1] - m[o[GRID] + k] if k < o[N] else 1.0
        kinds = row_index(o) + row_count(o)
        for j in range(boxes + general):
            r, q = first + j, k * o[ROWS] + j
            if not counts(o, r, k):
                continue
            change = row_change(m, o, k, j)
            m[o[ROW_D] + q] = change
            t, l, s = m[o[ROW_T] + q], m[o[ROW_L] + q], m[o[ROW_S] + q]  # noqa: E741
            penalty, reach = row_penalty(m, o, r), change + m[o[ROW_E] + q]
            if o[kinds + r] == EQUAL:
                m[o[ROW_N] + q] = penalty * reach
                residual = max(residual, abs(m[o[ROW_H] + q]))
                left += w * abs(m[o[ROW_H] + q] + change)
            elif o[kinds + r] == MULTIPLIER:
                pull = max(0.0, l - penalty * m[o[ROW_H] + q])
                m[o[ROW_N] + q] = max(0.0, l - penalty * (m[o[ROW_H] + q] + change))
                slope -= w * pull * change
                residual = max(residual, abs(min(m[o[ROW_H] + q], l / penalty)))
            else:
                following = -m[o[ROW_C] + q] * reach
                y, ahead = m[o[ROW_Y] + q], m[o[ROW_H] + q] + change
                dt, ds, dl, shrink, fall, rise = steps(t, l, s, y, penalty, mu, following, ahead)
                m[o[ROW_N] + q], m[o[ROW_DT] + q], m[o[ROW_DS] + q] = l + dl, dt, ds
                primal, dual, slope = max(primal, shrink), max(dual, fall), slope + w * rise
                product, residual = max(product, l * t), max(residual, abs(m[o[ROW_H] + q] + s - t))
                if not np.isinf(penalty):
                    product = max(product, y * s)
    m[state + PRIMAL], m[state + DUAL] = tau / max(primal, tau), tau / max(dual, tau)
    m[state + ROW_SLOPE], m[state + PRODUCT], m[state + RESIDUAL], m[state + LEFT] = slope, product, residual, left


@compiled(NONE, NUMS, INTS, NUM, NUM, BOOL)
def take_rows(m, o, primal, dual, solved):  # type: ignore[no-untyped-def]
    """Slacks and multipliers move by their steps; those of MULTIPLIER rows only when ``solved``."""
    kinds = row_index(o) + row_count(o)
    for k in range(o[N] + 1):
        first, boxes, general = node_rows(o, k)
        for j in range(boxes + general):
            r, q = first + j, k * o[ROWS] + j
            if not counts(o, r, k):
                continue
            if o[kinds + r] == MULTIPLIER and not solved:
                continue
            change = (dual if o[kinds + r] == HARD else primal) * (m[o[ROW_N] + q] - m[o[ROW_L] + q])
            m[o[ROW_L] + q] += change
            m[o[ROW_Y] + q] -= change
            m[o[ROW_T] + q] += primal * m[o[ROW_DT] + q]
            m[o[ROW_S] + q] += primal * m[o[ROW_DS] + q]


@compiled(NONE, NUMS, INTS, NUM, BOOL, BOOL)
def start_rows(m, o, least, keep, keep_slacks):  # type: ignore[no-untyped-def]
    """Slacks t = max(h, ``least``) at the iterate; multipliers kept, or μ / t. Multiplier rows start at 0 when not kept.

    ``keep_slacks``: slacks that there are stay too.
    """
    mu, kinds = m[o[STATE] + MU], row_index(o) + row_count(o)
    for k in range(o[N] + 1):
        first, boxes, general = node_rows(o, k)
        if boxes + general == 0:
            continue
        x, u = o[X] + k * o[NX], o[U] + min(k, o[N] - 1) * o[NU]
        general_values(m, o, k, x, u)
        for j in range(boxes + general):
            r, q = first + j, k * o[ROWS] + j
            h = box_value(m, o, r, x, u) if j < boxes else m[o[SMALL] + 16 + j - boxes]
            l = m[o[ROW_L] + q]  # noqa: E741
            kept = keep and np.isfinite(l)
            if o[kinds + r] != HARD:
                m[o[ROW_L] + q] = l if kept else 0.0
                continue
            if keep_slacks and kept and m[o[ROW_T] + q] > 0.0:
                continue
            penalty = row_penalty(m, o, r)
            t = h if h > least else least  # also for a NaN
            l = l if kept and l > 0.0 else mu / t  # noqa: E741
            l = min(max(l, 1e-12), 0.99 * penalty)  # noqa: E741
            m[o[ROW_T] + q], m[o[ROW_L] + q], m[o[ROW_Y] + q] = t, l, penalty - l
            m[o[ROW_S] + q] = 0.0 if np.isinf(penalty) else max(t - h, mu / (penalty - l))


@compiled(NUM3, NUMS, INTS)
def largest_violation(m, o):  # type: ignore[no-untyped-def]
    """(value, node, row of the node) of the row that is violated most at the last linearised point, by h."""
    worst, node, row = 0.0, -1.0, -1.0
    kinds = row_index(o) + row_count(o)
    for k in range(o[N] + 1):
        first, boxes, general = node_rows(o, k)
        for j in range(boxes + general):
            if counts(o, first + j, k):
                h = m[o[ROW_H] + k * o[ROWS] + j]
                value = abs(h) if o[kinds + first + j] == EQUAL else -h
                if value > worst:
                    worst, node, row = value, float(k), float(j)
    return worst, node, row

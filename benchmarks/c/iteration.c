/* One iteration of the SQP in C: what a compiler makes of the same functions and the same algorithm.

   A yardstick for the generated code, not a solver. Comes behind a generated file with the sizes, CasADi's C code of the
   stage functions and the scatter functions. Limits: relaxed barriers on single variables; RK2; one trial point.
   The extended node vector is z = [x, 1, u]; columns are padded to LX, LZ, LG (multiples of eight). */
#include <math.h>
#include <string.h>

typedef double v8 __attribute__((vector_size(64)));
#define UNROLL _Pragma("GCC unroll 64")
#define INLINE static inline __attribute__((always_inline))
#define ALIGNED __attribute__((aligned(64)))
#define AT(p, i) (*(v8 *)((p) + (i)))
#define NX1 (NX + 1)
#define GG (NG > 0 ? NG : 1)

typedef struct { int place; double sign, offset, mu, delta; } box;

static ALIGNED double ab[N][NX1][LZ], hessian[NZ][LZ], rows[GG * LZ + NU * LG], gains[N][NU][LX], value[NX1][LX];
static ALIGNED double weight[NX1][LZ], mm[NZ][LZ], inverse[LZ], tt[NU][LX], rr[NU][LG], zz[GG][LX], yy[GG][LX];
static ALIGNED double schur[GG][LG], schur_inverse[LG], eps[LG], jacobian1[NX][LZ], jacobian2[NX][LZ], s1[NX][LZ];
static ALIGNED double x[N + 1][NX], u[N][NU], dx[N + 1][LX], du[N][NU], xt[N + 1][NX], ut[N][NU], gradient[N + 1][LZ];
static double grid[N + 1], p[N + 1][NP], w[NW];
static box boxes[NB + 1], end_boxes[NBE + 1];
static double buffer[BUFFER];

/* C[:, j] = I[:, j] + sign * sum over k of A[:, k] B[j bj + k bk]; `tall` vectors per column, `wide` columns at a time */
INLINE void tile(int tall, int wide, int inner, const double *A, int lda, const double *B, int bj, int bk, double *C,
                 int ldc, const double *I, int ldi, int negative) {
    v8 acc[8][8];
    UNROLL for (int q = 0; q < wide; q++)
        UNROLL for (int i = 0; i < tall; i++) acc[q][i] = I ? AT(I, q * ldi + 8 * i) : (v8){0};
    _Pragma("GCC unroll 1") for (int k = 0; k < inner; k++)
        UNROLL for (int q = 0; q < wide; q++) {
            double b = negative ? -B[q * bj + k * bk] : B[q * bj + k * bk];
            UNROLL for (int i = 0; i < tall; i++) acc[q][i] += AT(A, k * lda + 8 * i) * b;
        }
    UNROLL for (int q = 0; q < wide; q++)
        UNROLL for (int i = 0; i < tall; i++) AT(C, q * ldc + 8 * i) = acc[q][i];
}

INLINE void product(int tall, int wide, int n, int inner, const double *A, int lda, const double *B, int bj, int bk,
                    double *C, int ldc, const double *I, int ldi, int negative) {
    int j = 0;
    for (; j + wide <= n; j += wide)
        tile(tall, wide, inner, A, lda, B + j * bj, bj, bk, C + j * ldc, ldc, I ? I + j * ldi : I, ldi, negative);
    for (; j < n; j++)
        tile(tall, 1, inner, A, lda, B + j * bj, bj, bk, C + j * ldc, ldc, I ? I + j * ldi : I, ldi, negative);
}
#define WIDE(tall) ((tall) > 12 ? 1 : 24 / (tall) > 8 ? 8 : 24 / (tall))
#define PRODUCT(tall, n, inner, ...) product(tall, WIDE(tall), n, inner, __VA_ARGS__)

/* M_uu = U U', the last input first, the rows above with it */
static void cholesky(double *L) {
    UNROLL for (int j = NU - 1; j >= 0; j--) {
        const int blocks = (NX1 + j) / 8 + 1;
        v8 acc[LZ / 8];
        UNROLL for (int i = 0; i < blocks; i++) acc[i] = AT(L, j * LZ + 8 * i);
        for (int k = j + 1; k < NU; k++) {
            double f = L[k * LZ + NX1 + j];
            UNROLL for (int i = 0; i < blocks; i++) acc[i] -= AT(L, k * LZ + 8 * i) * f;
        }
        inverse[j] = 1.0 / sqrt(acc[(NX1 + j) / 8][(NX1 + j) % 8]);
        UNROLL for (int i = 0; i < blocks; i++) AT(L, j * LZ + 8 * i) = acc[i] * inverse[j];
    }
}

/* K = -U^-T T, row by row */
INLINE void substitute_gains(const double *L, const double *T, int ldt, double *K) {
    UNROLL for (int j = 0; j < NU; j++) {
        v8 acc[LX / 8];
        UNROLL for (int i = 0; i < LX / 8; i++) acc[i] = AT(T, j * ldt + 8 * i);
        for (int k = 0; k < j; k++) {
            double f = L[j * LZ + NX1 + k];
            UNROLL for (int i = 0; i < LX / 8; i++) acc[i] += AT(K, k * LX + 8 * i) * f;
        }
        UNROLL for (int i = 0; i < LX / 8; i++) AT(K, j * LX + 8 * i) = acc[i] * -inverse[j];
    }
}

#if NG > 0
/* Z <- Z L^-T: forwards; Z <- Z L^-1: backwards */
INLINE void schur_forward(double *Z) {
    UNROLL for (int j = 0; j < NG; j++) {
        v8 acc[LX / 8];
        UNROLL for (int i = 0; i < LX / 8; i++) acc[i] = AT(Z, j * LX + 8 * i);
        for (int q = 0; q < j; q++)
            UNROLL for (int i = 0; i < LX / 8; i++) acc[i] -= AT(Z, q * LX + 8 * i) * schur[q][j];
        UNROLL for (int i = 0; i < LX / 8; i++) AT(Z, j * LX + 8 * i) = acc[i] * schur_inverse[j];
    }
}

INLINE void schur_backward(double *Z) {
    UNROLL for (int j = NG - 1; j >= 0; j--) {
        v8 acc[LX / 8];
        UNROLL for (int i = 0; i < LX / 8; i++) acc[i] = AT(Z, j * LX + 8 * i);
        for (int k = j + 1; k < NG; k++)
            UNROLL for (int i = 0; i < LX / 8; i++) acc[i] -= AT(Z, k * LX + 8 * i) * schur[j][k];
        UNROLL for (int i = 0; i < LX / 8; i++) AT(Z, j * LX + 8 * i) = acc[i] * schur_inverse[j];
    }
}

static void schur_factor(void) {
    UNROLL for (int j = 0; j < NG; j++) {
        schur[j][j] = schur[j][j] * (1.0 + RELATIVE) + eps[j];
        v8 acc[LG / 8];
        UNROLL for (int i = 0; i < LG / 8; i++) acc[i] = AT(schur[j], 8 * i);
        for (int q = 0; q < j; q++)
            UNROLL for (int i = 0; i < LG / 8; i++) acc[i] -= AT(schur[q], 8 * i) * schur[q][j];
        schur_inverse[j] = 1.0 / sqrt(acc[j / 8][j % 8]);
        UNROLL for (int i = 0; i < LG / 8; i++) AT(schur[j], 8 * i) = acc[i] * schur_inverse[j];
    }
}

static void rows_of_inputs(const double *L, const double *D) {
    UNROLL for (int j = NU - 1; j >= 0; j--) {
        v8 acc[LG / 8];
        UNROLL for (int i = 0; i < LG / 8; i++) acc[i] = AT(D, j * LG + 8 * i);
        for (int q = j + 1; q < NU; q++)
            UNROLL for (int i = 0; i < LG / 8; i++) acc[i] -= AT(rr[q], 8 * i) * L[q * LZ + NX1 + j];
        UNROLL for (int i = 0; i < LG / 8; i++) AT(rr[j], 8 * i) = acc[i] * inverse[j];
    }
}

static void with_rows(double *L, const double *E, double *K) {
    rows_of_inputs(L, E + NG * LZ);
    PRODUCT(LX / 8, NG, NU, L, LZ, rr[0], 1, LG, zz[0], LX, E, LZ, 1);
    PRODUCT(LG / 8, NG, NU, rr[0], LG, rr[0], 1, LG, schur[0], LG, (double *)0, 0, 0);
    schur_factor();
    schur_forward(zz[0]);
    PRODUCT(LX / 8, NX1, NG, zz[0], LX, zz[0], 1, LX, value[0], LX, value[0], LX, 0);
    schur_backward(zz[0]);
    PRODUCT(LX / 8, NU, NG, zz[0], LX, rr[0], LG, 1, tt[0], LX, L, LZ, 0);
    substitute_gains(L, tt[0], LX, K);
    PRODUCT(LX / 8, NG, NU, K, LX, E + NX1, LZ, 1, yy[0], LX, E, LZ, 0);
    for (int q = 0; q < NG; q++)
        UNROLL for (int i = 0; i < LX; i += 8) AT(yy[q], i) -= AT(zz[q], i) * eps[q];
    schur_forward(yy[0]);
    schur_backward(yy[0]);
    PRODUCT(LX / 8, NU, NG, yy[0], LX, rr[0], LG, 1, tt[0], LX, tt[0], LX, 0);
    substitute_gains(L, tt[0], LX, K);
}
#endif

static void riccati(const double *AB, const double *H, const double *E, double *K) {
    double *L = mm[NX1];
    PRODUCT(LZ / 8, NX1, NX1, AB, LZ, value[0], LX, 1, weight[0], LZ, (double *)0, 0, 0);
    PRODUCT(LX / 8, NX1, NX1, AB, LZ, weight[0], 1, LZ, mm[0], LZ, H, LZ, 0);
    PRODUCT(LZ / 8, NU, NX1, AB, LZ, weight[0] + NX1, 1, LZ, L, LZ, H + LZ * NX1, LZ, 0);
    cholesky(L);
    PRODUCT(LX / 8, NX1, NU, L, LZ, L, 1, LZ, value[0], LX, mm[0], LZ, 1);
#if NG > 0
    with_rows(L, E, K);
#else
    substitute_gains(L, L, LZ, K);
#endif
    for (int i = 0; i < NX; i++)
        for (int j = 0; j < i; j++) value[j][i] = value[i][j];
}

static double barrier_value(const box *b, int n, const double *xs, const double *us) {
    double total = 0.0;
    for (int i = 0; i < n; i++) {
        double z = b[i].place < NX ? xs[b[i].place] : us[b[i].place - NX1], h = b[i].sign * z + b[i].offset;
        double d = b[i].delta, q = (h - 2 * d) / d;
        total += h > d ? -b[i].mu * log(h) : b[i].mu * (0.5 * (q * q - 1.0) - log(d));
    }
    return total;
}

static void add_barrier(const box *b, int n, const double *xs, const double *us, double s, double *H, int ld) {
    for (int i = 0; i < n; i++) {
        int c = b[i].place;
        double z = c < NX ? xs[c] : us[c - NX1], h = b[i].sign * z + b[i].offset, mu = b[i].mu, d = b[i].delta;
        double slope = h > d ? -mu / h : mu * (h - 2 * d) / (d * d), curve = h > d ? mu / (h * h) : mu / (d * d);
        double g = s * b[i].sign * slope;
        H[c * ld + c] += s * b[i].sign * b[i].sign * curve;
        H[c * ld + NX] += g;
        if (c < NX) H[NX * ld + c] += g;
    }
}

static void call_dynamics(const double *xs, const double *us, int k, double *f) {
    const double *arg[] = {xs, us, p[k], w};
    double *res[] = {f};
    dynamics(arg, res, 0, 0, 0);
}

static void call_jacobian(const double *xs, const double *us, int k, double *f, double *j) {
    const double *arg[] = {xs, us, p[k], w};
    double *res[] = {f, buffer};
    dynamics_jacobian(arg, res, 0, 0, 0);
    scatter_dynamics_jacobian_1(buffer, j);
}

static double linearize(int k, double *violation) {
    double h = grid[k + 1] - grid[k], f1[NX], f2[NX], middle[NX], cost;
    call_jacobian(x[k], u[k], k, f1, jacobian1[0]);
    for (int i = 0; i < NX; i++) middle[i] = x[k][i] + 0.5 * h * f1[i];
    call_jacobian(middle, u[k], k, f2, jacobian2[0]);
    for (int r = 0; r < NX; r++) {
        v8 acc[LZ / 8];
        UNROLL for (int i = 0; i < LZ / 8; i++) acc[i] = AT(jacobian2[r], 8 * i);
        for (int q = pattern_start[r]; q < pattern_start[r + 1]; q++) {
            double factor = 0.5 * h * jacobian2[r][pattern[q]];
            UNROLL for (int i = 0; i < LZ / 8; i++) acc[i] += AT(jacobian1[pattern[q]], 8 * i) * factor;
        }
        UNROLL for (int i = 0; i < LZ / 8; i++) AT(ab[k][r], 8 * i) = acc[i] * h;
        ab[k][r][r] += 1.0;
        double gap = x[k][r] + h * f2[r] - x[k + 1][r];
        ab[k][r][NX] = gap;
        *violation += fabs(gap);
    }
    const double *arg[] = {x[k], u[k], p[k], w, &h};
    double slope[NX + NU], *res[] = {&cost, slope, buffer};
    cost_quadratic(arg, res, 0, 0, 0);
    scatter_cost_quadratic_1(slope, hessian[0]);
    scatter_cost_quadratic_2(buffer, hessian[0]);
    cost += h * barrier_value(boxes, NB, x[k], u[k]);
    add_barrier(boxes, NB, x[k], u[k], h, hessian[0], LZ);
    for (int i = 0; i < NX; i++) gradient[k][i] = hessian[NX][i];
    for (int i = NX1; i < NZ; i++) gradient[k][i] = hessian[i][NX];
#if NG > 0
    double e[NG], *equality_res[] = {e, buffer};
    equality_jacobian(arg, equality_res, 0, 0, 0);
    scatter_equality_jacobian_0(e, rows);
    scatter_equality_jacobian_1(buffer, rows);
    for (int q = 0; q < NG; q++) *violation += fabs(e[q]);
#endif
    return cost;
}

static double backward(double *violation) {
    const double *arg[] = {x[N], p[N], w};
    double cost, slope[NX], *res[] = {&cost, slope, buffer};
    terminal_quadratic(arg, res, 0, 0, 0);
    scatter_terminal_quadratic_1(slope, value[0]);
    scatter_terminal_quadratic_2(buffer, value[0]);
    cost += barrier_value(end_boxes, NBE, x[N], 0);
    add_barrier(end_boxes, NBE, x[N], 0, 1.0, value[0], LX);
    for (int i = 0; i < NX; i++) gradient[N][i] = value[NX][i];
    for (int k = N - 1; k >= 0; k--) {
        cost += linearize(k, violation);
        riccati(ab[k][0], hessian[0], rows, gains[k][0]);
    }
    return cost;
}

static double forward(const double *x0) {
    double slope = 0.0;
    for (int i = 0; i < NX; i++) dx[0][i] = x0[i] - x[0][i];
    for (int k = 0; k < N; k++) {
        for (int j = 0; j < NU; j++) {
            double total = 0.0;
            for (int i = 0; i < NX1; i++) total += gains[k][j][i] * dx[k][i];
            du[k][j] = total;
            slope += total * gradient[k][NX1 + j];
        }
        for (int r = 0; r < NX; r++) {
            double total = 0.0;
            for (int i = 0; i < NX1; i++) total += ab[k][r][i] * dx[k][i];
            for (int j = 0; j < NU; j++) total += ab[k][r][NX1 + j] * du[k][j];
            dx[k + 1][r] = total;
            slope += dx[k][r] * gradient[k][r];
        }
    }
    for (int r = 0; r < NX; r++) slope += dx[N][r] * gradient[N][r];
    return slope;
}

static double trial(const double *x0, double *violation) {
    double cost = 0.0, part, f[NX], middle[NX], e[GG];
    for (int k = 0; k <= N; k++)
        for (int i = 0; i < NX; i++) xt[k][i] = x[k][i] + dx[k][i];
    for (int k = 0; k < N; k++)
        for (int i = 0; i < NU; i++) ut[k][i] = u[k][i] + du[k][i];
    for (int i = 0; i < NX; i++) *violation += fabs(x0[i] - xt[0][i]);
    for (int k = 0; k < N; k++) {
        double h = grid[k + 1] - grid[k];
        const double *arg[] = {xt[k], ut[k], p[k], w};
        double *res[] = {&part}, *equality_res[] = {e};
        call_dynamics(xt[k], ut[k], k, f);
        for (int i = 0; i < NX; i++) middle[i] = xt[k][i] + 0.5 * h * f[i];
        call_dynamics(middle, ut[k], k, f);
        for (int i = 0; i < NX; i++) *violation += fabs(xt[k][i] + h * f[i] - xt[k + 1][i]);
        cost_value(arg, res, 0, 0, 0);
        cost += h * (part + barrier_value(boxes, NB, xt[k], ut[k]));
#if NG > 0
        equality(arg, equality_res, 0, 0, 0);
        for (int q = 0; q < NG; q++) *violation += fabs(e[q]);
#else
        (void)equality_res;
#endif
    }
    const double *arg[] = {xt[N], p[N], w};
    double *res[] = {&part};
    terminal(arg, res, 0, 0, 0);
    return cost + part + barrier_value(end_boxes, NBE, xt[N], 0);
}

/* -------------------------------------------------------------------- what Python calls */
void setup(const double *g, const double *parameters, const double *weights, const double *softness, const double *path,
           const double *end) {
    memcpy(grid, g, sizeof grid);
    memcpy(p, parameters, sizeof p);
    memcpy(w, weights, sizeof w);
    memcpy(eps, softness, sizeof eps);
    for (int i = 0; i < NB; i++, path += 5) boxes[i] = (box){(int)path[0], path[1], path[2], path[3], path[4]};
    for (int i = 0; i < NBE; i++, end += 5) end_boxes[i] = (box){(int)end[0], end[1], end[2], end[3], end[4]};
    for (int k = 0; k < N; k++) ab[k][NX][NX] = 1.0;
    for (int k = 0; k <= N; k++) dx[k][NX] = 1.0;
}

void guess(const double *xs, const double *us) {
    memcpy(x, xs, sizeof x);
    memcpy(u, us, sizeof u);
}

/* one full step in place; returns the cost at the trial point */
double iterate(const double *x0) {
    double before = 0.0, after = 0.0, cost;
    double base = backward(&before), slope = forward(x0);
    cost = trial(x0, &after);
    if (!(isfinite(base) && isfinite(slope) && isfinite(cost))) return NAN;
    memcpy(x, xt, sizeof x);
    memcpy(u, ut, sizeof u);
    return cost;
}

void trajectory(double *xs, double *us) {
    memcpy(xs, x, sizeof x);
    memcpy(us, u, sizeof u);
}

/* the backward pass alone on matrices in the layout of the library's kernel */
void eliminate(const double *AB, const double *H, const double *E, long node_e, const double *end, double *K) {
    memcpy(value, end, sizeof value);
    for (int k = N - 1; k >= 0; k--)
        riccati(AB + k * NX1 * LZ, H + k * NZ * LZ, E + k * node_e, K + k * NU * LX);
}

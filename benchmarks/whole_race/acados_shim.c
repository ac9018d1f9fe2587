/* acados on a program of ours: its C interface around the functions that acados_peer.py writes above this text.
 *
 * The template renderer of acados is not needed: what its templates do is here, for an external cost, discrete dynamics,
 * bounds and nonlinear rows. The sizes differ between stages; node 0 has the measured state as bounds that are equal.
 */
#include <stdlib.h>

#include "acados_c/external_function_interface.h"
#include "acados_c/ocp_nlp_interface.h"

typedef external_function_external_param_casadi Function;

/* What the caller needs for acados' own setters and getters. */
typedef struct {
    ocp_nlp_plan_t *plan;
    ocp_nlp_config *config;
    ocp_nlp_dims *dims;
    void *opts;
    ocp_nlp_in *in;
    ocp_nlp_out *out;
    ocp_nlp_solver *solver;
    Function *functions;
    int count;
} Peer;

#define MAKE(name)                                                                      \
    static Function *make_##name(Peer *peer) {                                          \
        Function *f = &peer->functions[peer->count++];                                  \
        external_function_opts opts;                                                    \
        external_function_opts_set_to_default(&opts);                                   \
        opts.external_workspace = true;                                                 \
        f->casadi_fun = &name;                                                          \
        f->casadi_n_in = &name##_n_in;                                                  \
        f->casadi_n_out = &name##_n_out;                                                \
        f->casadi_sparsity_in = &name##_sparsity_in;                                    \
        f->casadi_sparsity_out = &name##_sparsity_out;                                  \
        f->casadi_work = &name##_work;                                                  \
        external_function_external_param_casadi_create(f, &opts);                       \
        return f;                                                                       \
    }

MAKE(step_value)
MAKE(step_slope)
MAKE(first_rows)
MAKE(first_rows_slope)
MAKE(path_rows)
MAKE(path_rows_slope)
MAKE(last_rows)
MAKE(last_rows_slope)
MAKE(path_cost)
MAKE(path_cost_quadratic)
MAKE(last_cost)
MAKE(last_cost_quadratic)

static void set_sizes(Peer *peer, int n, int nx, int nu, int np, const int *sizes) {
    int *stages = malloc(5 * (n + 1) * sizeof(int));
    int *x = stages, *u = x + n + 1, *p = u + n + 1, *none = p + n + 1;
    for (int k = 0; k <= n; k++) {
        x[k] = nx;
        u[k] = k < n ? nu : 0;
        p[k] = np;
        none[k] = 0;
    }
    ocp_nlp_dims_set_opt_vars(peer->config, peer->dims, "nx", x);
    ocp_nlp_dims_set_opt_vars(peer->config, peer->dims, "nu", u);
    ocp_nlp_dims_set_opt_vars(peer->config, peer->dims, "nz", none);
    ocp_nlp_dims_set_opt_vars(peer->config, peer->dims, "ns", none);
    ocp_nlp_dims_set_opt_vars(peer->config, peer->dims, "np", p);
    ocp_nlp_dims_set_global(peer->config, peer->dims, "np_global", 0);
    ocp_nlp_dims_set_global(peer->config, peer->dims, "n_global_data", 0);
    for (int k = 0; k <= n; k++) {
        const int *own = sizes + 3 * (k == 0 ? 0 : k < n ? 1 : 2);
        int equal = k == 0 ? nx : 0, bx = own[0], bu = own[1], h = own[2];
        ocp_nlp_dims_set_constraints(peer->config, peer->dims, k, "nbx", &bx);
        ocp_nlp_dims_set_constraints(peer->config, peer->dims, k, "nbu", &bu);
        ocp_nlp_dims_set_constraints(peer->config, peer->dims, k, "nbxe", &equal);
        ocp_nlp_dims_set_constraints(peer->config, peer->dims, k, "nh", &h);
    }
    free(stages);
}

static void set_functions(Peer *peer, int n, const int *sizes) {
    double one = 1.0;
    peer->functions = malloc(6 * (n + 1) * sizeof(Function));
    for (int k = 0; k <= n; k++) {
        const int first = k == 0, last = k == n;
        Function *f = last ? make_last_cost(peer) : make_path_cost(peer);
        ocp_nlp_cost_model_set_external_param_fun(peer->config, peer->dims, peer->in, k, "ext_cost_fun", f);
        f = last ? make_last_cost_quadratic(peer) : make_path_cost_quadratic(peer);
        ocp_nlp_cost_model_set_external_param_fun(peer->config, peer->dims, peer->in, k, "ext_cost_fun_jac_hess", f);
        ocp_nlp_cost_model_set(peer->config, peer->dims, peer->in, k, "scaling", &one);
        if (sizes[3 * (first ? 0 : last ? 2 : 1) + 2]) {
            f = first ? make_first_rows(peer) : last ? make_last_rows(peer) : make_path_rows(peer);
            ocp_nlp_constraints_model_set_external_param_fun(peer->config, peer->dims, peer->in, k, "nl_constr_h_fun", f);
            f = first ? make_first_rows_slope(peer) : last ? make_last_rows_slope(peer) : make_path_rows_slope(peer);
            ocp_nlp_constraints_model_set_external_param_fun(peer->config, peer->dims, peer->in, k, "nl_constr_h_fun_jac", f);
        }
        if (last) continue;
        f = make_step_value(peer);
        ocp_nlp_dynamics_model_set_external_param_fun(peer->config, peer->dims, peer->in, k, "disc_dyn_fun", f);
        f = make_step_slope(peer);
        ocp_nlp_dynamics_model_set_external_param_fun(peer->config, peer->dims, peer->in, k, "disc_dyn_fun_jac", f);
        ocp_nlp_in_set(peer->config, peer->dims, peer->in, k, "Ts", &one); /* the functions contain the step */
    }
}

/* sizes: (bounds of x, bounds of u, rows) of the first, the middle and the last stages. */
Peer *peer_create(int n, int nx, int nu, int np, const int *sizes, int real_time, int merit, int full_condensing) {
    Peer *peer = calloc(1, sizeof(Peer));
    peer->plan = ocp_nlp_plan_create(n);
    peer->plan->nlp_solver = real_time ? SQP_RTI : SQP;
    peer->plan->ocp_qp_solver_plan.qp_solver = full_condensing ? FULL_CONDENSING_HPIPM : PARTIAL_CONDENSING_HPIPM;
    peer->plan->relaxed_ocp_qp_solver_plan.qp_solver = peer->plan->ocp_qp_solver_plan.qp_solver;
    peer->plan->regularization = NO_REGULARIZE;
    peer->plan->globalization = merit ? MERIT_BACKTRACKING : FIXED_STEP;
    for (int k = 0; k <= n; k++) {
        peer->plan->nlp_cost[k] = EXTERNAL;
        peer->plan->nlp_constraints[k] = BGH;
        if (k == n) break;
        peer->plan->nlp_dynamics[k] = DISCRETE_MODEL;
        peer->plan->sim_solver_plan[k].sim_solver = INVALID_SIM_SOLVER;
    }
    peer->config = ocp_nlp_config_create(*peer->plan);
    peer->dims = ocp_nlp_dims_create(peer->config);
    set_sizes(peer, n, nx, nu, np, sizes);
    peer->opts = ocp_nlp_solver_opts_create(peer->config, peer->dims);
    peer->in = ocp_nlp_in_create(peer->config, peer->dims);
    peer->out = ocp_nlp_out_create(peer->config, peer->dims);
    set_functions(peer, n, sizes);
    return peer;
}

/* After options and bounds are set. */
int peer_finish(Peer *peer) {
    peer->solver = ocp_nlp_solver_create(peer->config, peer->dims, peer->opts, peer->in);
    return ocp_nlp_precompute(peer->solver, peer->in, peer->out);
}

int peer_solve(Peer *peer, double *x0) {
    ocp_nlp_constraints_model_set(peer->config, peer->dims, peer->in, peer->out, 0, "lbx", x0);
    ocp_nlp_constraints_model_set(peer->config, peer->dims, peer->in, peer->out, 0, "ubx", x0);
    return ocp_nlp_solve(peer->solver, peer->in, peer->out);
}

/* Multipliers and the memory of the QP solver as they are at the start. */
void peer_reset(Peer *peer) {
    ocp_nlp_out_set_values_to_zero(peer->config, peer->dims, peer->out);
    ocp_nlp_solver_reset_qp_memory(peer->solver, peer->in, peer->out);
}

void peer_free(Peer *peer) {
    ocp_nlp_solver_destroy(peer->solver);
    ocp_nlp_out_destroy(peer->out);
    ocp_nlp_in_destroy(peer->in);
    ocp_nlp_solver_opts_destroy(peer->opts);
    ocp_nlp_dims_destroy(peer->dims);
    ocp_nlp_config_destroy(peer->config);
    ocp_nlp_plan_destroy(peer->plan);
    for (int i = 0; i < peer->count; i++) external_function_external_param_casadi_free(&peer->functions[i]);
    free(peer->functions);
    free(peer);
}

/* HPIPM's dense interior-point solver behind a few functions: a box on every variable and, optionally, soft rows.
 *
 *   minimise 1/2 v'Hv + g'v   subject to  lower <= v <= upper  and  row_lower <= C v <= row_upper (each row soft)
 *
 * box_qp.h is faster where there are no rows; this one is for problems with rows, and for those that box_qp.h cannot
 * solve. All memory is allocated at creation. */
#ifndef ALULA_DENSE_QP_H
#define ALULA_DENSE_QP_H

#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include <blasfeo.h>
#include <hpipm_common.h>
#include <hpipm_d_dense_qp.h>
#include <hpipm_d_dense_qp_dim.h>
#include <hpipm_d_dense_qp_ipm.h>
#include <hpipm_d_dense_qp_sol.h>

typedef struct {
    int variables, rows;
    struct d_dense_qp_dim dim;
    struct d_dense_qp qp;
    struct d_dense_qp_sol sol;
    struct d_dense_qp_ipm_arg arg;
    struct d_dense_qp_ipm_ws ws;
    void *memory[5];
} dense_qp;

static void *aligned_zeros(size_t bytes) {
    size_t padded = (bytes + 127) / 64 * 64;
    void *memory = aligned_alloc(64, padded);
    if (memory) memset(memory, 0, padded);
    return memory;
}

static void dense_qp_make_rows_soft(dense_qp *q, double penalty) {
    int rows = q->rows;
    int *reverse = malloc(sizeof(int) * (size_t)(q->variables + rows));
    double *weight = malloc(sizeof(double) * (size_t)rows);
    for (int i = 0; i < q->variables; i++) reverse[i] = -1;
    for (int i = 0; i < rows; i++) reverse[q->variables + i] = i, weight[i] = penalty;
    d_dense_qp_set_idxs_rev(reverse, &q->qp);
    d_dense_qp_set_Zl(weight, &q->qp), d_dense_qp_set_Zu(weight, &q->qp);
    d_dense_qp_set_zl(weight, &q->qp), d_dense_qp_set_zu(weight, &q->qp);
    free(reverse), free(weight); /* the slacks' own lower bounds are the zeros that the memory starts with */
}

/* tolerance: of stationarity, feasibility and complementarity. penalty: linear and quadratic price of a soft row. */
static dense_qp *dense_qp_create(int variables, int rows, double tolerance, int iterations, double penalty) {
    dense_qp *q = calloc(1, sizeof *q);
    q->variables = variables, q->rows = rows;
    d_dense_qp_dim_create(&q->dim, q->memory[0] = aligned_zeros(d_dense_qp_dim_memsize()));
    d_dense_qp_dim_set_nv(variables, &q->dim);
    d_dense_qp_dim_set_nb(variables, &q->dim);
    d_dense_qp_dim_set_ng(rows, &q->dim);
    d_dense_qp_dim_set_ns(rows, &q->dim);
    d_dense_qp_create(&q->dim, &q->qp, q->memory[1] = aligned_zeros(d_dense_qp_memsize(&q->dim)));
    d_dense_qp_sol_create(&q->dim, &q->sol, q->memory[2] = aligned_zeros(d_dense_qp_sol_memsize(&q->dim)));
    d_dense_qp_ipm_arg_create(&q->dim, &q->arg, q->memory[3] = aligned_zeros(d_dense_qp_ipm_arg_memsize(&q->dim)));
    d_dense_qp_ipm_arg_set_default(SPEED_ABS, &q->arg); /* SPEED runs out of steps where soft rows are broken */
    d_dense_qp_ipm_arg_set("tol_stat", &tolerance, &q->arg), d_dense_qp_ipm_arg_set("tol_eq", &tolerance, &q->arg);
    d_dense_qp_ipm_arg_set("tol_ineq", &tolerance, &q->arg), d_dense_qp_ipm_arg_set("tol_comp", &tolerance, &q->arg);
    d_dense_qp_ipm_arg_set("iter_max", &iterations, &q->arg);
    q->memory[4] = aligned_zeros(d_dense_qp_ipm_ws_memsize(&q->dim, &q->arg));
    d_dense_qp_ipm_ws_create(&q->dim, &q->arg, &q->ws, q->memory[4]);
    int *index = malloc(sizeof(int) * (size_t)variables);
    for (int i = 0; i < variables; i++) index[i] = i;
    d_dense_qp_set_idxb(index, &q->qp);
    free(index);
    if (rows) dense_qp_make_rows_soft(q, penalty);
    return q;
}

static void dense_qp_free(dense_qp *q) {
    if (!q) return;
    for (int i = 0; i < 5; i++) free(q->memory[i]);
    free(q);
}

/* Returns HPIPM's status (0: solved) and the number of iterations. */
static int dense_qp_solve(dense_qp *q, double *v, int *iterations) {
    int status;
    d_dense_qp_ipm_solve(&q->qp, &q->sol, &q->arg, &q->ws);
    d_dense_qp_sol_get_v(&q->sol, v);
    d_dense_qp_ipm_get_status(&q->ws, &status);
    d_dense_qp_ipm_get_iter(&q->ws, iterations);
    return status;
}

#endif

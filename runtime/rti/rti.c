/* Real-time iteration for the model compiled in beside it (model.c): one Gauss-Newton step of
 *
 *   minimise  sum_{k=0}^{N-1} 1/2 |x_k - r_k|^2_Q + 1/2 |u_k - s_k|^2_R  +  1/2 |x_N - r_N|^2_P      (PI-TCN eq. 7)
 *   subject to x_{k+1} = f(x_k, u_k), input bounds, and soft bounds on states and collective thrust,
 *
 * split as Diehl's real-time iteration: rti_prepare linearises at the state expected at the next tick and condenses;
 * rti_feedback takes the state that was really measured and solves a dense QP in the inputs alone.
 *
 * Condensing. With columns z = (dx_0, v_0 .. v_{N-1}) and u_k + SCALE v_k the new inputs, the states move by S_k z,
 *   S_0 = [I 0 ..],  S_{k+1} = A_k S_k, plus SCALE B_k in the columns of v_k.
 * The Hessian follows from a backward recursion, W_N = P S_N, W_k = Q S_k + A_k' W_{k+1}; its rows are
 *   H_k = SCALE B_k' W_{k+1} + R SCALE^2 (and the same columns for dx_0 carry the feedback of the initial state),
 * its right-hand side from the adjoint l_N = P (x_N - r_N), l_k = Q (x_k - r_k) + A_k' l_{k+1}. Columns lie along
 * the vector registers. The first columns of S_k are all that is not zero, so stage k touches only those.
 *
 * Bounds on states and thrust are soft and seldom act. The QP is first solved with the input box alone; where its
 * solution leaves the bounds of a quantity, that quantity's rows of all nodes join it, and it is solved again: the
 * optimum of a relaxation that is feasible is the optimum. */
#include <math.h>
#include <time.h>

#include "dense_qp.h"

/* CasADi's code: NODE(x, u, p, e, dt) -> next, A, B and STEP(x, u, p, e, dt) -> next. It is thousands of scalar lines
 * in which -O3 finds nothing but takes many times as long to say so. */
#pragma GCC push_options
#pragma GCC optimize("O1")
#include "model.c"
#pragma GCC pop_options

/* NX, NU, N, NP, NE, SUBSTEPS, VECTOR_BYTES come from the build. */
#define V (N * NU)
#define LANES_PER_VECTOR (VECTOR_BYTES / 8)
#define ROUND(n) (((n) + LANES_PER_VECTOR - 1) / LANES_PER_VECTOR * LANES_PER_VECTOR)
#define X0 ROUND(NX) /* columns of dx_0, padded */
#define L ROUND(X0 + V)
#define SOLVES 3
#define FAR 1e8 /* stands for no bound: the interior-point method wants finite numbers */

typedef double lanes __attribute__((vector_size(VECTOR_BYTES)));

typedef struct {
    double Q[NX], P[NX], R[NU];
    double u_lower[NU], u_upper[NU], x_lower[NX], x_upper[NX];
    double thrust_lower, thrust_upper, thrust_constant;
    double node, scale, levenberg_marquardt, tolerance, penalty;
    int iterations, row_iterations;
} rti_options;

typedef struct {
    double prepare_seconds, rollout_seconds, condense_seconds, feedback_seconds;
    int status, iterations, rows, solves;
} rti_report;

typedef struct {
    rti_options o;
    rti_report report;
    double p[NP], e[NE];
    double x[N + 1][NX], u[N][NU]; /* the current trajectory: predicted states and inputs */
    double x_reference[N + 1][NX], u_reference[N][NU];
    double x_prepared[NX];
    double A[N][NX * NX], B[N][NX * NU]; /* by column, as CasADi writes them */
    double S[N + 1][NX][L] __attribute__((aligned(64)));
    double W[2][NX][L] __attribute__((aligned(64)));
    double G[V][X0]; /* derivative of the gradient by dx_0 */
    double H[V * V], g[V], z[X0 + V], lower[V], upper[V];
    double g_measured[V];
    double C[V * N * (NX + 1)], row_lower[N * (NX + 1)], row_upper[N * (NX + 1)];
    bool bounded[NX + 1]; /* quantities whose rows are in the QP: the states, then collective thrust */
    dense_qp *qp, *rows[NX + 2]; /* without rows, and with the rows of so many quantities */
    long long iw[NODE_IW + STEP_IW + 1];
    double w[NODE_W + STEP_W + 1];
} rti;

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static double lower_bound(const rti *r, int i) { return i == NX ? r->o.thrust_lower : r->o.x_lower[i]; }
static double upper_bound(const rti *r, int i) { return i == NX ? r->o.thrust_upper : r->o.x_upper[i]; }
static bool is_bounded(const rti *r, int i) { return lower_bound(r, i) > -INFINITY || upper_bound(r, i) < INFINITY; }

rti *rti_create(const rti_options *options) {
    rti *r = aligned_zeros(sizeof *r);
    r->o = *options;
    r->qp = dense_qp_create(V, 0, options->tolerance, options->iterations, 0);
    for (int i = 0, quantities = 0; i <= NX; i++)
        if (is_bounded(r, i)) {
            quantities++;
            r->rows[quantities] =
                dense_qp_create(V, N * quantities, options->tolerance, options->row_iterations, options->penalty);
        }
    return r;
}

void rti_free(rti *r) {
    dense_qp_free(r->qp);
    for (int i = 0; i < NX + 2; i++) dense_qp_free(r->rows[i]);
    free(r);
}

double *rti_states(rti *r) { return &r->x[0][0]; }
double *rti_inputs(rti *r) { return &r->u[0][0]; }
double *rti_parameters(rti *r) { return r->p; }
double *rti_environment(rti *r) { return r->e; }
double *rti_hessian(rti *r) { return r->H; }
double *rti_gradient(rti *r) { return r->g; }
rti_report *rti_last_report(rti *r) { return &r->report; }

/* The model over dt seconds, at most a node, for the age of an estimate and the state expected at the next tick. */
void rti_propagate(rti *r, const double *x, const double *u, double dt, double *next) {
    double from[NX], step = dt / SUBSTEPS;
    memcpy(next, x, sizeof from);
    for (int s = 0; s < SUBSTEPS; s++) {
        memcpy(from, next, sizeof from);
        const double *arg[STEP_ARG] = {from, u, r->p, r->e, &step};
        double *res[STEP_RES] = {next};
        STEP(arg, res, r->iw, r->w, 0);
    }
}

/* out = left in, all by column; left is NX x NX. */
static void compose(const double *left, const double *in, double *out, int columns) {
    for (int c = 0; c < columns; c++)
        for (int i = 0; i < NX; i++) {
            double sum = 0;
            for (int j = 0; j < NX; j++) sum += left[j * NX + i] * in[c * NX + j];
            out[c * NX + i] = sum;
        }
}

/* Roll the model out along the inputs, with the Jacobians of every node; a node may take several RK4 steps. */
static void linearise(rti *r) {
    double A[NX * NX], B[NX * NU], x[NX], before[NX * NX], dt = r->o.node / SUBSTEPS;
    for (int k = 0; k < N; k++) {
        const double *arg[NODE_ARG] = {r->x[k], r->u[k], r->p, r->e, &dt};
        double *res[NODE_RES] = {r->x[k + 1], r->A[k], r->B[k]};
        NODE(arg, res, r->iw, r->w, 0);
        for (int s = 1; s < SUBSTEPS; s++) {
            memcpy(x, r->x[k + 1], sizeof x);
            const double *next_arg[NODE_ARG] = {x, r->u[k], r->p, r->e, &dt};
            double *next_res[NODE_RES] = {r->x[k + 1], A, B};
            NODE(next_arg, next_res, r->iw, r->w, 0);
            memcpy(before, r->A[k], sizeof(double) * NX * NX);
            compose(A, before, r->A[k], NX);
            memcpy(before, r->B[k], sizeof(double) * NX * NU);
            compose(A, before, r->B[k], NU);
            for (int i = 0; i < NX * NU; i++) r->B[k][i] += B[i];
        }
    }
}

/* out = M in (or M' in) over the first columns; M is NX x NX by column. */
static void multiply(const double *M, bool transposed, double in[NX][L], double out[NX][L], int columns) {
    const int row = transposed ? NX : 1, column = transposed ? 1 : NX;
    for (int c = 0; c < columns; c += LANES_PER_VECTOR) {
        lanes sum[NX];
        for (int i = 0; i < NX; i++) sum[i] = M[i * row] * *(lanes *)&in[0][c];
        for (int j = 1; j < NX; j++) {
            lanes factor = *(lanes *)&in[j][c];
            for (int i = 0; i < NX; i++) sum[i] += M[i * row + j * column] * factor;
        }
        for (int i = 0; i < NX; i++) *(lanes *)&out[i][c] = sum[i];
    }
}

static int columns_of(int k) { return ROUND(X0 + k * NU); }

static void forward_sensitivities(rti *r) {
    for (int i = 0; i < NX; i++) r->S[0][i][i] = 1;
    for (int k = 0; k < N; k++) {
        multiply(r->A[k], false, r->S[k], r->S[k + 1], columns_of(k));
        for (int i = 0; i < NX; i++)
            for (int j = 0; j < NU; j++) r->S[k + 1][i][X0 + k * NU + j] = r->o.scale * r->B[k][j * NX + i];
    }
}

static void weigh(rti *r, int k, const double *weight, double W[NX][L], bool add) {
    int columns = columns_of(k);
    for (int i = 0; i < NX; i++)
        for (int c = 0; c < columns; c += LANES_PER_VECTOR) {
            lanes term = weight[i] * *(lanes *)&r->S[k][i][c];
            *(lanes *)&W[i][c] = add ? *(lanes *)&W[i][c] + term : term;
        }
}

/* Row block k of the Hessian, SCALE B_k' W_{k+1}, into both halves, and of its derivative by dx_0. */
static void hessian_rows(rti *r, int k, double W[NX][L]) {
    int columns = columns_of(k + 1);
    for (int j = 0; j < NU; j++) {
        double row[L] __attribute__((aligned(64)));
        const double *b = &r->B[k][j * NX];
        for (int c = 0; c < columns; c += LANES_PER_VECTOR) {
            lanes sum = b[0] * *(lanes *)&W[0][c];
            for (int i = 1; i < NX; i++) sum += b[i] * *(lanes *)&W[i][c];
            *(lanes *)&row[c] = r->o.scale * sum;
        }
        int v = k * NU + j;
        memcpy(r->G[v], row, sizeof(double) * NX);
        for (int i = 0; i <= v; i++) r->H[v * V + i] = r->H[i * V + v] = row[X0 + i];
        r->H[v * V + v] += r->o.R[j] * r->o.scale * r->o.scale + r->o.levenberg_marquardt;
    }
}

static void gradient(rti *r) {
    double adjoint[NX], before[NX];
    for (int i = 0; i < NX; i++) adjoint[i] = r->o.P[i] * (r->x[N][i] - r->x_reference[N][i]);
    for (int k = N - 1; k >= 0; k--) {
        for (int j = 0; j < NU; j++) {
            double sum = r->o.R[j] * (r->u[k][j] - r->u_reference[k][j]);
            for (int i = 0; i < NX; i++) sum += r->B[k][j * NX + i] * adjoint[i];
            r->g[k * NU + j] = r->o.scale * sum;
        }
        for (int i = 0; i < NX; i++) {
            before[i] = r->o.Q[i] * (r->x[k][i] - r->x_reference[k][i]);
            for (int c = 0; c < NX; c++) before[i] += r->A[k][i * NX + c] * adjoint[c];
        }
        memcpy(adjoint, before, sizeof adjoint);
    }
}

static void condense(rti *r) {
    forward_sensitivities(r);
    weigh(r, N, r->o.P, r->W[N & 1], false);
    for (int k = N - 1; k >= 0; k--) {
        hessian_rows(r, k, r->W[(k + 1) & 1]);
        if (k == 0) break; /* W_0 would only say what the current state costs */
        multiply(r->A[k], true, r->W[(k + 1) & 1], r->W[k & 1], columns_of(k));
        weigh(r, k, r->o.Q, r->W[k & 1], true);
    }
    gradient(r);
}

/* Move the inputs by a part of a node towards the horizon's end, as time does between two ticks. */
void rti_shift(rti *r, double part) {
    for (int k = 0; k + 1 < N; k++)
        for (int j = 0; j < NU; j++) r->u[k][j] += part * (r->u[k + 1][j] - r->u[k][j]);
}

/* x: the state expected at the next tick. reference: N + 1 states, then N inputs. */
void rti_prepare(rti *r, const double *x, const double *x_reference, const double *u_reference) {
    double start = now();
    memcpy(r->x_prepared, x, sizeof r->x_prepared);
    memcpy(r->x[0], x, sizeof r->x[0]);
    memcpy(r->x_reference, x_reference, sizeof r->x_reference);
    memcpy(r->u_reference, u_reference, sizeof r->u_reference);
    linearise(r);
    double linearised = now();
    condense(r);
    d_dense_qp_set_H(r->H, &r->qp->qp);
    dense_qp_factor(r->qp);
    for (int k = 0; k < N; k++)
        for (int j = 0; j < NU; j++) {
            r->lower[k * NU + j] = (r->o.u_lower[j] - r->u[k][j]) / r->o.scale;
            r->upper[k * NU + j] = (r->o.u_upper[j] - r->u[k][j]) / r->o.scale;
        }
    d_dense_qp_set_lb(r->lower, &r->qp->qp);
    d_dense_qp_set_ub(r->upper, &r->qp->qp);
    double end = now();
    r->report.rollout_seconds = linearised - start;
    r->report.condense_seconds = end - linearised;
    r->report.prepare_seconds = end - start;
}

/* Change of state i at node k under the step z. */
static double move(const rti *r, int k, int i, const double *z) {
    double sum = 0;
    int columns = X0 + k * NU;
    for (int c = 0; c < columns; c++) sum += r->S[k][i][c] * z[c];
    return sum;
}

static double thrust(const rti *r, int k, const double *z) {
    double sum = 0;
    for (int j = 0; j < NU; j++)
        sum += r->u[k][j] * (r->u[k][j] + 2 * r->o.scale * z[X0 + k * NU + j]);
    return r->o.thrust_constant * sum;
}

static double value_of(const rti *r, int k, int i, const double *z) {
    return i == NX ? thrust(r, k, z) : r->x[k + 1][i] + move(r, k + 1, i, z);
}

/* Take in the rows of every quantity that the step z takes out of its bounds; returns whether there was a new one. */
static bool take_violated(rti *r) {
    bool more = false;
    for (int i = 0; i <= NX; i++) {
        if (r->bounded[i] || !is_bounded(r, i)) continue;
        for (int k = 0; k < N && !r->bounded[i]; k++) {
            double value = value_of(r, k, i, r->z), slack = 1e-3 * (fabs(value) + 1e-3);
            r->bounded[i] = value < lower_bound(r, i) - slack || value > upper_bound(r, i) + slack;
        }
        more |= r->bounded[i];
    }
    return more;
}

/* The row of quantity i at node k: its derivative by the inputs, and how far it may still move. */
static void write_row(rti *r, int k, int i, int rows, int place) {
    double at[X0 + V] = {0};
    memcpy(at, r->z, sizeof(double) * NX); /* the measured state moves the row as well */
    for (int c = 0; c < V; c++) r->C[c * rows + place] = 0;
    if (i == NX)
        for (int j = 0; j < NU; j++)
            r->C[(k * NU + j) * rows + place] = 2 * r->o.thrust_constant * r->o.scale * r->u[k][j];
    else
        for (int c = 0; c < (k + 1) * NU; c++) r->C[c * rows + place] = r->S[k + 1][i][X0 + c];
    r->row_lower[place] = fmax(lower_bound(r, i) - value_of(r, k, i, at), -FAR);
    r->row_upper[place] = fmin(upper_bound(r, i) - value_of(r, k, i, at), FAR);
}

static int solve_with_rows(rti *r) {
    int quantities = 0, place = 0, iterations;
    for (int i = 0; i <= NX; i++) quantities += r->bounded[i];
    dense_qp *q = r->rows[quantities];
    for (int i = 0; i <= NX; i++)
        for (int k = 0; k < N && r->bounded[i]; k++) write_row(r, k, i, N * quantities, place++);
    d_dense_qp_set_H(r->H, &q->qp), d_dense_qp_set_g(r->g_measured, &q->qp);
    d_dense_qp_set_lb(r->lower, &q->qp), d_dense_qp_set_ub(r->upper, &q->qp);
    d_dense_qp_set_C(r->C, &q->qp);
    d_dense_qp_set_lg(r->row_lower, &q->qp), d_dense_qp_set_ug(r->row_upper, &q->qp);
    int status = dense_qp_solve(q, r->z + X0, &iterations);
    r->report.rows = place;
    r->report.iterations += iterations;
    return status;
}

static bool finite_all(const double *values, int count) {
    for (int i = 0; i < count; i++)
        if (!isfinite(values[i])) return false;
    return true;
}

/* Add the step to the trajectory. */
static void apply(rti *r) {
    for (int k = 0; k <= N; k++)
        for (int i = 0; i < NX; i++) r->x[k][i] += move(r, k, i, r->z);
    for (int k = 0; k < N; k++)
        for (int j = 0; j < NU; j++) {
            double value = r->u[k][j] + r->o.scale * r->z[X0 + k * NU + j];
            r->u[k][j] = fmin(fmax(value, r->o.u_lower[j]), r->o.u_upper[j]);
        }
}

/* x: the state now. Returns 0 when the QP was solved; else the trajectory keeps what it held, the shifted previous
 * solution, and the status is HPIPM's (1: iterations ran out, 2: step too short, 3: not a number) or -1 for an x that
 * is not finite. A QP that ran out of iterations close to its solution is still taken. */
int rti_feedback(rti *r, const double *x) {
    double start = now();
    rti_report *report = &r->report;
    report->iterations = report->rows = report->solves = 0;
    report->status = -1;
    if (finite_all(x, NX)) {
        for (int i = 0; i < NX; i++) r->z[i] = x[i] - r->x_prepared[i];
        for (int v = 0; v < V; v++) {
            r->g_measured[v] = r->g[v];
            for (int i = 0; i < NX; i++) r->g_measured[v] += r->G[v][i] * r->z[i];
        }
        report->status = 0;
        if (!dense_qp_free_optimum(r->qp, r->g_measured, r->lower, r->upper, r->z + X0)) {
            d_dense_qp_set_g(r->g_measured, &r->qp->qp);
            report->status = dense_qp_solve(r->qp, r->z + X0, &report->iterations);
        }
        memset(r->bounded, 0, sizeof r->bounded);
        for (report->solves = 1; report->solves < SOLVES && finite_all(r->z, X0 + V); report->solves++) {
            if (!take_violated(r)) break;
            report->status = solve_with_rows(r);
        }
        bool usable = report->status <= 1 && finite_all(r->z, X0 + V);
        if (usable) apply(r);
        else if (report->status == 0) report->status = 3;
    }
    report->feedback_seconds = now() - start;
    return report->status;
}

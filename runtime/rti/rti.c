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
 * Bounds on states seldom act. The QP is first solved with the input box alone; only the rows that its solution
 * violates are added (soft), and it is solved again: the optimum of a relaxation that is feasible is the optimum. */
#include <math.h>
#include <stdbool.h>
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
#define ROWS (N * (NX + 1))
#define QP_SIZES 3

typedef double lanes __attribute__((vector_size(VECTOR_BYTES)));

typedef struct {
    double Q[NX], P[NX], R[NU];
    double u_lower[NU], u_upper[NU], x_lower[NX], x_upper[NX];
    double thrust_lower, thrust_upper, thrust_constant;
    double node, scale, levenberg_marquardt, tolerance, penalty;
    int iterations;
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
    double C[V * ROWS], row_lower[ROWS], row_upper[ROWS];
    int row[ROWS];
    dense_qp *box, *rows[QP_SIZES];
    long long iw[NODE_IW + STEP_IW + 1];
    double w[NODE_W + STEP_W + 1];
} rti;

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static int row_capacity(int size) { return size == 0 ? 16 : size == 1 ? 64 : ROWS; }

rti *rti_create(const rti_options *options) {
    rti *r = aligned_zeros(sizeof *r);
    r->o = *options;
    r->box = dense_qp_create(V, 0, options->tolerance, options->iterations, 0);
    for (int i = 0; i < QP_SIZES; i++)
        r->rows[i] = dense_qp_create(V, row_capacity(i), options->tolerance, options->iterations, options->penalty);
    return r;
}

void rti_free(rti *r) {
    dense_qp_free(r->box);
    for (int i = 0; i < QP_SIZES; i++) dense_qp_free(r->rows[i]);
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
    d_dense_qp_set_H(r->H, &r->box->qp);
    for (int k = 0; k < N; k++)
        for (int j = 0; j < NU; j++) {
            r->lower[k * NU + j] = (r->o.u_lower[j] - r->u[k][j]) / r->o.scale;
            r->upper[k * NU + j] = (r->o.u_upper[j] - r->u[k][j]) / r->o.scale;
        }
    d_dense_qp_set_lb(r->lower, &r->box->qp);
    d_dense_qp_set_ub(r->upper, &r->box->qp);
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

/* One row of the QP: value so far, and bounds on what the step may change. Row NX of a node is its thrust. */
static void write_row(rti *r, int index, int capacity, int place) {
    int k = index / (NX + 1), i = index % (NX + 1);
    double value;
    for (int c = 0; c < V; c++) r->C[c * capacity + place] = 0;
    if (i == NX) {
        double zero[X0 + V] = {0};
        value = thrust(r, k, zero);
        for (int j = 0; j < NU; j++)
            r->C[(k * NU + j) * capacity + place] = 2 * r->o.thrust_constant * r->o.scale * r->u[k][j];
        r->row_lower[place] = r->o.thrust_lower - value, r->row_upper[place] = r->o.thrust_upper - value;
        return;
    }
    value = r->x[k + 1][i];
    for (int c = 0; c < NX; c++) value += r->S[k + 1][i][c] * r->z[c];
    for (int c = 0; c < (k + 1) * NU; c++) r->C[c * capacity + place] = r->S[k + 1][i][X0 + c];
    r->row_lower[place] = r->o.x_lower[i] - value, r->row_upper[place] = r->o.x_upper[i] - value;
}

static bool outside(double value, double lower, double upper) {
    double slack = 1e-3 * (fabs(value) + 1e-3);
    return value < lower - slack || value > upper + slack;
}

/* Append the rows that the step z violates to those already there; returns how many there are then. */
static int violated_rows(rti *r, int count) {
    for (int k = 0; k < N; k++)
        for (int i = 0; i <= NX; i++) {
            double lower = i == NX ? r->o.thrust_lower : r->o.x_lower[i];
            double upper = i == NX ? r->o.thrust_upper : r->o.x_upper[i];
            if (lower == -INFINITY && upper == INFINITY) continue;
            double value = i == NX ? thrust(r, k, r->z) : r->x[k + 1][i] + move(r, k + 1, i, r->z);
            if (!outside(value, lower, upper)) continue;
            int index = k * (NX + 1) + i, known = 0;
            for (int n = 0; n < count; n++) known |= r->row[n] == index;
            if (!known) r->row[count++] = index;
        }
    return count;
}

#define FAR 1e8 /* stands for no bound: the interior-point method wants finite numbers */

static int solve_with_rows(rti *r, double *g, int count) {
    int size = 0, iterations;
    while (row_capacity(size) < count) size++;
    int capacity = row_capacity(size);
    dense_qp *q = r->rows[size];
    for (int n = 0; n < capacity; n++) {
        if (n < count) {
            write_row(r, r->row[n], capacity, n);
            continue;
        }
        for (int c = 0; c < V; c++) r->C[c * capacity + n] = 0;
        r->row_lower[n] = -FAR, r->row_upper[n] = FAR;
    }
    for (int n = 0; n < capacity; n++) {
        r->row_lower[n] = fmax(r->row_lower[n], -FAR);
        r->row_upper[n] = fmin(r->row_upper[n], FAR);
    }
    d_dense_qp_set_H(r->H, &q->qp), d_dense_qp_set_g(g, &q->qp);
    d_dense_qp_set_lb(r->lower, &q->qp), d_dense_qp_set_ub(r->upper, &q->qp);
    d_dense_qp_set_C(r->C, &q->qp);
    d_dense_qp_set_lg(r->row_lower, &q->qp), d_dense_qp_set_ug(r->row_upper, &q->qp);
    int status = dense_qp_solve(q, r->z + X0, &iterations);
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
    double start = now(), g[V];
    rti_report *report = &r->report;
    report->iterations = report->rows = report->solves = 0;
    report->status = -1;
    if (finite_all(x, NX)) {
        for (int i = 0; i < NX; i++) r->z[i] = x[i] - r->x_prepared[i];
        for (int v = 0; v < V; v++) {
            g[v] = r->g[v];
            for (int i = 0; i < NX; i++) g[v] += r->G[v][i] * r->z[i];
        }
        d_dense_qp_set_g(g, &r->box->qp);
        report->status = dense_qp_solve(r->box, r->z + X0, &report->iterations);
        report->solves = 1;
        for (int count = 0; report->solves < 4 && finite_all(r->z, X0 + V); report->solves++) {
            int more = violated_rows(r, count);
            if (more == count) break;
            report->rows = count = more;
            report->status = solve_with_rows(r, g, count);
        }
        bool usable = report->status <= 1 && finite_all(r->z, X0 + V);
        if (usable) apply(r);
        else if (report->status == 0) report->status = 3;
    }
    report->feedback_seconds = now() - start;
    return report->status;
}

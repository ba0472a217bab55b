/* The condensed problem, the result of a preparation, and the feedback that solves it; the including file rolls out
 * and condenses.
 *
 * With columns z = (dx_0, v_0 .. v_{N-1}) and u_k + SCALE v_k the new inputs, the predicted states move by S_k z. A
 * preparation gives the trajectory (x, u), S, the Hessian H and gradient g of the cost by v, and G, the derivative of g
 * by dx_0. rti_feedback takes the measured state and solves a dense QP in the inputs alone.
 *
 * Bounds on states and thrust are soft and seldom act. The QP is first solved with the input box alone (box_qp.h);
 * where its solution leaves the bounds of a quantity, that quantity's rows of all nodes join it, and it is solved again
 * by HPIPM: the optimum of a relaxation that is feasible is the optimum. */
#ifndef ALULA_CONDENSED_H
#define ALULA_CONDENSED_H

#include <math.h>
#include <time.h>

/* Required from the including file: NX, NU, NODES, NP, NE, SUBSTEPS, VECTOR_BYTES; HISTORY, columns of its past;
 * SENSITIVITY, the type of S; START, the column of dx_0's first entry; X0, the first column of v_0. */
#define NV (NODES * NU)
#define LANES_OF(type) (VECTOR_BYTES / (int)sizeof(type))
#define ROUND_TO(n, step) (((n) + (step) - 1) / (step) * (step))
#define LD_S ROUND_TO(X0 + NV, LANES_OF(SENSITIVITY))
#define SOLVES 3
#define SUMS 16

#include "box_qp.h"
#include "dense_qp.h"
#include "flight_filter.h"
#include "state.h"

#define FAR 1e8 /* no bound: the interior-point method takes finite numbers only */
#define DISTURBANCE (2 * AXES + 2)

typedef struct {
    double Q[NX], P[NX], R[NU];
    double u_lower[NU], u_upper[NU], x_lower[NX], x_upper[NX];
    double thrust_constant[NU], thrust_lower, thrust_upper; /* of each rotor, N s^2/rad^2; of all, N */
    double node, scale, levenberg_marquardt, tolerance, penalty;
    int iterations, row_iterations;
} rti_options;

typedef struct {
    double prepare_seconds, rollout_seconds, tangent_seconds, condense_seconds, feedback_seconds;
    int status, iterations, rows, solves;
} rti_report;

typedef struct {
    double x[NODES + 1][NX], u[NODES][NU]; /* the current trajectory: predicted states and inputs */
    double x_reference[NODES + 1][NX], u_reference[NODES][NU];
    double x_prepared[NX];
    SENSITIVITY S[NODES + 1][NX][LD_S] __attribute__((aligned(64)));
    double G[NV][NX]; /* derivative of the gradient by dx_0 */
    double H[NV * NV], g[NV], z[X0 + NV], lower[NV], upper[NV];
    double g_measured[NV];
    flight_filter filter;
    double disturbance[DISTURBANCE]; /* accelerations that stay, those that fade, rates of fading, 1/s */
    double C[NV * NODES * (NX + 1)], row_lower[NODES * (NX + 1)], row_upper[NODES * (NX + 1)];
    rti_options options;
    rti_report report;
    bool prepared;
    bool bounded[NX + 1]; /* whether a quantity's rows are in the QP: each state, then collective thrust */
    box_qp box;
    dense_qp *rows[NX + 2]; /* HPIPM's, by the number of quantities with rows; without any where box_qp fails */
} condensed;

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static double lower_bound(const condensed *r, int i) {
    return i == NX ? r->options.thrust_lower : r->options.x_lower[i];
}
static double upper_bound(const condensed *r, int i) {
    return i == NX ? r->options.thrust_upper : r->options.x_upper[i];
}
static bool is_bounded(const condensed *r, int i) {
    return lower_bound(r, i) > -INFINITY || upper_bound(r, i) < INFINITY;
}

static void condensed_create(condensed *r, const rti_options *options) {
    r->options = *options;
    r->rows[0] = dense_qp_create(NV, 0, options->tolerance, options->iterations, 0);
    for (int i = 0, quantities = 0; i <= NX; i++)
        if (is_bounded(r, i)) {
            quantities++;
            r->rows[quantities] =
                dense_qp_create(NV, NODES * quantities, options->tolerance, options->row_iterations, options->penalty);
        }
}

void rti_free(condensed *r) {
    for (int i = 0; i < NX + 2; i++) dense_qp_free(r->rows[i]);
    free(r);
}

double *rti_states(condensed *r) { return &r->x[0][0]; }
double *rti_inputs(condensed *r) { return &r->u[0][0]; }
double *rti_input_upper(condensed *r) { return r->options.u_upper; }
double *rti_disturbance(condensed *r) { return r->disturbance; }
filter_options *rti_filter_options(condensed *r) { return &r->filter.options; }
double *rti_filter_state(condensed *r) { return r->filter.state; }
double *rti_filter_covariance(condensed *r) { return &r->filter.P[0][0]; }
double *rti_filter_trust(condensed *r) { return r->filter.trust; }
double *rti_filter_level(condensed *r) { return &r->filter.level; }
double *rti_filter_squares(condensed *r) { return &r->filter.square[0][0]; }
double *rti_filter_deviations(condensed *r) { return r->filter.deviation; }
int *rti_filter_followed(condensed *r) { return r->filter.followed; }
void rti_filter_clear(condensed *r) { filter_clear(&r->filter); }
void rti_fly_disturbance(condensed *r, double moments) { filter_flown(&r->filter, moments, r->disturbance); }
double *rti_hessian(condensed *r) { return r->H; }
double *rti_gradient(condensed *r) { return r->g; }
rti_report *rti_last_report(condensed *r) { return &r->report; }

static void rates_of(const double *x, double *rates) {
    for (int i = 0; i < 3; i++) rates[i] = x[VELOCITY + i], rates[3 + i] = x[RATE + i];
}

/* Let the filter go on from a state (NX). */
void rti_filter_restart(condensed *r, const double *x) {
    double measured[AXES];
    rates_of(x, measured);
    filter_restart(&r->filter, measured);
}

/* Compare a prediction by the model alone with the state (NX) that it is of, dt seconds after the last; no parameter is
 * followed. change, change_by_file: (6,) of velocity and rate, by the model as it follows and as it was trained. Returns
 * whether it was used. */
int rti_filter_compare(condensed *r, const double *before, const double *change, const double *change_by_file,
                       const double *x, double dt) {
    double first[AXES], measured[AXES];
    rates_of(before, first);
    rates_of(x, measured);
    return filter_update(&r->filter, change, change_by_file, first, measured, dt);
}

/* Dimensions for the loader to compare with its own. */
void rti_dimensions(int *dimensions) {
    const int built[] = {NX, NU, NODES, NP, NE, HISTORY, SUBSTEPS, VECTOR_BYTES, (int)sizeof(rti_options), (int)sizeof(filter_options)};
    memcpy(dimensions, built, sizeof built);
}

/* Accelerations beyond the model, some seconds after the state that a prediction starts from. */
static void disturbance_at(const condensed *r, double seconds, double *accelerations) {
    const double *staying = r->disturbance, *fading = r->disturbance + AXES;
    const double *rates = r->disturbance + 2 * AXES; /* of linear and of angular ones */
    double left[2] = {exp(-rates[0] * seconds), exp(-rates[1] * seconds)};
    for (int i = 0; i < AXES; i++) accelerations[i] = staying[i] + left[i / 3] * fading[i];
}

static bool finite_all(const double *values, int count) {
    for (int i = 0; i < count; i++)
        if (!isfinite(values[i])) return false;
    return true;
}

/* Copy a preparation's arguments; returns whether all of them are finite, and the present inputs: a ReLU maps NaN to
 * zero, so that a network's prediction would not show one. */
static bool condensed_begin(condensed *r, const double *x, const double *x_reference, const double *u_reference) {
    r->prepared = finite_all(x, NX) && finite_all(&r->u[0][0], NV) && finite_all(x_reference, (NODES + 1) * NX) &&
                  finite_all(u_reference, NV);
    if (!r->prepared) return false;
    memcpy(r->x_prepared, x, sizeof r->x_prepared);
    memcpy(r->x[0], x, sizeof r->x[0]);
    memcpy(r->x_reference, x_reference, sizeof r->x_reference);
    memcpy(r->u_reference, u_reference, sizeof r->u_reference);
    return true;
}

/* Factor the finished Hessian, and put the box around the inputs. */
static void condensed_finish(condensed *r) {
    box_qp_factor(&r->box, r->H);
    for (int k = 0; k < NODES; k++)
        for (int j = 0; j < NU; j++) {
            r->lower[k * NU + j] = (r->options.u_lower[j] - r->u[k][j]) / r->options.scale;
            r->upper[k * NU + j] = (r->options.u_upper[j] - r->u[k][j]) / r->options.scale;
        }
}

/* Move the inputs by a part of a node towards the horizon's end, as time does between two ticks. */
void rti_shift(condensed *r, double part) {
    for (int k = 0; k + 1 < NODES; k++)
        for (int j = 0; j < NU; j++) r->u[k][j] += part * (r->u[k + 1][j] - r->u[k][j]);
}

/* Change of state i at node k under the step z; sums side by side, so that additions do not wait. */
static double move(const condensed *r, int k, int i, const double *z) {
    const SENSITIVITY *row = r->S[k][i];
    double sums[SUMS] = {0}, sum = 0;
    int c = 0, columns = X0 + k * NU;
    for (; c + SUMS <= columns; c += SUMS)
        for (int part = 0; part < SUMS; part++) sums[part] += row[c + part] * z[c + part];
    for (; c < columns; c++) sum += row[c] * z[c];
    for (int part = 0; part < SUMS; part++) sum += sums[part];
    return sum;
}

static double thrust(const condensed *r, int k, const double *z) {
    double sum = 0;
    for (int j = 0; j < NU; j++) {
        const double u = r->u[k][j], change = r->options.scale * z[X0 + k * NU + j];
        sum += r->options.thrust_constant[j] * u * (u + 2 * change);
    }
    return sum;
}

static double value_of(const condensed *r, int k, int i, const double *z) {
    return i == NX ? thrust(r, k, z) : r->x[k + 1][i] + move(r, k + 1, i, z);
}

/* Add the rows of every quantity that the step z takes out of its bounds; returns whether there is a new one. */
static bool add_violated(condensed *r) {
    bool more = false;
    for (int i = 0; i <= NX; i++) {
        if (r->bounded[i] || !is_bounded(r, i)) continue;
        for (int k = 0; k < NODES && !r->bounded[i]; k++) {
            double value = value_of(r, k, i, r->z), slack = 1e-3 * (fabs(value) + 1e-3);
            r->bounded[i] = value < lower_bound(r, i) - slack || value > upper_bound(r, i) + slack;
        }
        more |= r->bounded[i];
    }
    return more;
}

/* The row of quantity i at node k: its derivative by the inputs, and how far it may still move. */
static void write_row(condensed *r, int k, int i, int rows, int place) {
    double at[X0 + NV] = {0};
    memcpy(at + START, r->z + START, sizeof(double) * NX); /* the measured state moves the row as well */
    for (int c = 0; c < NV; c++) r->C[c * rows + place] = 0;
    if (i == NX)
        for (int j = 0; j < NU; j++)
            r->C[(k * NU + j) * rows + place] = 2 * r->options.thrust_constant[j] * r->options.scale * r->u[k][j];
    else
        for (int c = 0; c < (k + 1) * NU; c++) r->C[c * rows + place] = r->S[k + 1][i][X0 + c];
    r->row_lower[place] = fmax(lower_bound(r, i) - value_of(r, k, i, at), -FAR);
    r->row_upper[place] = fmin(upper_bound(r, i) - value_of(r, k, i, at), FAR);
}

static int solve_with_rows(condensed *r) {
    int quantities = 0, place = 0, iterations;
    for (int i = 0; i <= NX; i++) quantities += r->bounded[i];
    dense_qp *q = r->rows[quantities];
    for (int i = 0; i <= NX; i++)
        for (int k = 0; k < NODES && r->bounded[i]; k++) write_row(r, k, i, NODES * quantities, place++);
    d_dense_qp_set_H(r->H, &q->qp), d_dense_qp_set_g(r->g_measured, &q->qp);
    d_dense_qp_set_lb(r->lower, &q->qp), d_dense_qp_set_ub(r->upper, &q->qp);
    d_dense_qp_set_C(r->C, &q->qp);
    d_dense_qp_set_lg(r->row_lower, &q->qp), d_dense_qp_set_ug(r->row_upper, &q->qp);
    int status = dense_qp_solve(q, r->z + X0, &iterations);
    r->report.rows = place;
    r->report.iterations += iterations;
    return status;
}

/* Solve with the input box alone, and by HPIPM where that fails. Returns the status. */
static int solve_in_box(condensed *r) {
    double *v = r->z + X0;
    const rti_options *options = &r->options;
    int *iterations = &r->report.iterations, more;
    if (box_qp_free_optimum(&r->box, r->g_measured, r->lower, r->upper, v)) return 0;
    int status = box_qp_solve(&r->box, r->H, r->g_measured, r->lower, r->upper, options->tolerance,
                              options->iterations, v, iterations);
    if (status == 0) return 0;
    dense_qp *q = r->rows[0];
    d_dense_qp_set_H(r->H, &q->qp), d_dense_qp_set_g(r->g_measured, &q->qp);
    d_dense_qp_set_lb(r->lower, &q->qp), d_dense_qp_set_ub(r->upper, &q->qp);
    status = dense_qp_solve(q, v, &more);
    *iterations += more;
    return status;
}

/* Add the step to the trajectory. */
static void apply(condensed *r) {
    for (int k = 0; k <= NODES; k++)
        for (int i = 0; i < NX; i++) r->x[k][i] += move(r, k, i, r->z);
    for (int k = 0; k < NODES; k++)
        for (int j = 0; j < NU; j++) {
            double value = r->u[k][j] + r->options.scale * r->z[X0 + k * NU + j];
            r->u[k][j] = fmin(fmax(value, r->options.u_lower[j]), r->options.u_upper[j]);
        }
}

/* x: the state now. Returns 0 when the QP was solved, 1 when its iterations ran out: the last iterate is used. With
 * any other status the trajectory stays the shifted previous solution: HPIPM's 2 (step too short) and 3 (NaN), or -1
 * for an x that is not finite or a preparation that was refused. */
int rti_feedback(condensed *r, const double *x) {
    double start = now();
    rti_report *report = &r->report;
    report->iterations = report->rows = report->solves = 0;
    report->status = -1;
    if (r->prepared && finite_all(x, NX)) {
        for (int i = 0; i < NX; i++) r->z[START + i] = x[i] - r->x_prepared[i];
        for (int v = 0; v < NV; v++) {
            r->g_measured[v] = r->g[v];
            for (int i = 0; i < NX; i++) r->g_measured[v] += r->G[v][i] * r->z[START + i];
        }
        report->status = solve_in_box(r);
        memset(r->bounded, 0, sizeof r->bounded);
        for (report->solves = 1; report->solves < SOLVES && finite_all(r->z, X0 + NV); report->solves++) {
            if (!add_violated(r)) break;
            report->status = solve_with_rows(r);
        }
        bool usable = report->status <= 1 && finite_all(r->z, X0 + NV);
        if (usable) apply(r);
        else if (report->status == 0) report->status = 3;
    }
    report->feedback_seconds = now() - start;
    return report->status;
}

#endif

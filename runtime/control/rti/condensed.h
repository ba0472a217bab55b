/* The condensed problem, the result of a preparation, and the feedback that solves it; the including file rolls out
 * and condenses.
 *
 * With columns z = (dx_0, v_0 .. v_{N-1}) and u_k + SCALE v_k the new inputs, the predicted states move by S_k z. A
 * preparation gives the trajectory (x, u), S, the Hessian H and gradient g of the cost by v, and G, the derivative of g
 * by dx_0. rti_feedback takes the measured state and solves a dense QP in the inputs alone.
 *
 * Bounds on states and thrust are soft rows of that QP (box_qp.h). A preparation solves it as far as the state expected
 * allows; the feedback goes on from there with the measured one, for so many iterations at most. */
#ifndef ALULA_CONDENSED_H
#define ALULA_CONDENSED_H

#include <math.h>
#include <stdlib.h>
#include <time.h>

/* Required from the including file: NX, NU, NODES, NP, NE, VECTOR_BYTES; HISTORY, columns of its past; STEPS of the
 * network in the horizon, 0 without one; SENSITIVITY, the type of S; START, the column of dx_0's first entry; X0, the first column of v_0. */
#define NV (NODES * NU)
#define LANES_OF(type) (VECTOR_BYTES / (int)sizeof(type))
#define ROUND_TO(n, step) (((n) + (step) - 1) / (step) * (step))
#define LD_S ROUND_TO(X0 + NV, LANES_OF(SENSITIVITY))
#define SOFT (NODES * (NX + 1))
#define NO_ROOM 1e-4 /* of a scaled input: what bounds that coincide are moved apart by */
#define SUMS 16

#include "box_qp.h"
#include "flight_filter.h"
#include "last_setpoint.h"
#include "state.h"

#define FAR 1e6 /* no bound: the interior-point method takes finite numbers only */
#define DISTURBANCE (2 * AXES + 2)

typedef struct {
    double Q[NX], P[NX], R[NU];
    double u_lower[NU], u_upper[NU], x_lower[NX], x_upper[NX];
    double thrust_constant[NU];        /* of each rotor, N s^2/rad^2 */
    double interval[NODES];            /* between nodes, s */
    double thrust_lower, thrust_upper; /* of all rotors, N */
    double scale, levenberg_marquardt, tolerance, penalty;
    int iterations, preparation_iterations;
} rti_options;

typedef struct {
    double prepare_seconds, rollout_seconds, tangent_seconds, condense_seconds, feedback_seconds;
    int status, iterations, rows, preparation_iterations;
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
    rti_options options;
    double share[NODES + 1]; /* of the cost, by stage: as the intervals are to the first; 1 of the last node */
    rti_report report;
    bool prepared;
    int bounded[NX + 1], quantities; /* those with bounds: states, then NX for collective thrust */
    soft_rows soft;
    box_qp box;
} condensed;

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void *aligned_zeros(size_t bytes) {
    size_t padded = (bytes + 127) / 64 * 64;
    void *memory = aligned_alloc(64, padded);
    if (memory) memset(memory, 0, padded);
    return memory;
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
    r->soft.penalty = options->penalty;
    for (int k = 0; k < NODES; k++) r->share[k] = options->interval[k] / options->interval[0];
    r->share[NODES] = 1;
    for (int i = 0; i <= NX; i++)
        if (is_bounded(r, i)) r->bounded[r->quantities++] = i;
    r->soft.count = ROUND_TO(NODES * r->quantities, BOX_LANES); /* the last ones are empty */
}

void rti_free(condensed *r) { free(r); }

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
double *rti_measured_gradient(condensed *r) { return r->g_measured; }
double *rti_rows(condensed *r) { return &r->soft.rows[0][0]; }
double *rti_row_bounds(condensed *r) { return &r->soft.bound[0][0]; }
int rti_row_width(void) { return BOX_ROWS; }
int rti_row_capacity(void) { return SOFT_ROWS; }
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
    const int built[] = {NX, NU, NODES, NP, NE, HISTORY, STEPS, VECTOR_BYTES, (int)sizeof(rti_options),
                         (int)sizeof(filter_options), SOFT, (int)sizeof(last_setpoint_model)};
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

/* Move the inputs by some seconds towards the horizon's end, as time does between two ticks: each becomes the mean, over
 * its interval, of the inputs that are constant over theirs. No farther than the next interval. */
void rti_shift(condensed *r, double seconds) {
    for (int k = 0; k + 1 < NODES; k++) {
        const double part = fmin(seconds / r->options.interval[k], 1);
        for (int j = 0; j < NU; j++) r->u[k][j] += part * (r->u[k + 1][j] - r->u[k][j]);
    }
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

/* Collective thrust of the present inputs, N. */
static double thrust(const condensed *r, int k) {
    double sum = 0;
    for (int j = 0; j < NU; j++) sum += r->options.thrust_constant[j] * r->u[k][j] * r->u[k][j];
    return sum;
}

/* The rows of all nodes, derivatives by the inputs; by node, so that their ends rise. */
static void write_rows(condensed *r) {
    soft_rows *soft = &r->soft;
    for (int place = 0; place < NODES * r->quantities; place++) {
        const int k = place / r->quantities, i = r->bounded[place % r->quantities];
        double *row = soft->rows[place], largest = 0;
        memset(row, 0, sizeof soft->rows[place]);
        soft->start[place] = i == NX ? k * NU : 0, soft->end[place] = (k + 1) * NU;
        if (i == NX)
            for (int j = 0; j < NU; j++)
                row[k * NU + j] = 2 * r->options.thrust_constant[j] * r->options.scale * r->u[k][j];
        else
            for (int c = 0; c < (k + 1) * NU; c++) row[c] = r->S[k + 1][i][X0 + c];
        for (int c = 0; c < (k + 1) * NU; c++) largest = fmax(largest, row[c] * row[c]);
        soft->largest[place] = largest;
    }
}

/* How far each row may move from where the state's change since the preparation, dx_0 of z, takes it. */
static void bound_rows(condensed *r) {
    soft_rows *soft = &r->soft;
    for (int place = 0; place < NODES * r->quantities; place++) {
        const int k = place / r->quantities, i = r->bounded[place % r->quantities];
        double value = i == NX ? thrust(r, k) : r->x[k + 1][i];
        for (int j = 0; j < NX && i < NX; j++) value += r->S[k + 1][i][START + j] * r->z[START + j];
        soft->bound[0][place] = fmin(upper_bound(r, i) - value, FAR);
        soft->bound[1][place] = fmax(lower_bound(r, i) - value, -FAR);
    }
    for (int place = NODES * r->quantities; place < soft->count; place++)
        soft->bound[0][place] = 1, soft->bound[1][place] = -1;
}

/* The optimum without bounds, v; returns whether it keeps them all. */
static bool free_optimum(condensed *r, const box_program *program, double *v) {
    return box_qp_free_optimum(&r->box, program->g, r->lower, r->upper, v) && box_rows_kept(program, v);
}

/* Factor the finished Hessian, put bounds around the inputs and rows, and solve as if the state will be as expected. */
static void condensed_finish(condensed *r) {
    const box_program program = {r->H, r->g, r->lower, r->upper, &r->soft};
    double v[NV];
    box_qp_factor(&r->box, r->H);
    for (int k = 0; k < NODES; k++)
        for (int j = 0; j < NU; j++) {
            const double lower = (r->options.u_lower[j] - r->u[k][j]) / r->options.scale;
            const double upper = (r->options.u_upper[j] - r->u[k][j]) / r->options.scale;
            r->lower[k * NU + j] = lower, r->upper[k * NU + j] = fmax(upper, lower + NO_ROOM);
        }
    memset(r->z, 0, sizeof r->z);
    write_rows(r);
    bound_rows(r);
    r->report.preparation_iterations = 0;
    if (free_optimum(r, &program, v)) box_qp_begin_at(&r->box, &program, v);
    else r->report.preparation_iterations = box_qp_begin(&r->box, &program, r->options.preparation_iterations);
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

/* x: the state now. Returns 0 when the QP was solved, 1 when its iterations ran out: its inputs keep their bounds, and
 * are used. With any other status the trajectory stays the shifted previous solution: 3 where the QP is none that can be
 * solved, or -1 for an x that is not finite or a preparation that was refused. */
int rti_feedback(condensed *r, const double *x) {
    double start = now(), *v = r->z + X0;
    rti_report *report = &r->report;
    report->iterations = report->rows = 0;
    report->status = -1;
    if (r->prepared && finite_all(x, NX)) {
        for (int i = 0; i < NX; i++) r->z[START + i] = x[i] - r->x_prepared[i];
        for (int i = 0; i < NV; i++) {
            r->g_measured[i] = r->g[i];
            for (int j = 0; j < NX; j++) r->g_measured[i] += r->G[i][j] * r->z[START + j];
        }
        bound_rows(r);
        const box_program program = {r->H, r->g_measured, r->lower, r->upper, &r->soft};
        report->status = 0;
        if (!free_optimum(r, &program, v)) {
            report->status = box_qp_solve(&r->box, &program, r->options.tolerance, r->options.iterations, v,
                                          &report->iterations);
            report->rows = r->box.rows_act;
        }
        if (report->status <= 1 && !finite_all(r->z, X0 + NV)) report->status = 3;
        if (report->status <= 1) apply(r);
    }
    report->feedback_seconds = now() - start;
    return report->status;
}

#endif

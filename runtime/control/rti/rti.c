/* Real-time iteration for the model compiled with it (model.c): one Gauss-Newton step of
 *
 *   minimise  sum_{k=0}^{N-1} 1/2 |x_k - r_k|^2_Q + 1/2 |u_k - s_k|^2_R  +  1/2 |x_N - r_N|^2_P      (PI-TCN eq. 7)
 *   subject to x_{k+1} = f(x_k, u_k), input bounds, and soft bounds on states and collective thrust,
 *
 * split as Diehl's real-time iteration: rti_prepare linearises at the state expected at the next tick and condenses;
 * rti_feedback (condensed.h) solves for the measured state.
 *
 * Condensing. The states move by S_k z,
 *   S_0 = [I 0 ..],  S_{k+1} = A_k S_k, plus SCALE B_k in the columns of v_k.
 * The Hessian follows from a backward recursion, W_N = P S_N, W_k = Q S_k + A_k' W_{k+1}; its rows are
 *   H_k = SCALE B_k' W_{k+1} + R SCALE^2 (and the same columns for dx_0 carry the feedback of the initial state),
 * its right-hand side from the adjoint l_N = P (x_N - r_N), l_k = Q (x_k - r_k) + A_k' l_{k+1}. Columns lie along
 * the vector registers. Only the first columns of S_k are not zero, so stage k computes only those.
 *
 * Intervals h_k between nodes may differ: stage k then weighs Q and R times h_k / h_0. */

/* NX, NU, NODES, NP, NE, MAX_STEP of RK4, s, VECTOR_BYTES come from the build. */
#define SENSITIVITY double
#define START 0
#define HISTORY 0
#define STEPS 0
#define X0 ROUND_TO(NX, LANES_OF(double)) /* columns of dx_0, padded */
#include "condensed.h"

/* CasADi's code: NODE(x, u, p, e, dt) -> next, A, B and STEP(x, u, p, e, dt) -> next. Without LOOPS it is thousands of
 * scalar lines, which -O3 makes no faster and takes many times as long to compile. */
#pragma GCC push_options
#if !LOOPS
#pragma GCC optimize("O1")
#endif
#include "model.c"
#pragma GCC pop_options

#include "parameter_fit.h"
#include "thrust_history.h"

#define SLOPE_STEP 1e-3 /* of a prior's standard deviation, for derivatives by parameters */
#define LANES_PER_VECTOR LANES_OF(double)
#define ROUND(n) ROUND_TO(n, LANES_PER_VECTOR)

typedef double lanes __attribute__((vector_size(VECTOR_BYTES)));

typedef struct {
    condensed ocp;
    double p[NP], e[NE];
    parameter_fit fit;
    thrust_history thrust;
    double A[NODES][NX * NX], B[NODES][NX * NU]; /* by column, as CasADi writes them */
    double W[2][NX][LD_S] __attribute__((aligned(64)));
    long long iw[NODE_IW + STEP_IW + 1];
    double w[NODE_W + STEP_W + 1];
} rti;

rti *rti_create(const rti_options *options) {
    rti *r = aligned_zeros(sizeof *r);
    condensed_create(&r->ocp, options);
    return r;
}

double *rti_parameters(rti *r) { return r->p; }
double *rti_environment(rti *r) { return r->e; }

/* RK4 steps over some seconds. */
static int substeps_of(double seconds) {
    return isfinite(MAX_STEP) ? (int)fmax(1, ceil(seconds / MAX_STEP)) : 1;
}

/* Contribution of the disturbance to velocity and rate in half a substep of dt seconds, the s-th after the state's time. A
 * substep is these, the model, and these again (Strang splitting): second order, and a constant in every derivative. */
static void half_kick(const rti *r, double s, double dt, double *kick) {
    disturbance_at(&r->ocp, (s + 0.5) * dt, kick);
    for (int i = 0; i < AXES; i++) kick[i] *= 0.5 * dt;
}

static void push(double *x, const double *kick) {
    for (int i = 0; i < 3; i++) x[VELOCITY + i] += kick[i], x[RATE + i] += kick[3 + i];
}

/* The model over dt seconds, for the age of an estimate and the state expected at the next tick. */
void rti_propagate(rti *r, const double *x, const double *u, double dt, double *next) {
    const int substeps = substeps_of(fmax(dt, r->ocp.options.interval[0]));
    double from[NX], kick[AXES], step = dt / substeps;
    memcpy(next, x, sizeof from);
    for (int s = 0; s < substeps; s++) {
        memcpy(from, next, sizeof from);
        half_kick(r, s, step, kick);
        push(from, kick);
        const double *arg[STEP_ARG] = {from, u, r->p, r->e, &step};
        double *res[STEP_RES] = {next};
        STEP(arg, res, r->iw, r->w, 0);
        push(next, kick);
    }
}

/* Change (6,) of velocity and rate under the inputs (segments, NU), each for its seconds, from the state x. */
static void change_over(rti *r, const double *x, const double *inputs, const double *seconds, int segments,
                        double *change) {
    double from[NX], after[NX], before[AXES];
    memcpy(after, x, sizeof after);
    for (int s = 0; s < segments; s++) {
        memcpy(from, after, sizeof from);
        rti_propagate(r, from, inputs + s * NU, seconds[s], after);
    }
    rates_of(x, before);
    rates_of(after, change);
    for (int i = 0; i < AXES; i++) change[i] -= before[i];
}

/* Let the parameters that are followed have the values that their states say. */
static void use_followed(rti *r) {
    const filter_options *o = &r->ocp.filter.options;
    for (int j = 0; j < o->count; j++) r->p[o->index[j]] = fit_value(&r->ocp.filter, j);
}

/* The model's acceleration (AXES) in a state. */
static void acceleration_at(rti *r, const double *x, const double *inputs, double *acceleration) {
    const double dt = FIT_STEP;
    change_over(r, x, inputs, &dt, 1, acceleration);
    for (int i = 0; i < AXES; i++) acceleration[i] /= dt;
}

/* Take the next row into the sweep of the fit, with the parameters as they are in p. */
static void fit_next(rti *r) {
    parameter_fit *t = &r->fit;
    const filter_options *o = &r->ocp.filter.options;
    const bool changed = t->at < t->changed;
    const fit_row *row = &t->rows[t->at++ % FIT_ROWS];
    double usual[AXES], moved[AXES], left[3], slopes[3][MAX_FOLLOWED];
    acceleration_at(r, row->state, row->inputs, usual);
    for (int i = 0; i < 3; i++) left[i] = row->beyond[i] - (usual[i] - row->usual[i]);
    for (int j = 0; j < o->count; j++) {
        double *parameter = &r->p[o->index[j]], value = *parameter;
        *parameter = value + SLOPE_STEP * o->scale[j];
        acceleration_at(r, row->state, row->inputs, moved);
        *parameter = value;
        for (int i = 0; i < 3; i++) slopes[i][j] = (moved[i] - usual[i]) / SLOPE_STEP;
    }
    fit_take(t, o, left, slopes, row->joined, changed);
}

/* A part of the sweep over the rows of the fit. Where it ends the parameters move, and the disturbance by as much as the
 * model's acceleration does in the state x: the force that acts is the same. The staying part moves by the mean of all
 * rows, since it had come from there, and what fades by the rest. */
static void work_on_fit(rti *r, const double *x, const double *inputs) {
    parameter_fit *t = &r->fit;
    flight_filter *f = &r->ocp.filter;
    double before[AXES], after[AXES], mean[3];
    if (t->until < FIT_MIN_ROWS) {
        if (t->added >= FIT_MIN_ROWS) fit_begin(t);
        return;
    }
    if (t->at < t->added - FIT_ROWS) t->at = t->added - FIT_ROWS; /* overwritten meanwhile */
    for (int k = 0; k < FIT_AT_A_TICK && t->at < t->until; k++) fit_next(r);
    if (t->at < t->until) return;
    acceleration_at(r, x, inputs, before);
    fit_end(t, f, mean);
    use_followed(r);
    acceleration_at(r, x, inputs, after);
    for (int i = 0; i < AXES; i++) {
        const double moved = after[i] - before[i], stays = i < 3 ? mean[i] : moved;
        f->state[STAYING + i] -= stays;
        f->state[FADING + i] -= moved - stays;
    }
}

/* Compare the state x with its prediction from the state before: by the inputs (segments, NU), each for its seconds, with
 * the parameters as they are followed and without the disturbance. Returns whether the filter used it. */
int rti_follow(rti *r, const double *before, const double *inputs, const double *seconds, int segments,
               const double *x) {
    flight_filter *f = &r->ocp.filter;
    const filter_options *o = &f->options;
    double disturbance[DISTURBANCE], p[NP], dt = 0, usual[AXES];
    double change[AXES], by_file[AXES], first[AXES], measured[AXES], beyond[AXES], adapted[AXES];
    memcpy(disturbance, r->ocp.disturbance, sizeof disturbance);
    memset(r->ocp.disturbance, 0, sizeof disturbance);
    memcpy(p, r->p, sizeof p);
    for (int s = 0; s < segments; s++) dt += seconds[s];
    for (int j = 0; j < o->count; j++) r->p[o->index[j]] = o->prior[j];
    change_over(r, before, inputs, seconds, segments, by_file);
    memcpy(change, by_file, sizeof change);
    rates_of(before, first);
    rates_of(x, measured);
    for (int i = 0; i < AXES; i++) beyond[i] = measured[i] - first[i] - by_file[i];
    if (o->count) {
        use_followed(r);
        change_over(r, before, inputs, seconds, segments, change);
    }
    for (int i = 0; i < AXES; i++) adapted[i] = measured[i] - first[i] - change[i];
    const bool used = filter_update(f, change, by_file, first, measured, dt);
    if (o->count && used) {
        if (fit_add(&r->fit, f, before, inputs, beyond, adapted, dt)) {
            fit_row *row = &r->fit.rows[(r->fit.added - 1) % FIT_ROWS];
            for (int j = 0; j < o->count; j++) r->p[o->index[j]] = o->prior[j];
            acceleration_at(r, row->state, row->inputs, usual);
            memcpy(row->usual, usual, sizeof row->usual);
            use_followed(r);
        }
        work_on_fit(r, x, inputs + (segments - 1) * NU);
    }
    memcpy(r->ocp.disturbance, disturbance, sizeof disturbance);
    memcpy(r->p, p, sizeof p);
    return used;
}

/* Begin a history of commands. hover: (NU) rad/s. left, mean: of the lag behind them, see thrust_history. */
void rti_begin_thrust(rti *r, const double *hover, double left, double mean) {
    memcpy(r->thrust.hover, hover, sizeof r->thrust.hover);
    r->thrust.left = left, r->thrust.mean = mean;
    history_clear(&r->thrust);
}

void rti_clear_thrust(rti *r) { history_clear(&r->thrust); }

/* Take a command, speeds (NU) that act from a time on. thrust: of all rotors as it left, N, by which the speeds are
 * scaled; NaN where it left as it was. */
void rti_add_thrust(rti *r, double time, const double *speed, double thrust) {
    double scaled[NU], commanded = 0, share = 1;
    for (int j = 0; j < NU; j++) commanded += r->ocp.options.thrust_constant[j] * speed[j] * speed[j];
    if (isfinite(thrust) && commanded > 0) share = sqrt(thrust / commanded);
    for (int j = 0; j < NU; j++) scaled[j] = share * speed[j];
    history_add(&r->thrust, time, scaled);
}

/* rti_follow by the commands whose thrust acted between the times of both states, s. */
int rti_follow_between(rti *r, const double *before, double start, double stop, const double *x) {
    double inputs[PAST * NU], seconds[PAST];
    const int segments = history_between(&r->thrust, start, stop, inputs, seconds);
    return rti_follow(r, before, inputs, seconds, segments, x);
}

#define SPEED_STEP 1e-4 /* of a rotor's speed, for derivatives by speeds */

/* The change of velocity and rate over dt seconds at constant speeds (NU), which a model with a lag has in its states
 * from `lagged` on; it is negative for a model without. */
static void change_at(rti *r, const double *before, const double *speeds, int lagged, double dt, double *change) {
    double from[NX];
    memcpy(from, before, sizeof from);
    if (lagged >= 0) memcpy(from + lagged, speeds, sizeof(double) * NU);
    change_over(r, from, speeds, &dt, 1, change);
}

/* Evidence of a state x about the rotors, dt seconds after the state before, with the speeds (NU) that they really had in
 * between: beyond (6), mean accelerations beyond the model and without the disturbance, and of each rotor the
 * accelerations (6) that its whole thrust and torque give, in rows of shares. lagged: see change_at. */
void rti_rotor_shares(rti *r, const double *before, const double *speeds, int lagged, double dt, const double *x,
                      double *beyond, double *shares) {
    double disturbance[DISTURBANCE], moved[NU], usual[AXES], first[AXES], last[AXES];
    memcpy(disturbance, r->ocp.disturbance, sizeof disturbance);
    memset(r->ocp.disturbance, 0, sizeof disturbance);
    memcpy(moved, speeds, sizeof moved);
    change_at(r, before, moved, lagged, dt, usual);
    rates_of(before, first);
    rates_of(x, last);
    for (int i = 0; i < AXES; i++) beyond[i] = (last[i] - first[i] - usual[i]) / dt;
    for (int j = 0; j < NU; j++) { /* thrust and torque are as the square of the speed */
        double *share = shares + j * AXES;
        moved[j] = speeds[j] * (1 + SPEED_STEP);
        change_at(r, before, moved, lagged, dt, share);
        moved[j] = speeds[j];
        for (int i = 0; i < AXES; i++) share[i] = (share[i] - usual[i]) / (2 * SPEED_STEP * dt);
    }
    memcpy(r->ocp.disturbance, disturbance, sizeof disturbance);
}

/* Body z in world axes. */
static void up_of(const double *x, double *up) {
    const double *q = x + ATTITUDE;
    up[0] = 2 * (q[1] * q[3] + q[0] * q[2]), up[1] = 2 * (q[2] * q[3] - q[0] * q[1]);
    up[2] = 1 - 2 * (q[1] * q[1] + q[2] * q[2]);
}

static double along(const double *linear, const double *up) {
    return linear[0] * up[0] + linear[1] * up[1] + linear[2] * up[2];
}

/* As rti_rotor_shares, and accumulate over dt seconds into sums (1 + NU, 3): acceleration along body z and angular ones
 * about body x and y, beyond the model, then of each rotor. force: specific force along body z, which errors of the estimate do
 * not reach, m/s^2; NaN without one. gravity: m/s^2. */
void rti_add_rotor_shares(rti *r, const double *before, const double *speeds, int lagged, double dt, const double *x,
                          double force, double gravity, double *beyond, double *shares, double *sums) {
    double up[3], rise[3];
    rti_rotor_shares(r, before, speeds, lagged, dt, x, beyond, shares);
    up_of(before, up);
    double z = along(beyond, up);
    for (int i = 0; i < 3; i++) rise[i] = (x[VELOCITY + i] - before[VELOCITY + i]) / dt;
    if (isfinite(force)) z += force - along(rise, up) - gravity * up[2];
    sums[0] += dt * z, sums[1] += dt * beyond[3], sums[2] += dt * beyond[4];
    for (int j = 0; j < NU; j++) {
        const double *share = shares + j * AXES;
        double *sum = sums + 3 * (j + 1);
        sum[0] += dt * along(share, up), sum[1] += dt * share[3], sum[2] += dt * share[4];
    }
}

/* Specific force along body z in a state x under the inputs (NU) without the disturbance and the thrust that holds a level
 * vehicle: the model's drag. gravity: m/s^2. */
double rti_specific_drag(rti *r, const double *x, const double *inputs, double gravity) {
    double disturbance[DISTURBANCE], acceleration[AXES], up[3];
    memcpy(disturbance, r->ocp.disturbance, sizeof disturbance);
    memset(r->ocp.disturbance, 0, sizeof disturbance);
    acceleration_at(r, x, inputs, acceleration);
    memcpy(r->ocp.disturbance, disturbance, sizeof disturbance);
    up_of(x, up);
    return along(acceleration, up) + gravity * up[2] - gravity;
}

/* Let predictions have what was estimated, as far as it is trusted. moments: share of the angular disturbance. */
void rti_fly(rti *r, double moments) {
    const flight_filter *f = &r->ocp.filter;
    const filter_options *o = &f->options;
    rti_fly_disturbance(&r->ocp, moments);
    for (int j = 0; j < o->count; j++)
        r->p[o->index[j]] = o->prior[j] + f->trust[0] * o->scale[j] * f->state[FOLLOWED + j];
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

/* Roll the model out along the inputs, with the Jacobians of every node; a node may take several RK4 steps. begun: of the
 * node's own steps, those that the time before it would take. */
static void linearise(rti *r) {
    double A[NX * NX], B[NX * NU], x[NX], before[NX * NX], kick[AXES];
    double dt = 0, begun = 0;
    for (int k = 0, substeps = 0; k < NODES; k++) {
        const double passed = begun + substeps, last = dt;
        substeps = substeps_of(r->ocp.options.interval[k]);
        dt = r->ocp.options.interval[k] / substeps, begun = passed * (last / dt);
        memcpy(x, r->ocp.x[k], sizeof x);
        half_kick(r, begun, dt, kick);
        push(x, kick);
        const double *arg[NODE_ARG] = {x, r->ocp.u[k], r->p, r->e, &dt};
        double *res[NODE_RES] = {r->ocp.x[k + 1], r->A[k], r->B[k]};
        NODE(arg, res, r->iw, r->w, 0);
        push(r->ocp.x[k + 1], kick);
        for (int s = 1; s < substeps; s++) {
            memcpy(x, r->ocp.x[k + 1], sizeof x);
            half_kick(r, begun + s, dt, kick);
            push(x, kick);
            const double *next_arg[NODE_ARG] = {x, r->ocp.u[k], r->p, r->e, &dt};
            double *next_res[NODE_RES] = {r->ocp.x[k + 1], A, B};
            NODE(next_arg, next_res, r->iw, r->w, 0);
            push(r->ocp.x[k + 1], kick);
            memcpy(before, r->A[k], sizeof(double) * NX * NX);
            compose(A, before, r->A[k], NX);
            memcpy(before, r->B[k], sizeof(double) * NX * NU);
            compose(A, before, r->B[k], NU);
            for (int i = 0; i < NX * NU; i++) r->B[k][i] += B[i];
        }
    }
}

/* out = M in (or M' in) over the first columns; M is NX x NX by column. */
static void multiply(const double *M, bool transposed, double in[NX][LD_S], double out[NX][LD_S], int columns) {
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
    const double scale = r->ocp.options.scale;
    for (int i = 0; i < NX; i++) r->ocp.S[0][i][i] = 1;
    for (int k = 0; k < NODES; k++) {
        multiply(r->A[k], false, r->ocp.S[k], r->ocp.S[k + 1], columns_of(k));
        for (int i = 0; i < NX; i++)
            for (int j = 0; j < NU; j++) r->ocp.S[k + 1][i][X0 + k * NU + j] = scale * r->B[k][j * NX + i];
    }
}

static void weigh(rti *r, int k, const double *weight, double W[NX][LD_S], bool add) {
    int columns = columns_of(k);
    for (int i = 0; i < NX; i++)
        for (int c = 0; c < columns; c += LANES_PER_VECTOR) {
            lanes term = r->ocp.share[k] * weight[i] * *(lanes *)&r->ocp.S[k][i][c];
            *(lanes *)&W[i][c] = add ? *(lanes *)&W[i][c] + term : term;
        }
}

/* Row block k of the Hessian, SCALE B_k' W_{k+1}, into both halves, and of its derivative by dx_0. */
static void hessian_rows(rti *r, int k, double W[NX][LD_S]) {
    const rti_options *options = &r->ocp.options;
    int columns = columns_of(k + 1);
    for (int j = 0; j < NU; j++) {
        double row[LD_S] __attribute__((aligned(64)));
        const double *b = &r->B[k][j * NX];
        for (int c = 0; c < columns; c += LANES_PER_VECTOR) {
            lanes sum = b[0] * *(lanes *)&W[0][c];
            for (int i = 1; i < NX; i++) sum += b[i] * *(lanes *)&W[i][c];
            *(lanes *)&row[c] = options->scale * sum;
        }
        int v = k * NU + j;
        memcpy(r->ocp.G[v], row, sizeof(double) * NX);
        for (int i = 0; i <= v; i++) r->ocp.H[v * NV + i] = r->ocp.H[i * NV + v] = row[X0 + i];
        r->ocp.H[v * NV + v] += r->ocp.share[k] * options->R[j] * options->scale * options->scale + options->levenberg_marquardt;
    }
}

static void gradient(rti *r) {
    double adjoint[NX], before[NX];
    for (int i = 0; i < NX; i++) adjoint[i] = r->ocp.options.P[i] * (r->ocp.x[NODES][i] - r->ocp.x_reference[NODES][i]);
    for (int k = NODES - 1; k >= 0; k--) {
        for (int j = 0; j < NU; j++) {
            double sum = r->ocp.share[k] * r->ocp.options.R[j] * (r->ocp.u[k][j] - r->ocp.u_reference[k][j]);
            for (int i = 0; i < NX; i++) sum += r->B[k][j * NX + i] * adjoint[i];
            r->ocp.g[k * NU + j] = r->ocp.options.scale * sum;
        }
        for (int i = 0; i < NX; i++) {
            before[i] = r->ocp.share[k] * r->ocp.options.Q[i] * (r->ocp.x[k][i] - r->ocp.x_reference[k][i]);
            for (int c = 0; c < NX; c++) before[i] += r->A[k][i * NX + c] * adjoint[c];
        }
        memcpy(adjoint, before, sizeof adjoint);
    }
}

static void condense(rti *r) {
    forward_sensitivities(r);
    weigh(r, NODES, r->ocp.options.P, r->W[NODES & 1], false);
    for (int k = NODES - 1; k >= 0; k--) {
        hessian_rows(r, k, r->W[(k + 1) & 1]);
        if (k == 0) break; /* W_0 would only give the cost of the current state */
        multiply(r->A[k], true, r->W[(k + 1) & 1], r->W[k & 1], columns_of(k));
        weigh(r, k, r->ocp.options.Q, r->W[k & 1], true);
    }
    gradient(r);
}

/* x: the state expected at the next tick. x_reference: N + 1 states. u_reference: N inputs. Returns 0; -1 when one of
 * them or of the present inputs is not finite, -2 when the prediction is not: rti_feedback then refuses. */
int rti_prepare(rti *r, const double *x, const double *x_reference, const double *u_reference) {
    double start = now();
    if (!condensed_begin(&r->ocp, x, x_reference, u_reference)) return -1;
    linearise(r);
    r->ocp.prepared = finite_all(r->ocp.x[NODES], NX);
    if (!r->ocp.prepared) return -2;
    double linearised = now();
    condense(r);
    condensed_finish(&r->ocp);
    double end = now();
    r->ocp.report.rollout_seconds = linearised - start;
    r->ocp.report.condense_seconds = end - linearised;
    r->ocp.report.prepare_seconds = end - start;
    return 0;
}

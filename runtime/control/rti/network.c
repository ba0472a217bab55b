/* Real-time iteration for a learned model with its whole history inside the horizon; derived in docs/kernel.md.
 *
 * The network takes columns of features, one every STEP_SECONDS, and gives mean accelerations until the next one. A
 * prediction is streamed: every layer keeps its own past columns, so that a new column costs one pass through each
 * layer instead of a whole window. Its exact derivatives by the inputs v_k and the initial state dx_0 are streamed the
 * same way, all at once: they lie along the vector registers and share the ReLUs' masks.
 *
 * network.h, generated from the model, has dimensions and weights; condensed.h what follows a preparation. */
#include "network.h"

/* NX, NU, NODES, STEPS, NP, NE, VECTOR_BYTES come from the build; FREE is 3 where nothing depends on position. */
typedef NETWORK_REAL real;
#define SENSITIVITY real
#define LEAD (FREE ? VECTOR_BYTES / (int)sizeof(real) : 0) /* first column of those that are streamed */
#define START (LEAD - FREE)
#define X0 (START + NX)
#include "condensed.h"
#include "kinematics.h"
#include "layers.h"

#define STREAMED (LD_S - LEAD) /* columns of tangents that are streamed: without those of a free position */
#define BY_INPUT (NX - FREE)   /* the first of them that belongs to an input */
#define COLUMNS (HISTORY + STEPS)
#define STATE_FEATURES (FEATURES - NU)
#define HIDDEN_STATES (NX - RIGID_BODY_STATES)
#define RATES (6 + HIDDEN_STATES)
#define LAST_PADDED (sizeof output_back[0] / sizeof(real))
#define CERTAINTY 2
#define COLUMN_ENTRIES (RIGID_BODY_STATES + NU) /* of a measured column: rigid body, then commanded rotor speeds */

#if RESIDUAL
#pragma GCC push_options
#pragma GCC optimize("O1")
#include "physics.c" /* PHYSICS(x, u, p, e) -> rates, their derivatives by x and by u; see export.physics */
#pragma GCC pop_options
#define PHYSICS_RATES RATES
#endif

/* Rows of the tangents of each streamed layer's input, for as many substeps as its taps reach back. */
#define RING_OF(l, inputs, outputs, taps, dilation) real ring_##l[(taps - 1) * dilation + 1][inputs][STREAMED];
#define HIDDEN_OF(l, inputs, outputs) real hidden_##l[STEPS][outputs];
/* Derivatives of the network's output by each swept layer's input, by column offset; and the part through each tap. */
#define BACK_OF(l, inputs, outputs, taps, above, below) \
    real back_##l[below][6 * (inputs)], part_##l[above][taps][6 * (inputs)];

typedef struct {
    condensed ocp;
    int node_of[STEPS], first_of[NODES + 1]; /* the node in which a substep is, and the first substep of a node */
    double history[HISTORY + 1][COLUMN_ENTRIES]; /* measured, oldest first; the row after them is not used */
    double p[NP + 1], e[NE + 1];
    double state[STEPS + 1][NX], input[STEPS][NU];
    double net_out[STEPS][6]; /* the network's output: force per mass (world or body axes), angular acceleration */
    double linear[STEPS][3];  /* mean acceleration, world axes */
    double angular[STEPS][3];
#if EXTRAPOLATED
    double before[RATES]; /* of the substep before: accelerations, then the hidden states' rates */
#endif
#if RESIDUAL
    double by_state[STEPS][PHYSICS_RATES * NX], by_input[STEPS][PHYSICS_RATES * NU]; /* by column */
    double physics_work[PHYSICS_W + 1];
    long long physics_integers[PHYSICS_IW + 1];
#endif
    struct {
        real column[LAYERS + 1][COLUMNS][WIDTH]; /* features, then each convolution's output */
        EACH_HIDDEN(HIDDEN_OF)
        EACH_STREAMED(RING_OF)
        real code[CODE_SPAN][CODE][STREAMED]; /* tangents of the last streamed layer's output */
        real perceptron[6 * LAST_CODE]; /* Jacobian of the perceptron */
        EACH_SWEPT(BACK_OF)
        real moving[NX][STREAMED]; /* tangents of the state */
        real net_out[6][STREAMED]; /* tangents of the network's output */
        real rates[6][STREAMED];   /* tangents of the accelerations, world and body axes */
#if RESIDUAL
        real physical[6][STREAMED]; /* the nominal or identified model's part of them */
#endif
        real other[HIDDEN_STATES + 1][STREAMED];
#if EXTRAPOLATED
        real rates_before[6][STREAMED], other_before[HIDDEN_STATES + 1][STREAMED];
#endif
        real S_weighed[NODES][NX][LD_S];
        real H[NV][STREAMED];
    } tangents __attribute__((aligned(64)));
    real by_own_input[MAX_TAPS][MAX_WIDTH][NU]; /* the first layer's weights of the inputs, per scaled input */
    struct {
        real weight[LAST][OUTPUTS], bias[OUTPUTS], back[6][LAST_PADDED];
    } output __attribute__((aligned(64))); /* the last layer as it is flown, see set_output */
    double certainty[CERTAINTY]; /* see rti_assess */
    double last_input[LAST], change[6][LAST + 1]; /* of the last layer, at the first substep; and what is added to it */
    active_set active[STREAMED_LAYERS + 1][COLUMNS]; /* of the features those that depend on the state */
    bool mask_changed[LAYERS + 1][COLUMNS]; /* whether a swept layer's mask differs from that of the column before */
} network;

/* ---- forward ---- */

static void write_features(network *r, int t, const double *x, const double *u) {
    double raw[FEATURES];
#if BODY_INPUTS
    double R[3][3];
    const double *velocity = x + VELOCITY;
    rotation(x + ATTITUDE, R);
    for (int i = 0; i < 3; i++) {
        raw[i] = R[0][i] * velocity[0] + R[1][i] * velocity[1] + R[2][i] * velocity[2];
        raw[3 + i] = -R[2][i]; /* gravity's direction */
        raw[6 + i] = x[RATE + i];
    }
#else
    for (int i = 0; i < 10; i++) raw[i] = x[VELOCITY + i];
#endif
    for (int i = 0; i < NU; i++) raw[STATE_FEATURES + i] = u[i];
    for (int i = 0; i < FEATURES; i++)
        r->tangents.column[0][t][i] = (real)((raw[i] - feature_mean[i]) * feature_gain[i]);
}

#define STREAM(l, inputs, outputs, taps, dilation) \
    convolve(inputs, outputs, taps, dilation, WIDTH, &convolution_##l[0][0][0], convolution_bias_##l, \
             r->tangents.column[l][t], r->tangents.column[l + 1][t]);
#define DENSE_FORWARD(l, inputs, outputs) \
    dense(inputs, outputs, 1, &perceptron_##l[0][0], perceptron_bias_##l, before, r->tangents.hidden_##l[s]), \
        before = r->tangents.hidden_##l[s];

/* The network's output at substep s, from column t, whose features are written. */
static void evaluate(network *r, int s, int t) {
    EACH_CONVOLUTION(STREAM)
    const real *before = r->tangents.column[LAYERS][t];
    EACH_HIDDEN(DENSE_FORWARD)
    real y[OUTPUTS] __attribute__((aligned(64)));
    for (int i = 0; i < LAST && s == 0; i++) r->last_input[i] = before[i];
    dense(LAST, OUTPUTS, 0, &r->output.weight[0][0], r->output.bias, before, y);
    for (int i = 0; i < 6; i++) r->net_out[s][i] = y[i];
}

/* Accelerations at substep s from the network's output at the state x, and the hidden states' rates into `hidden`. */
static void accelerate(network *r, int s, const double *x, const double *u, double *hidden) {
    const double *net_out = r->net_out[s];
    double R[3][3];
    if (BODY_OUTPUTS) rotation(x + ATTITUDE, R);
    for (int i = 0; i < 3; i++) {
        r->linear[s][i] = net_out[i];
        if (BODY_OUTPUTS) r->linear[s][i] = R[i][0] * net_out[0] + R[i][1] * net_out[1] + R[i][2] * net_out[2];
        r->angular[s][i] = net_out[3 + i];
    }
#if RESIDUAL
    double rates[PHYSICS_RATES];
    const double *arg[PHYSICS_ARG] = {x, u, r->p, r->e};
    double *res[PHYSICS_RES] = {rates, r->by_state[s], r->by_input[s]};
    PHYSICS(arg, res, r->physics_integers, r->physics_work, 0);
    for (int i = 0; i < 3; i++) r->linear[s][i] += rates[i], r->angular[s][i] += rates[3 + i];
    memcpy(hidden, rates + 6, sizeof(double) * HIDDEN_STATES);
#else
    (void)u, (void)hidden;
    if (BODY_OUTPUTS) r->linear[s][2] -= GRAVITY;
#endif
}

/* Instantaneous accelerations are extrapolated by half a step along their slope (Adams-Bashforth 2): their mean. */
static void extrapolate(network *r, int s, double h, double *hidden) {
#if EXTRAPOLATED
    double *parts[] = {r->linear[s], r->angular[s], hidden};
    const int sizes[] = {3, 3, HIDDEN_STATES};
    for (int part = 0, i = 0; part < 3; part++)
        for (int j = 0; j < sizes[part]; j++, i++) {
            const double now = parts[part][j];
            parts[part][j] += 0.5 * h / STEP_SECONDS * (now - r->before[i]);
            r->before[i] = now;
        }
#else
    (void)r, (void)s, (void)h, (void)hidden;
#endif
}

/* Add the disturbance's mean accelerations over a substep of h seconds. */
static void disturb(network *r, int s, double h) {
    double accelerations[AXES];
    disturbance_at(&r->ocp, s * STEP_SECONDS + 0.5 * h, accelerations);
    for (int i = 0; i < 3; i++) {
        r->linear[s][i] += accelerations[i];
        r->angular[s][i] += accelerations[3 + i];
    }
}

/* One substep of h seconds from r->state[s] to next: column, network, disturbance, motion. */
static void advance(network *r, int s, const double *u, double h, double *next) {
    double hidden[HIDDEN_STATES + 1];
    const double *x = r->state[s];
    write_features(r, HISTORY + s, x, u);
    evaluate(r, s, HISTORY + s);
    accelerate(r, s, x, u, hidden);
    extrapolate(r, s, h, hidden);
    disturb(r, s, h);
    move_body(x, r->linear[s], r->angular[s], h, next);
    for (int i = 0; i < HIDDEN_STATES; i++) next[RIGID_BODY_STATES + i] = x[RIGID_BODY_STATES + i] + h * hidden[i];
}

#define FILL(l, inputs, outputs, taps, dilation) \
    first += (taps - 1) * dilation; \
    for (int t = first; t < HISTORY; t++) { STREAM(l, inputs, outputs, taps, dilation) }

/* Evaluate every layer over the measured history: layer by layer, each from the first column that its taps reach. */
static void load_history(network *r) {
    int first = 0;
    for (int t = 0; t < HISTORY; t++) write_features(r, t, r->history[t], r->history[t] + RIGID_BODY_STATES);
    EACH_CONVOLUTION(FILL)
    (void)first;
}

/* Start a prediction: the history before it, its first state, and the accelerations at the history's newest column. */
static void begin(network *r, const double *x) {
    load_history(r);
    memcpy(r->state[0], x, sizeof r->state[0]);
#if EXTRAPOLATED
    double hidden[HIDDEN_STATES + 1], then[NX];
    const double *column = r->history[HISTORY - 1];
    const double *command = column + RIGID_BODY_STATES;
    memcpy(then, column, sizeof(double) * RIGID_BODY_STATES);
    /* hidden states are not measured: as they are now, then one step back */
    memcpy(then + RIGID_BODY_STATES, x + RIGID_BODY_STATES, sizeof(double) * HIDDEN_STATES);
    evaluate(r, 0, HISTORY - 1);
    accelerate(r, 0, then, command, hidden);
    for (int i = 0; i < HIDDEN_STATES; i++) then[RIGID_BODY_STATES + i] -= STEP_SECONDS * hidden[i];
    if (HIDDEN_STATES) accelerate(r, 0, then, command, hidden);
    memcpy(r->before, r->linear[0], sizeof r->linear[0]);
    memcpy(r->before + 3, r->angular[0], sizeof r->angular[0]);
    memcpy(r->before + 6, hidden, sizeof(double) * HIDDEN_STATES);
#endif
}

static void roll_out(network *r) {
    condensed *c = &r->ocp;
    begin(r, c->x[0]);
    for (int s = 0; s < STEPS; s++) advance(r, s, c->u[r->node_of[s]], STEP_SECONDS, r->state[s + 1]);
    for (int k = 1; k <= NODES; k++) memcpy(c->x[k], r->state[r->first_of[k]], sizeof c->x[k]);
}

#include "reverse_split.h"
#include "tangents.h"
#include "ensemble.h"

/* ---- the interface to the runtime ---- */

#define TAKE_INPUTS(l, inputs, outputs, taps, dilation) \
    for (int tap = 0; l == 0 && tap < taps; tap++) \
        for (int o = 0; o < outputs; o++) \
            for (int i = 0; i < NU; i++) { \
                const real *weight = &convolution_##l[0][0][0] + (tap * inputs + STATE_FEATURES + i) * outputs + o; \
                r->by_own_input[tap][o][i] = (real)(options->scale * feature_gain[STATE_FEATURES + i]) * *weight; \
            }

/* Which substeps each interval takes; false where they are not the STEPS of the build. */
static bool place_nodes(network *r) {
    int s = 0;
    for (int k = 0; k < NODES; k++) {
        const int end = s + (int)lround(r->ocp.options.interval[k] / STEP_SECONDS);
        if (end <= s || end > STEPS) return false;
        r->first_of[k] = s;
        for (; s < end; s++) r->node_of[s] = k;
    }
    r->first_of[NODES] = s;
    return s == STEPS;
}

/* Returns a null pointer for intervals that the build is not for. */
network *rti_create(const rti_options *options) {
    network *r = aligned_zeros(sizeof *r);
    condensed_create(&r->ocp, options);
    if (!place_nodes(r)) return free(r), NULL;
    for (int k = 0; k <= NODES; k++)
        for (int i = 0; i < FREE; i++) r->ocp.S[k][i][START + i] = 1; /* d position / d initial position */
    for (int i = 0; i < NX; i++) r->ocp.S[0][i][START + i] = 1;
    EACH_CONVOLUTION(TAKE_INPUTS)
    r->certainty[1] = 1;
    set_output(r);
    for (int t = 0; t < COLUMNS; t++) {
        r->active[0][t].count = STATE_FEATURES;
        for (int i = 0; i < STATE_FEATURES; i++) r->active[0][t].index[i] = (unsigned char)i;
    }
    return r;
}

double *rti_parameters(network *r) { return r->p; }
double *rti_environment(network *r) { return r->e; }
double *rti_history(network *r) { return &r->history[0][0]; }
double *rti_certainty(network *r) { return r->certainty; }
double *rti_last_input(network *r) { return r->last_input; }
double *rti_output_change(network *r) { return &r->change[0][0]; }
int rti_last_width(void) { return LAST; }

/* Let a trajectory that starts anew have all of the network, as it was trained. */
void rti_trust(network *r) {
    r->certainty[0] = NAN, r->certainty[1] = 1;
    memset(r->change, 0, sizeof r->change);
    set_output(r);
}

/* How certain the network is of the window that ends with x and u, for all predictions until the next call. */
void rti_assess(network *r, const double *x, const double *u) {
    for (int t = 0; t < HISTORY; t++) write_features(r, t, r->history[t], r->history[t] + RIGID_BODY_STATES);
    write_features(r, HISTORY, x, u);
    assess(r);
    set_output(r);
}

#ifdef COUNT_OPERATIONS
double rti_operations(void) { return operations; }
#endif

/* The model over dt seconds, at most STEPS substeps, from x with the history before it and inputs u. */
void rti_propagate(network *r, const double *x, const double *u, double dt, double *next) {
    begin(r, x);
    int s = 0;
    for (; dt > STEP_SECONDS * (1 + 1e-9) && s < STEPS - 1; s++, dt -= STEP_SECONDS)
        advance(r, s, u, STEP_SECONDS, r->state[s + 1]);
    advance(r, s, u, dt, r->state[s + 1]);
    memcpy(next, r->state[s + 1], sizeof r->state[0]);
}

/* Mean accelerations (6,) over the next column's time, world and body axes, for x and u after the history. */
void rti_accelerations(network *r, const double *x, const double *u, double *accelerations) {
    double hidden[HIDDEN_STATES + 1];
    load_history(r);
    write_features(r, HISTORY, x, u);
    evaluate(r, 0, HISTORY);
    accelerate(r, 0, x, u, hidden);
    memcpy(accelerations, r->linear[0], sizeof r->linear[0]);
    memcpy(accelerations + 3, r->angular[0], sizeof r->angular[0]);
}

/* As above, for `count` consecutive columns (COLUMN_ENTRIES each); the layers' memories advance by one column each. */
void rti_stream(network *r, const double *columns, int count, double *accelerations) {
    double hidden[HIDDEN_STATES + 1];
    load_history(r);
    for (int i = 0, s = 0; i < count; i++, s++) {
        const double *x = columns + i * COLUMN_ENTRIES, *command = x + RIGID_BODY_STATES;
        if (s == STEPS) {
            s = 0;
            for (int l = 0; l <= LAYERS; l++)
                memmove(r->tangents.column[l][0], r->tangents.column[l][STEPS], sizeof(real) * HISTORY * WIDTH);
        }
        double state[NX];
        memcpy(state, x, sizeof(double) * RIGID_BODY_STATES);
        for (int j = RIGID_BODY_STATES; j < NX; j++) state[j] = r->state[0][j];
        write_features(r, HISTORY + s, state, command);
        evaluate(r, s, HISTORY + s);
        accelerate(r, s, state, command, hidden);
        memcpy(accelerations + 6 * i, r->linear[s], sizeof r->linear[s]);
        memcpy(accelerations + 6 * i + 3, r->angular[s], sizeof r->angular[s]);
    }
}

/* x: the state expected at the next tick, right after the history. x_reference: N + 1 states. u_reference: N inputs.
 * Returns 0; -1 when one of them, the history or the present inputs is not finite, -2 when the prediction is not. */
int rti_prepare(network *r, const double *x, const double *x_reference, const double *u_reference) {
    double start = now();
    rti_report *report = &r->ocp.report;
    if (!condensed_begin(&r->ocp, x, x_reference, u_reference)) return -1;
    r->ocp.prepared = finite_all(&r->history[0][0], HISTORY * COLUMN_ENTRIES);
    if (!r->ocp.prepared) return -1;
    roll_out(r);
    r->ocp.prepared = finite_all(r->state[STEPS], NX);
    if (!r->ocp.prepared) return -2;
    double rolled_out = now();
    stream_tangents(r);
    double streamed = now();
    condense(r);
    condensed_finish(&r->ocp);
    double end = now();
    report->rollout_seconds = rolled_out - start;
    report->tangent_seconds = streamed - rolled_out;
    report->condense_seconds = end - streamed;
    report->prepare_seconds = end - start;
    return 0;
}

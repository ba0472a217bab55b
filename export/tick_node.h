/* A node of your own around alula_tick: the solver of this bundle's kernel, the commands so far, and the preparation of
 * the next tick, which follows once a setpoint has left. tick_example.c shows how.
 *
 * What Alula's own daemon does beside it is not here: take-off and landing, fallbacks, events, adaptation, recording. */
#ifndef ALULA_NODE_H
#define ALULA_NODE_H

#include <math.h>
#include <string.h>
#include <time.h>

#include "tick.h"
#include "tick_vehicle.h"

#define ALULA_HISTORY 64 /* commands that are stored for the delay compensation */

/* Of the kernel (kernel.so, or physics.so beside a network). */
void *rti_create(const void *options);
double *rti_parameters(void *solver), *rti_environment(void *solver), *rti_states(void *solver), *rti_inputs(void *solver);
void rti_propagate(void *solver, const double *state, const double *speeds, double seconds, double *next);
void rti_shift(void *solver, double seconds);
int rti_prepare(void *solver, const double *expected, const double *states, const double *speeds);
int rti_feedback(void *solver, const double *state);

/* reference: states that the next tick tracks, from when its command acts, a row at each of
 * alula_offsets, s; the caller's. */
typedef struct {
    alula_context context;
    alula_result result;
    double reference[ALULA_NODES + 1][ALULA_NX];
    double speeds[ALULA_NODES][ALULA_NU];
    double times[ALULA_HISTORY], inputs[ALULA_HISTORY][ALULA_NU], hidden[ALULA_HISTORY * (ALULA_NX - ALULA_STATE) + 1];
} alula_node;

static double alula_now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* Store a command that acts from a time on, with the hidden states then. */
static void alula_remember(alula_node *node, double time, const double *speeds, const double *hidden) {
    alula_plan *plan = &node->context.plan;
    const int slot = (int)(plan->commands++ % ALULA_HISTORY), count = ALULA_NX - ALULA_STATE;
    node->times[slot] = time;
    memcpy(node->inputs[slot], speeds, sizeof node->inputs[slot]);
    memcpy(node->hidden + slot * count, hidden, sizeof(double) * (size_t)count);
}

/* Set up a node for a vehicle, by its MAVLink ids. The caller sends the frames, until it sets context.link.socket. */
static void alula_open(alula_node *node, int system, int component) {
    alula_context *context = &node->context;
    void *solver = rti_create(alula_options);
    memset(node, 0, sizeof *node);
    memcpy(rti_parameters(solver), alula_parameters, sizeof alula_parameters);
    memcpy(rti_environment(solver), alula_environment, sizeof alula_environment);
    alula_solver *made = &context->solver;
    made->handle = solver, made->propagate = rti_propagate, made->feedback = rti_feedback;
    made->states = rti_states(solver), made->inputs = rti_inputs(solver);
    made->state_count = ALULA_NX, made->rotor_count = ALULA_NU;
    context->vehicle = alula_own_vehicle, context->limits = alula_own_limits, context->messages = alula_own_messages;
    context->link.system = context->link.own_system = system, context->link.component = component;
    context->link.own_component = 191, context->link.socket = -1; /* an on-board computer */
    alula_plan *plan = &context->plan;
    plan->command_times = node->times, plan->command_inputs = &node->inputs[0][0], plan->hidden_states = node->hidden;
    plan->history = ALULA_HISTORY, plan->tilt_rate = INFINITY, plan->effectiveness = 1;
    for (int k = 0; k < ALULA_NODES; k++) memcpy(node->speeds[k], alula_hover, sizeof alula_hover);
}

/* Linearise for the next tick. Returns 0, or a negative number where that failed. */
static int alula_prepare(alula_node *node) {
    alula_plan *plan = &node->context.plan;
    const alula_result *result = &node->result;
    void *solver = node->context.solver.handle;
    double *inputs = rti_inputs(solver), expected[ALULA_NX], error[3], distance = 0, sign = 0;
    static double reference[ALULA_NODES + 1][ALULA_NX];
    rti_propagate(solver, result->acting, inputs, ALULA_PERIOD, expected);
    rti_shift(solver, ALULA_PERIOD);
    memcpy(reference, node->reference, sizeof reference);
    for (int i = 0; i < 4; i++) sign += reference[0][6 + i] * expected[6 + i];
    for (int i = 0; i < 3; i++) error[i] = reference[0][i] - expected[i], distance += error[i] * error[i];
    distance = sqrt(distance); /* a linearisation does not reach farther than ALULA_MAX_ERROR */
    const double left = distance > ALULA_MAX_ERROR ? 1 - ALULA_MAX_ERROR / distance : 0;
    for (int k = 0; k <= ALULA_NODES; k++) {
        for (int i = 0; i < 3; i++) reference[k][i] -= left * error[i];
        for (int i = 6; i < 10 && sign < 0; i++) reference[k][i] = -reference[k][i];
    }
    plan->has_before = 1, plan->before_time = result->time;
    memcpy(plan->before_state, result->state, sizeof plan->before_state);
    memcpy(plan->correction, result->correction, sizeof plan->correction);
    plan->not_before = result->received + 0.5 * ALULA_PERIOD;
    return rti_prepare(solver, expected, &reference[0][0], &node->speeds[0][0]);
}

/* Begin with the first estimate: hover speeds. Returns ALULA_SENT, or why it is none to begin with. */
static int alula_start(alula_node *node, const uint8_t *datagram, int size, double received) {
    double *states = rti_states(node->context.solver.handle), *inputs = rti_inputs(node->context.solver.handle);
    const int reason = alula_begin(&node->context, datagram, size, received, &node->result);
    if (reason) return reason;
    memcpy(node->result.acting, node->result.state, sizeof node->result.state);
    memcpy(node->result.acting + ALULA_STATE, alula_hidden, sizeof(double) * (ALULA_NX - ALULA_STATE));
    for (int k = 0; k <= ALULA_NODES; k++) memcpy(states + k * ALULA_NX, node->result.acting, sizeof(double) * ALULA_NX);
    for (int k = 0; k < ALULA_NODES; k++) memcpy(inputs + k * ALULA_NU, alula_hover, sizeof alula_hover);
    alula_remember(node, received, alula_hover, alula_hidden);
    return ALULA_SENT;
}

/* Answer a datagram; where a setpoint has left the next tick is to be prepared. Returns as alula_tick. */
static int alula_step(alula_node *node, const uint8_t *datagram, int size, double received) {
    const double now = alula_now();
    const int reason = alula_tick(&node->context, datagram, size, received, now, &node->result);
    if (!reason)
        alula_remember(node, now + node->context.vehicle.delay, node->result.rotor_speed, node->result.acting + ALULA_STATE);
    return reason;
}

#endif

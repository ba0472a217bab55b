/* alula_tick: see tick.h. The same arithmetic in the same order as Python's path, bit for bit: compile it without
 * contraction and without fast mathematics. The path in Python: runtime/link/estimate.py (checks), consistent_velocity.py,
 * controller.py (compensate, feedback), flyer.py and setpoint_output.py (limits), thrust.py (curves). */
#define _GNU_SOURCE
#include "tick.h"

#include <math.h>
#include <sys/socket.h>
#include <time.h>

#include "state.h"
#include "wire.h"

#define TICKS_PER_SECOND 100000 /* of signing */
#define MIN_STEP 1e-6           /* s that are worth a propagation */
#define MIN_SLOPE_TIME 1e-3     /* s between two estimates */
#define LAG_STEP 0.05           /* s, at most, from a command to the estimate after it */

static double length_of(const double *v) { return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]); }

static double dot4(const double *a, const double *b) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3];
}

static double smaller(double a, double b) { return b < a ? b : a; }
static double greater(double a, double b) { return b > a ? b : a; }
static double limited(double value, double limit) { return smaller(greater(value, -limit), limit); }

/* A body vector in world axes. */
static void rotate(const double *q, const double *v, double *rotated) {
    const double w = q[0], x = q[1], y = q[2], z = q[3], a = v[0], b = v[1], c = v[2];
    const double s = 2 * (y * c - z * b), t = 2 * (z * a - x * c), u = 2 * (x * b - y * a);
    rotated[0] = a + w * s + y * u - z * t;
    rotated[1] = b + w * t + z * s - x * u;
    rotated[2] = c + w * u + x * t - y * s;
}

/* Whether an estimate moved farther than motion and noise explain. */
static bool has_jumped(const alula_limits *limits, const double *start, const double *end, double elapsed) {
    double position[3], velocity[3];
    const double half = 0.5 * elapsed;
    for (int i = 0; i < 3; i++) {
        position[i] = end[POSITION + i] - start[POSITION + i] - half * (start[VELOCITY + i] + end[VELOCITY + i]);
        velocity[i] = end[VELOCITY + i] - start[VELOCITY + i];
    }
    const double turned = 2.0 * acos(smaller(1.0, fabs(dot4(start + ATTITUDE, end + ATTITUDE))));
    return length_of(position) > limits->position_noise + 0.25 * limits->max_acceleration * (elapsed * elapsed) ||
           length_of(velocity) > limits->velocity_noise + limits->max_acceleration * elapsed ||
           turned > limits->attitude_noise + limits->max_rate * elapsed;
}

/* When the state of a stamp held, s; NAN where it is not of the vehicle's clock. */
static double time_of(const alula_context *context, double stamp, double received) {
    const alula_link *link = &context->link;
    if (!(received < link->clock_valid_until)) return NAN;
    const double time = link->clock_updated +
                        (stamp - link->clock_offset - link->clock_updated) / (1.0 + link->clock_drift);
    if (time - received > context->limits.max_stamp_ahead) return NAN;
    if (!(time - context->limits.max_stamp_ahead < received && received < time + context->limits.max_stamp_age))
        return NAN;
    return smaller(time, received);
}

/* The state of ODOMETRY's numbers, its velocity in world axes; false for axes that are not defined. */
static bool state_of(const alula_limits *limits, const odometry *read, double *state) {
    if (read->frame != LOCAL_NED || (read->child_frame != LOCAL_NED && read->child_frame != BODY_FRD)) return false;
    for (int i = 0; i < ALULA_STATE; i++)
        state[i] = limits->factor[i] * read->wire[limits->first[i]] + limits->other[i] * read->wire[limits->second[i]];
    if (read->child_frame == BODY_FRD) {
        const double body[3] = {read->wire[7], -read->wire[8], -read->wire[9]};
        double world[3];
        rotate(state + ATTITUDE, body, world);
        memcpy(state + VELOCITY, world, sizeof world);
    }
    return true;
}

/* Checks of an estimate's numbers by themselves; makes the attitude's length 1, and its sign that of the one before. */
static int check_numbers(const alula_limits *limits, const double *before, double *state) {
    double sum = 0;
    for (int i = 0; i < ALULA_STATE; i++) sum += state[i];
    const double length = sqrt(dot4(state + ATTITUDE, state + ATTITUDE));
    if (!isfinite(sum) || !(fabs(length - 1.0) < limits->attitude_length)) return ALULA_NOT_FINITE;
    if (length_of(state + POSITION) > limits->max_distance || length_of(state + VELOCITY) > limits->max_speed)
        return ALULA_OUT_OF_RANGE;
    double factor = 1.0 / length;
    if (dot4(state + ATTITUDE, before + ATTITUDE) < 0) factor = -factor;
    for (int i = 0; i < 4; i++) state[ATTITUDE + i] *= factor;
    return ALULA_SENT;
}

/* Checks of an estimate against the one before; moves its time where the clock's filter has gone back. */
static int check_against(const alula_context *context, const double *state, double stamp, int reset, double received,
                         double *time) {
    const alula_link *link = &context->link;
    if (received - link->latest_received > context->limits.forgotten_after) return ALULA_NOT_NEXT;
    const double age = link->latest_stamp - stamp;
    if (age >= 0) return ALULA_NOT_NEXT;
    if (*time <= link->latest_time) *time = smaller(link->latest_time - age, greater(received, link->latest_time));
    if (reset != link->latest_reset) return ALULA_RESET;
    const double elapsed = fabs(*time - link->latest_time);
    return has_jumped(&context->limits, link->latest_state, state, elapsed) ? ALULA_JUMP : ALULA_SENT;
}

int alula_read(const alula_context *context, const uint8_t *datagram, int size, double received,
               alula_result *result) {
    const uint8_t *frame;
    int length, reason;
    odometry read;
    if ((reason = find_estimate(context, datagram, size, &frame, &length))) return reason;
    if (context->link.is_signed) {
        if (!is_authentic(&context->link, frame, length)) return ALULA_SIGNATURE;
    }
    read_odometry(frame, &read);
    result->stamp = (double)read.microseconds * 1e-6;
    result->reset_counter = read.reset_counter;
    if (!context->link.has_latest) return ALULA_NOT_NEXT;
    result->time = time_of(context, result->stamp, received);
    if (isnan(result->time)) return ALULA_CLOCK;
    if (!state_of(&context->limits, &read, result->state)) return ALULA_AXES;
    if ((reason = check_numbers(&context->limits, context->link.latest_state, result->state))) return reason;
    return check_against(context, result->state, result->stamp, read.reset_counter, received, &result->time);
}

/* A vector no longer than a length. */
static void limit_length(double *vector, double length) {
    const double share = smaller(1.0, length / greater(length_of(vector), 1e-9));
    for (int i = 0; i < 3; i++) vector[i] *= share;
}

/* Make the velocity consistent with the slope of the position. */
static void correct_velocity(const alula_context *context, alula_result *result) {
    const alula_plan *plan = &context->plan;
    const alula_limits *limits = &context->limits;
    const double *before = plan->before_state, *state = result->state, elapsed = result->time - plan->before_time;
    double *correction = result->correction;
    memcpy(correction, plan->correction, sizeof plan->correction);
    if (plan->has_before && MIN_SLOPE_TIME < elapsed && elapsed < limits->max_gap) {
        const double share = smaller(elapsed / limits->mean_time, 1.0);
        double mismatch[3];
        for (int i = 0; i < 3; i++) {
            const double mean = 0.5 * (before[VELOCITY + i] + state[VELOCITY + i]);
            mismatch[i] = (state[POSITION + i] - before[POSITION + i]) / elapsed - mean;
        }
        limit_length(mismatch, limits->max_mismatch);
        for (int i = 0; i < 3; i++) correction[i] = correction[i] + share * (mismatch[i] - correction[i]);
        limit_length(correction, limits->max_correction);
    }
    memcpy(result->corrected, state, sizeof result->corrected);
    for (int i = 0; i < 3; i++) result->corrected[VELOCITY + i] += correction[i];
}

/* Propagate a state in place. */
static void propagate(const alula_context *context, double *state, const double *speeds, double seconds) {
    double next[ALULA_STATES];
    while (seconds > MIN_STEP) {
        const double step = smaller(seconds, context->vehicle.max_step);
        context->solver.propagate(context->solver.handle, state, speeds, step, next);
        memcpy(state, next, sizeof(double) * (size_t)context->solver.state_count);
        seconds = seconds - step;
    }
}

/* The whole state at the estimate, and when this tick's command acts, by the commands since. */
static void compensate(const alula_context *context, double now, alula_result *result) {
    const alula_plan *plan = &context->plan;
    const int rotors = context->solver.rotor_count, hidden = context->vehicle.hidden_count;
    const int64_t length = plan->history, oldest = plan->commands > length ? plan->commands - length : 0;
    int64_t tick = plan->commands - 1;
    double time = result->time, *state = result->acting;
#define TIME(k) plan->command_times[(k) % length]
#define SPEEDS(k) (plan->command_inputs + (k) % length * rotors)
    while (tick > oldest && TIME(tick) > time) tick--;
    memcpy(state, result->corrected, sizeof result->corrected);
    memcpy(state + ALULA_STATE, plan->hidden_states + tick % length * hidden, sizeof(double) * (size_t)hidden);
    if (hidden > 0) {
        propagate(context, state, SPEEDS(tick), smaller(time - TIME(tick), LAG_STEP));
        memcpy(state, result->corrected, sizeof result->corrected);
    }
    memcpy(result->measured, state, sizeof(double) * (size_t)context->solver.state_count);
    for (; tick < plan->commands - 1; tick++) {
        const double until = smaller(TIME(tick + 1), now);
        propagate(context, state, SPEEDS(tick), until - time);
        time = until;
    }
    propagate(context, state, SPEEDS(plan->commands - 1), now + context->vehicle.delay - time);
#undef TIME
#undef SPEEDS
}

/* The controller's body rates for its rotor speeds, some time along their slope. */
static void solved_rates(const alula_context *context, alula_result *result) {
    const alula_vehicle *vehicle = &context->vehicle;
    const int states = context->solver.state_count, rotors = context->solver.rotor_count;
    const double *now = context->solver.states, *next = now + states;
    if (!vehicle->leads_lag) {
        for (int i = 0; i < 3; i++)
            result->solved_rate[i] = now[RATE + i] + vehicle->lookahead[i] * (next[RATE + i] - now[RATE + i]);
        return;
    }
    double settled[ALULA_STATES], after[ALULA_STATES];
    const double step = smaller(vehicle->node, vehicle->max_step);
    memcpy(settled, now, sizeof(double) * (size_t)states);
    for (int lag = 0; lag < vehicle->lag_count; lag++)
        memcpy(settled + vehicle->lag_start[lag], result->rotor_speed, sizeof(double) * (size_t)rotors);
    context->solver.propagate(context->solver.handle, settled, result->rotor_speed, step, after);
    for (int i = 0; i < 3; i++)
        result->solved_rate[i] = now[RATE + i] + vehicle->lead[i] / step * (after[RATE + i] - now[RATE + i]);
}

/* The solver's answer; false for one that must not be sent. */
static bool solve(const alula_context *context, alula_result *result) {
    result->status = context->solver.feedback(context->solver.handle, result->acting);
    memcpy(result->rotor_speed, context->solver.inputs, sizeof(double) * (size_t)context->solver.rotor_count);
    solved_rates(context, result);
    double thrust = 0, sum;
    for (int i = 0; i < context->solver.rotor_count; i++)
        thrust += result->rotor_speed[i] * result->rotor_speed[i] * context->vehicle.thrust_constants[i];
    result->solved_thrust = thrust;
    sum = result->solved_rate[0] + result->solved_rate[1] + result->solved_rate[2] + thrust;
    return isfinite(sum) && (result->status == 0 || result->status == 1);
}

static double thrust_at(double signal, double factor) { return factor * signal * signal + (1.0 - factor) * signal; }

static double signal_for(double thrust, double factor) {
    if (factor < 1e-6) return thrust;
    const double linear = 1.0 - factor;
    return (-linear + sqrt(linear * linear + 4.0 * factor * greater(thrust, 0.0))) / (2.0 * factor);
}

/* Replace a setpoint that must not be the last one (last_setpoint.h). */
static void check_last(const alula_context *context, double now, alula_result *result) {
    const alula_plan *plan = &context->plan;
    const double *rate = result->rate, age = now - result->time + plan->transit;
    double setpoint[4] = {rate[0], rate[1], rate[2], result->collective_thrust}, harm[2];
    if (!context->solver.check(plan->last_setpoint, result->corrected, age, plan->thrust_now, setpoint, harm)) return;
    for (int i = 0; i < 3; i++) result->rate[i] = limited(setpoint[i], context->vehicle.rate_limit[i]);
    result->collective_thrust = smaller(greater(setpoint[3], 0.0), context->vehicle.thrust_limit);
}

/* The answer within the vehicle's limits, its thrust in the autopilot's 0..1. */
static void finish(const alula_context *context, double now, alula_result *result) {
    const alula_vehicle *vehicle = &context->vehicle;
    const alula_plan *plan = &context->plan;
    double rate[3], thrust = result->solved_thrust;
    memcpy(rate, result->solved_rate, sizeof rate);
    if (plan->tilt_rate < INFINITY)
        for (int i = 0; i < 2; i++) rate[i] = limited(rate[i], plan->tilt_rate);
    if (plan->hands_over) {
        const double part =
            smaller(greater((now - plan->hand_over_started) / plan->hand_over_duration, 0.0), 1.0);
        const double share = part * part * (3 - 2 * part);
        thrust = plan->hand_over_thrust + share * (thrust - plan->hand_over_thrust);
    }
    for (int i = 0; i < 3; i++) result->rate[i] = limited(rate[i], vehicle->rate_limit[i]);
    result->collective_thrust = smaller(greater(thrust, 0.0), vehicle->thrust_limit);
    if (plan->last_setpoint) check_last(context, now, result);
    const double available = vehicle->thrust_max * plan->effectiveness;
    const double share = smaller(greater(result->collective_thrust / available, 0.0), 1.0);
    result->thrust = thrust_at(signal_for(share, vehicle->vehicle_curve), vehicle->autopilot_curve);
}

static double clock_now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)((int64_t)t.tv_sec * 1000000000 + t.tv_nsec) / 1e9;
}

static double busy_now(void) {
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* Pack the setpoint, and send it where there is a socket. */
static void depart(alula_context *context, double now, alula_result *result) {
    alula_link *link = &context->link;
    result->timestamp = -1;
    if (link->is_signed) {
        const int64_t present = link->ticks_base + (int64_t)((now - link->ticks_origin) * TICKS_PER_SECOND);
        result->timestamp = present > link->last_timestamp ? present : link->last_timestamp + 1;
        link->last_timestamp = result->timestamp;
    }
    const uint8_t sequence = (uint8_t)__atomic_fetch_add(&context->sequence, 1, __ATOMIC_RELAXED);
    const double *rate = result->rate;
    result->frame_size = pack_setpoint(link, rate, result->thrust, now, sequence, result->timestamp, result->frame);
    result->is_taken = link->socket < 0 || send(link->socket, result->frame, (size_t)result->frame_size,
                                                MSG_DONTWAIT | MSG_NOSIGNAL) == result->frame_size;
}

static void take_estimate(const alula_context *context, alula_link *link, const uint8_t *datagram, int size,
                          const alula_result *result) {
    const uint8_t *frame;
    int length;
    link->latest_time = result->time, link->latest_received = result->received, link->latest_stamp = result->stamp;
    memcpy(link->latest_state, result->state, sizeof link->latest_state);
    if (link->is_signed && !find_estimate(context, datagram, size, &frame, &length))
        link->heard[frame[length - SIGNATURE]] = timestamp_of(frame, length);
}

int alula_begin(alula_context *context, const uint8_t *datagram, int size, double received,
                alula_result *result) {
    alula_link *link = &context->link;
    const uint8_t *frame;
    int length, reason;
    odometry read;
    if ((reason = find_estimate(context, datagram, size, &frame, &length))) return reason;
    if (link->is_signed && !is_authentic(link, frame, length)) return ALULA_SIGNATURE;
    read_odometry(frame, &read);
    if (!state_of(&context->limits, &read, result->state)) return ALULA_AXES;
    if ((reason = check_numbers(&context->limits, result->state, result->state))) return reason;
    result->stamp = (double)read.microseconds * 1e-6, result->received = result->time = received;
    memcpy(result->corrected, result->state, sizeof result->corrected);
    link->clock_updated = received, link->clock_offset = result->stamp - received, link->clock_drift = 0;
    link->clock_valid_until = INFINITY;
    link->has_latest = 1, link->latest_reset = result->reset_counter = read.reset_counter;
    take_estimate(context, link, datagram, size, result);
    return ALULA_SENT;
}

int alula_answer(alula_context *context, double now, alula_result *result) {
    const double busy = busy_now();
    const alula_plan *plan = &context->plan;
    result->now = now;
    if (result->received < plan->not_before) return ALULA_NOT_DUE;
    if (plan->has_before && !memcmp(result->state, plan->before_state, sizeof result->state)) return ALULA_FROZEN;
    if (!(now - result->received <= context->limits.stale) || !(now - result->time <= context->limits.oldest))
        return ALULA_STALE;
    correct_velocity(context, result);
    compensate(context, now, result);
    if (!solve(context, result)) return ALULA_SOLVER;
    finish(context, now, result);
    depart(context, clock_now(), result);
    result->departed = clock_now();
    result->busy = busy_now() - busy;
    return ALULA_SENT;
}

int alula_tick(alula_context *context, const uint8_t *datagram, int size, double received, double now,
               alula_result *result) {
    result->received = received;
    result->reason = alula_read(context, datagram, size, received, result);
    if (!result->reason) result->reason = alula_answer(context, now, result);
    if (!result->reason) take_estimate(context, &context->link, datagram, size, result);
    return result->reason;
}

/* Calls every function of a kernel in random order with usual, extreme and impossible numbers, under the sanitizers that
 * it is compiled with: a fault ends the program. Reads the problem's options, the filter's, parameters and a usual state
 * and inputs; takes a seed and how many calls to make; writes how many inputs that a feedback called solved were finite.
 *
 * KERNEL is the file of the kernel's source; LEARNED is 1 for a network's. */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

#include KERNEL

#if LEARNED
typedef network kernel;
#else
typedef rti kernel;
#endif

static uint64_t randomness;
static uint32_t below(uint32_t n) { /* xorshift64* */
    randomness ^= randomness >> 12, randomness ^= randomness << 25, randomness ^= randomness >> 27;
    return (uint32_t)((randomness * 2685821657736338717ull) >> 32) % n;
}
static double unit(void) { return below(1u << 30) / (double)(1u << 29) - 1; }

static const double EXTREMES[] = {0, -0.0, 1e-320, 1e-15, -1e-15, 1, -1, 1e3, -1e3, 1e9, -1e9, 1e154, -1e155, 1.7e308, -1.7e308,
                                  4294967296.0, -2147483649.0, NAN, INFINITY, -INFINITY};
static int wildness; /* of 100 values, how many are not near what is usual */
static double near(double value, double spread) {
    if ((int)below(100) < wildness) return EXTREMES[below(sizeof EXTREMES / sizeof *EXTREMES)];
    return value + spread * unit();
}

static rti_options options;
static filter_options followed;
static double parameters[NP], environment[NE], usual_state[NX], usual_inputs[NU];

static void pull(void *to, size_t bytes) {
    if (fread(to, 1, bytes, stdin) != bytes) exit(2);
}

static void a_state(double *x) {
    for (int i = 0; i < NX; i++) x[i] = near(usual_state[i], i < 13 ? 0.3 : 1);
}
static void some_inputs(double *u, int count) {
    for (int i = 0; i < count; i++) u[i] = near(usual_inputs[i % NU], 100);
}

static kernel *fresh(void) {
    kernel *r = rti_create(&options);
    condensed *c = (condensed *)r;
    *rti_filter_options(c) = followed;
    memcpy(rti_parameters(r), parameters, sizeof parameters);
    memcpy(rti_environment(r), environment, sizeof environment);
    rti_filter_clear(c);
    for (int k = 0; k <= NODES; k++) memcpy(rti_states(c) + k * NX, usual_state, sizeof usual_state);
    for (int k = 0; k < NODES * NU; k++) rti_inputs(c)[k] = usual_inputs[k % NU];
#if LEARNED
    for (int k = 0; k < HISTORY * COLUMN_ENTRIES; k++) {
        const int entry = k % COLUMN_ENTRIES;
        rti_history(r)[k] = entry < 13 ? usual_state[entry] : usual_inputs[entry - 13];
    }
    rti_trust(r);
#else
    rti_begin_thrust(r, usual_inputs, 0.5, 0.25);
#endif
    return r;
}

/* Functions that only one kind of kernel has. */
#if LEARNED
static void special(kernel *r) {
    double x[NX], u[NU], out[6 * 8], columns[8 * COLUMN_ENTRIES];
    a_state(x), some_inputs(u, NU);
    switch (below(5)) {
        case 0: rti_assess(r, x, u); break;
        case 1: rti_accelerations(r, x, u, out); break;
        case 2:
            for (int k = 0; k < 8 * COLUMN_ENTRIES; k++) columns[k] = near(k % COLUMN_ENTRIES < 13 ? 0.1 : usual_inputs[0], 1);
            rti_stream(r, columns, 1 + (int)below(8), out);
            break;
        case 3: rti_history(r)[below(HISTORY * COLUMN_ENTRIES)] = near(0, 1); break;
        default:
            for (int k = 0; k < 6 * (rti_last_width() + 1); k++) rti_output_change(r)[k] = near(0, 0.1);
    }
}
#else
static void special(kernel *r) {
    static double clock;
    double x[NX], before[NX], u[PAST * NU], seconds[PAST], beyond[AXES], shares[NU * AXES], sums[3 * (1 + NU)] = {0};
    const int segments = 1 + (int)below(PAST);
    a_state(x), a_state(before), some_inputs(u, PAST * NU);
    for (int s = 0; s < segments; s++) seconds[s] = near(0.01 / segments, 0);
    const int lagged = NX >= 13 + NU && below(2) ? NX - NU : -1;
    const double dt = near(0.01, 0.005);
    clock += near(0.01, 0.01);
    if (!isfinite(clock) || fabs(clock) > 1e6) clock = 0;
    switch (below(9)) {
        case 0: rti_follow(r, before, u, seconds, segments, x); break;
        case 1: rti_begin_thrust(r, u, near(0.5, 0.5), near(0.5, 0.5)); break;
        case 2: rti_clear_thrust(r); break;
        case 3: rti_add_thrust(r, near(clock, 0), u, below(2) ? NAN : near(3, 3)); break;
        case 4: rti_follow_between(r, before, clock - dt, clock, x); break;
        case 5: rti_rotor_shares(r, before, u, lagged, dt, x, beyond, shares); break;
        case 6: rti_add_rotor_shares(r, before, u, lagged, dt, x, near(9.8, 1), 9.81, beyond, shares, sums); break;
        case 7: rti_specific_drag(r, x, u, 9.81); break;
        default: rti_fly(r, near(1, 1));
    }
}
#endif

/* Returns whether a solution was called good and is none. */
static int one_call(kernel *r) {
    condensed *c = (condensed *)r;
    double x[NX], before[NX], u[NU], change[AXES], by_file[AXES];
    static double x_reference[(NODES + 1) * NX], u_reference[NODES * NU];
    a_state(x), a_state(before), some_inputs(u, NU);
    for (int i = 0; i < AXES; i++) change[i] = near(0, 0.1), by_file[i] = near(0, 0.1);
    switch (below(10)) {
        case 0:
        case 1:
        case 2:
            for (int k = 0; k < (NODES + 1) * NX; k++) x_reference[k] = usual_state[k % NX] + (k % NX < 3 ? 3 * unit() : 0);
            if (below(20) == 0) x_reference[below((NODES + 1) * NX)] = near(0, 1);
            some_inputs(u_reference, NODES * NU);
            rti_prepare(r, x, x_reference, u_reference);
            break;
        case 3:
        case 4:
            const int status = rti_feedback(c, x); /* 0 and 1: the step is in the inputs */
            if ((status == 0 || status == 1) && !(finite_all(rti_inputs(c), NV) && finite_all(c->z, X0 + NV))) return 1;
            break;
        case 5: rti_shift(c, 0.5 + 0.5 * unit()); break;
        case 6: rti_propagate(r, x, u, near(0.01, 0.01), before); break;
        case 7: rti_filter_compare(c, before, change, by_file, x, near(0.01, 0.005)); break;
        case 8:
            switch (below(6)) {
                case 0: rti_filter_clear(c); break;
                case 1: rti_filter_restart(c, x); break;
                case 2: rti_fly_disturbance(c, near(1, 1)); break;
                case 3: rti_parameters(r)[below(NP)] = near(parameters[below(NP)], 1); break;
                case 4: rti_disturbance(c)[below(DISTURBANCE)] = near(0, 1); break;
                default: rti_input_upper(c)[below(NU)] = usual_inputs[0] * (1 + unit()); /* the daemon's own */
            }
            break;
        default: special(r);
    }
    return 0;
}

int main(int count, char **words) {
    if (count != 3) return 2;
    randomness = 88172645463325252ull ^ (strtoull(words[1], NULL, 10) * 2654435761ull);
    const int calls = atoi(words[2]);
    pull(&options, sizeof options), pull(&followed, sizeof followed);
    pull(parameters, sizeof parameters), pull(environment, sizeof environment);
    pull(usual_state, sizeof usual_state), pull(usual_inputs, sizeof usual_inputs);
    kernel *r = fresh();
    for (int call = 0; call < calls; call++) {
        if (call % 40 == 0) { /* what is not finite stays in a filter until it is cleared */
            rti_free((condensed *)r);
            r = fresh();
            wildness = (int[]){0, 0, 1, 5, 50}[below(5)];
        }
        if (one_call(r)) {
            fprintf(stderr, "call %d: solved, and the inputs are not finite\n", call);
            rti_free((condensed *)r);
            return 4;
        }
    }
    rti_free((condensed *)r);
    printf("%d calls\n", calls);
    return 0;
}

/* Rotor speeds whose thrust acted in the past: commands behind the lag that the model itself does not predict, each in
 * the mean of its period. */
#ifndef ALULA_THRUST_HISTORY_H
#define ALULA_THRUST_HISTORY_H

#include <math.h>
#include <string.h>

#define PAST 64 /* commands that are remembered */

typedef struct {
    double hover[NU], response[NU]; /* rad/s; the latter behind the lag, at the end of the last command's period */
    double left, mean;              /* of a step of the response: after a period, and in its mean */
    double times[PAST], speeds[PAST][NU];
    int count;
} thrust_history;

/* Forget all commands; thrust is that of hover. */
static void history_clear(thrust_history *t) {
    memcpy(t->response, t->hover, sizeof t->response);
    for (int k = 0; k < PAST; k++) {
        t->times[k] = -INFINITY;
        memcpy(t->speeds[k], t->hover, sizeof t->hover);
    }
    t->count = 0;
}

/* Let thrust follow speeds (NU) that act from a time on, for a period. */
static void history_add(thrust_history *t, double time, const double *speed) {
    const int slot = t->count++ % PAST;
    t->times[slot] = time;
    for (int j = 0; j < NU; j++) {
        const double step = t->response[j] - speed[j];
        t->speeds[slot][j] = speed[j] + t->mean * step;
        t->response[j] = speed[j] + t->left * step;
    }
}

/* Speeds (k, NU) whose thrust acted between two times, and for how many seconds (k) each did. Returns k, at most PAST. */
static int history_between(const thrust_history *t, double start, double stop, double *speeds, double *seconds) {
    const int oldest = t->count > PAST ? t->count - PAST : 0;
    int last = t->count - 1, k = 0;
    while (last > oldest && t->times[last % PAST] >= stop) last--;
    int tick = last;
    while (tick > oldest && t->times[tick % PAST] > start) tick--;
    for (double before = start; tick <= last; tick++, k++) {
        const double after = tick < last ? t->times[(tick + 1) % PAST] : stop;
        memcpy(speeds + k * NU, t->speeds[(tick + PAST) % PAST], sizeof t->hover);
        seconds[k] = after - before;
        before = after;
    }
    return k;
}

#endif

/* What the model misses in flight: a Kalman filter of a disturbance and of chosen parameters, on velocities and rates;
 * derived in docs/adaptation.md.
 *
 * State: velocity (world) and rate (body); the part of the disturbance that stays, then the one that fades (linear
 * acceleration, world axes, and angular, body axes, each); the parameters, as deviations from their prior in units of
 * its standard deviation. */
#ifndef ALULA_FLIGHT_FILTER_H
#define ALULA_FLIGHT_FILTER_H

#include <math.h>
#include <string.h>

#define AXES 6
#define STAYING AXES
#define FADING (2 * AXES)
#define FOLLOWED (3 * AXES) /* where the parameters begin */
#define MAX_FOLLOWED 16
#define MAX_FILTERED (FOLLOWED + MAX_FOLLOWED)
#define GUARD_STEPS 64

typedef struct {
    double measurement[AXES], drift[AXES], fading[AXES], fading_time[AXES], limit[AXES], start[AXES];
    double gate, parameter_drift, window, variation, drag_deviations;
    double leaving_time; /* s in which the staying part leaves to the wind, where that is followed */
    double forecast, averaging, tolerance, resolution[2]; /* of the guard */
    double prior[MAX_FOLLOWED], scale[MAX_FOLLOWED], lower[MAX_FOLLOWED], upper[MAX_FOLLOWED];
    int count;                /* of the parameters */
    int index[MAX_FOLLOWED];  /* of each in the kernel's */
    int group[MAX_FOLLOWED];  /* 1 a drag, 2 the air, 0 another */
} filter_options;

/* What happened between two estimates, for the guard. */
typedef struct {
    double seconds, staying[AXES], fading[AXES]; /* the disturbance as it was at the first */
    double beyond[AXES], beyond_file[AXES];      /* what velocity and rate changed by beyond both models */
} filter_step;

typedef struct {
    filter_options options;
    double state[MAX_FILTERED], P[MAX_FILTERED][MAX_FILTERED];
    double mean_slope[MAX_FOLLOWED][AXES], variation[MAX_FOLLOWED];
    int followed[MAX_FOLLOWED]; /* whether the data can show it now */
    filter_step steps[GUARD_STEPS];
    int step_count;
    double square[2][2]; /* of linear and angular forecasts: mean square errors of the adapted and of the file's model */
    double trust[2];     /* share with which what was estimated is flown, linear (and parameters) and angular */
} flight_filter;

static double filter_value(const flight_filter *f, int j) {
    return f->options.prior[j] + f->options.scale[j] * f->state[FOLLOWED + j];
}

/* Forget everything. */
static void filter_clear(flight_filter *f) {
    const filter_options *o = &f->options;
    memset(f->state, 0, sizeof f->state);
    memset(f->P, 0, sizeof f->P);
    memset(f->mean_slope, 0, sizeof f->mean_slope);
    memset(f->variation, 0, sizeof f->variation);
    for (int i = 0; i < AXES; i++) {
        f->P[i][i] = o->measurement[i] * o->measurement[i];
        f->P[STAYING + i][STAYING + i] = o->start[i] * o->start[i];
        f->P[FADING + i][FADING + i] = o->fading[i] * o->fading[i];
    }
    for (int j = 0; j < o->count; j++) f->P[FOLLOWED + j][FOLLOWED + j] = 1;
    f->step_count = 0;
    memset(f->square, 0, sizeof f->square);
    f->trust[0] = f->trust[1] = 1;
}

/* Go on from measured velocity and rate, as after a gap or a jump. */
static void filter_restart(flight_filter *f, const double *measured) {
    memcpy(f->state, measured, sizeof(double) * AXES);
    for (int i = 0; i < AXES; i++) {
        for (int j = 0; j < MAX_FILTERED; j++) f->P[i][j] = f->P[j][i] = 0;
        f->P[i][i] = f->options.measurement[i] * f->options.measurement[i];
    }
    f->step_count = 0;
}

/* Which parameters the data can show now: a drag where its slope varies, since the constant part of it depends on the
 * wind; the wind beside a drag that shows or is certain; any other always. */
static void filter_choose(flight_filter *f, double slopes[][AXES], double dt) {
    const filter_options *o = &f->options;
    const double share = fmin(dt / o->window, 1);
    bool drag_shows = false;
    for (int j = 0; j < o->count; j++) {
        double square = 0;
        for (int i = 0; i < AXES; i++) {
            const double away = slopes[j][i] / dt - f->mean_slope[j][i];
            f->mean_slope[j][i] += share * away;
            if (i < 3) square += away * away;
        }
        f->variation[j] += share * (square - f->variation[j]);
        const double deviation = o->scale[j] * sqrt(f->P[FOLLOWED + j][FOLLOWED + j]);
        drag_shows |= o->group[j] == 1 && (f->variation[j] > o->variation * o->variation ||
                                           fabs(filter_value(f, j)) > o->drag_deviations * deviation);
    }
    for (int j = 0; j < o->count; j++)
        f->followed[j] = o->group[j] == 0 || (o->group[j] == 1 ? f->variation[j] > o->variation * o->variation
                                                                : drag_shows);
}

/* change: of velocity and rate over dt seconds by the model alone. slopes: its derivatives by the parameters' states. */
static void filter_predict(flight_filter *f, const double *change, double slopes[][AXES], double dt) {
    const filter_options *o = &f->options;
    const int n = FOLLOWED + o->count;
    double left[AXES], stays[AXES];
    bool wind = false;
    for (int j = 0; j < o->count; j++) wind |= o->group[j] == 2 && f->followed[j];
    for (int i = 0; i < AXES; i++) stays[i] = wind && i < 3 ? exp(-dt / o->leaving_time) : 1;
    for (int i = 0; i < AXES; i++) {
        left[i] = exp(-dt / o->fading_time[i]);
        f->state[i] += change[i] + dt * (f->state[STAYING + i] + f->state[FADING + i]);
        f->state[FADING + i] *= left[i];
        f->state[STAYING + i] *= stays[i];
        for (int c = 0; c < n; c++) { /* F P: rows of velocity and rate, then of what fades */
            double sum = dt * (f->P[STAYING + i][c] + f->P[FADING + i][c]);
            for (int j = 0; j < o->count; j++) sum += slopes[j][i] * f->P[FOLLOWED + j][c];
            f->P[i][c] += sum;
            f->P[FADING + i][c] *= left[i];
            f->P[STAYING + i][c] *= stays[i];
        }
    }
    for (int r = 0; r < n; r++) /* (F P) F' */
        for (int i = 0; i < AXES; i++) {
            double sum = dt * (f->P[r][STAYING + i] + f->P[r][FADING + i]);
            for (int j = 0; j < o->count; j++) sum += slopes[j][i] * f->P[r][FOLLOWED + j];
            f->P[r][i] += sum;
            f->P[r][FADING + i] *= left[i];
            f->P[r][STAYING + i] *= stays[i];
        }
    for (int i = 0; i < AXES; i++) {
        f->P[STAYING + i][STAYING + i] += dt * o->drift[i] * o->drift[i];
        f->P[FADING + i][FADING + i] += (1 - left[i] * left[i]) * o->fading[i] * o->fading[i];
    }
    for (int j = 0; j < o->count; j++) f->P[FOLLOWED + j][FOLLOWED + j] += dt * o->parameter_drift * o->parameter_drift;
}

/* Measured velocity and rate, one after the other. Parameters that are not followed are Schmidt's consider states: they
 * do not move, and their uncertainty counts. Returns whether the measurement was used; one that jumped is not. */
static bool filter_take(flight_filter *f, const double *measured) {
    const filter_options *o = &f->options;
    const int n = FOLLOWED + o->count;
    double row[MAX_FILTERED], gain[MAX_FILTERED];
    for (int i = 0; i < AXES; i++) {
        const double away = measured[i] - f->state[i], noise = o->measurement[i] * o->measurement[i];
        if (!(away * away <= o->gate * o->gate * (f->P[i][i] + noise))) return false;
    }
    for (int i = 0; i < AXES; i++) {
        const double variance = f->P[i][i] + o->measurement[i] * o->measurement[i];
        const double innovation = measured[i] - f->state[i];
        for (int c = 0; c < n; c++) row[c] = f->P[i][c], gain[c] = row[c] / variance;
        for (int r = 0; r < n; r++) {
            const bool held = r >= FOLLOWED && !f->followed[r - FOLLOWED];
            if (!held) f->state[r] += gain[r] * innovation;
            for (int c = 0; c < n; c++)
                if (!held || c < FOLLOWED || f->followed[c - FOLLOWED]) f->P[r][c] -= gain[r] * row[c];
        }
    }
    for (int r = 0; r < n; r++)
        for (int c = 0; c < r; c++) f->P[r][c] = f->P[c][r] = 0.5 * (f->P[r][c] + f->P[c][r]);
    for (int j = 0; j < o->count; j++) {
        const double lowest = (o->lower[j] - o->prior[j]) / o->scale[j];
        const double highest = (o->upper[j] - o->prior[j]) / o->scale[j];
        f->state[FOLLOWED + j] = fmin(fmax(f->state[FOLLOWED + j], lowest), highest);
    }
    for (int i = 0; i < AXES; i++) {
        double *staying = &f->state[STAYING + i], *fading = &f->state[FADING + i];
        const double sum = fmin(fmax(*staying + *fading, -o->limit[i]), o->limit[i]);
        *staying = fmin(fmax(*staying, -o->limit[i]), o->limit[i]);
        *fading = sum - *staying;
    }
    return true;
}

/* Compare what the adapted and the file's model have forecast: velocity and rate `forecast` seconds later. Where the
 * adapted one has been worse over the last `averaging` seconds, what was estimated fades from the flight, and returns. */
static void guard(flight_filter *f, const double *change, const double *change_by_file, const double *measured,
                  const double *before, double dt) {
    const filter_options *o = &f->options;
    filter_step *now = &f->steps[f->step_count % GUARD_STEPS];
    now->seconds = dt;
    for (int i = 0; i < AXES; i++) {
        now->staying[i] = f->state[STAYING + i], now->fading[i] = f->state[FADING + i];
        now->beyond[i] = measured[i] - before[i] - change[i];
        now->beyond_file[i] = measured[i] - before[i] - change_by_file[i];
    }
    f->step_count++;
    double seconds = 0, beyond[AXES] = {0}, beyond_file[AXES] = {0};
    const filter_step *first = now;
    for (int back = 1; back <= GUARD_STEPS && back <= f->step_count && seconds < o->forecast - 0.5 * dt; back++) {
        first = &f->steps[(f->step_count - back) % GUARD_STEPS];
        seconds += first->seconds;
        for (int i = 0; i < AXES; i++) beyond[i] += first->beyond[i], beyond_file[i] += first->beyond_file[i];
    }
    if (seconds < o->forecast - 0.5 * dt) return;
    double square[2][2] = {{0}};
    for (int i = 0; i < AXES; i++) {
        const double fade = o->fading_time[i] * (1 - exp(-seconds / o->fading_time[i]));
        const double error = beyond[i] - first->staying[i] * seconds - first->fading[i] * fade;
        square[i / 3][0] += error * error;
        square[i / 3][1] += beyond_file[i] * beyond_file[i];
    }
    const double share = fmin(dt / o->averaging, 1);
    for (int kind = 0; kind < 2; kind++) {
        for (int model = 0; model < 2; model++)
            f->square[kind][model] += share * (square[kind][model] - f->square[kind][model]);
        const double room = o->resolution[kind] * o->resolution[kind];
        const bool worse = f->square[kind][0] > o->tolerance * o->tolerance * f->square[kind][1] + room;
        f->trust[kind] = fmin(fmax(f->trust[kind] + (worse ? -1 : 1) * dt / o->averaging, 0), 1);
    }
}

/* A measurement dt seconds after the last, before. change: by the model with the parameters as the filter has them, and
 * by the file's. Returns whether it was used; if not, the filter goes on from it. */
static bool filter_update(flight_filter *f, const double *change, const double *change_by_file, double slopes[][AXES],
                          const double *before, const double *measured, double dt) {
    double sum = 0; /* not finite where one of these is not */
    for (int i = 0; i < AXES; i++) sum += change[i] + change_by_file[i] + measured[i];
    for (int j = 0; j < f->options.count; j++)
        for (int i = 0; i < AXES; i++) sum += slopes[j][i];
    if (!isfinite(sum)) {
        filter_restart(f, measured);
        return false;
    }
    guard(f, change, change_by_file, measured, before, dt);
    filter_choose(f, slopes, dt);
    filter_predict(f, change, slopes, dt);
    const bool used = filter_take(f, measured);
    if (!used) filter_restart(f, measured);
    return used;
}

#endif

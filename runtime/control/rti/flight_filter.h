/* Disturbance beyond the model in flight: a Kalman filter of a disturbance, on velocities and rates; derived in
 * docs/adaptation.md.
 *
 * State: velocity (world) and rate (body); the part of the disturbance that stays, then the one that fades (linear
 * acceleration, world axes, and angular, body axes, each). Behind it the parameters that are followed, as deviations
 * from their prior in units of its standard deviation, which parameter_fit.h moves. */
#ifndef ALULA_FLIGHT_FILTER_H
#define ALULA_FLIGHT_FILTER_H

#include <math.h>
#include <string.h>

#define AXES 6
#define STAYING AXES
#define FADING (2 * AXES)
#define FOLLOWED (3 * AXES) /* where the parameters begin, and size of the filter */
#define MAX_FOLLOWED 16
#define GUARD_STEPS 64
#define LEVEL_MARGIN 2 /* of the level over what forecasts left: what begins to push is followed before they show it */

typedef struct {
    double measurement[AXES], drift[AXES], fading[AXES], fading_time[AXES], limit[AXES], start[AXES];
    double gate;
    double walk;                  /* of an estimate's velocity error, m/s per sqrt(s) */
    double calm, rising, falling; /* of the level: its least value, and the s in which it follows up and down */
    double persistence; /* s in which a disturbance that stays within its noise is flown after all */
    double variation, drag_deviations, offset; /* of the fit of parameters; offset: m/s^2, beside the wind */
    double forecast, averaging, tolerance, resolution[2]; /* of the guard */
    double known_drag; /* standard deviation, as a share of it, of a drag that the model has beside these, 0 for none */
    double prior[MAX_FOLLOWED], scale[MAX_FOLLOWED], lower[MAX_FOLLOWED], upper[MAX_FOLLOWED];
    int count;                /* of the parameters */
    int index[MAX_FOLLOWED];  /* of each in the kernel's */
    int group[MAX_FOLLOWED];  /* 1 a drag, 2 the air, 3 thrust, 0 another */
} filter_options;

/* Motion between two estimates, for the guard. */
typedef struct {
    double seconds, staying[AXES], fading[AXES]; /* the disturbance as it was at the first */
    double beyond[AXES], beyond_file[AXES];      /* what velocity and rate changed by beyond both models */
} filter_step;

typedef struct {
    filter_options options;
    double state[FOLLOWED + MAX_FOLLOWED], P[FOLLOWED][FOLLOWED];
    double deviation[MAX_FOLLOWED]; /* standard deviation of each parameter's state */
    int followed[MAX_FOLLOWED];     /* whether the data can show it now */
    int restarts, clears;           /* how often */
    double kept[3]; /* of the linear disturbance: what is flown although it may be noise, m/s^2 */
    double level, unexplained; /* of the noise that drives the linear disturbance; mean square that it follows, m^2/s^2 */
    filter_step steps[GUARD_STEPS];
    int step_count;
    double square[2][2]; /* of linear and angular forecasts: mean square errors of the adapted and of the file's model */
    double trust[2];     /* share with which what was estimated is flown, linear (and parameters) and angular */
} flight_filter;

/* Forget everything. */
static void filter_clear(flight_filter *f) {
    const filter_options *o = &f->options;
    memset(f->state, 0, sizeof f->state);
    memset(f->P, 0, sizeof f->P);
    memset(f->kept, 0, sizeof f->kept);
    for (int i = 0; i < AXES; i++) {
        f->P[i][i] = o->measurement[i] * o->measurement[i];
        f->P[STAYING + i][STAYING + i] = o->start[i] * o->start[i];
        f->P[FADING + i][FADING + i] = o->fading[i] * o->fading[i];
    }
    for (int j = 0; j < MAX_FOLLOWED; j++) f->deviation[j] = 1, f->followed[j] = 0;
    f->step_count = 0, f->clears++;
    memset(f->square, 0, sizeof f->square);
    f->trust[0] = f->trust[1] = 1;
    f->level = 1;
    f->unexplained = pow(o->forecast * o->fading[0] / LEVEL_MARGIN, 2);
}

/* Go on from measured velocity and rate, as after a gap or a jump. */
static void filter_restart(flight_filter *f, const double *measured) {
    memcpy(f->state, measured, sizeof(double) * AXES);
    for (int i = 0; i < AXES; i++) {
        for (int j = 0; j < FOLLOWED; j++) f->P[i][j] = f->P[j][i] = 0;
        f->P[i][i] = f->options.measurement[i] * f->options.measurement[i];
    }
    f->step_count = 0, f->restarts++;
}

/* Let the noise that drives the linear disturbance have another level; where it rises, what fades is less certain. */
static void filter_set_level(flight_filter *f, double level) {
    const double rise = level * level - f->level * f->level;
    for (int i = 0; i < 3 && rise > 0; i++)
        f->P[FADING + i][FADING + i] += rise * f->options.fading[i] * f->options.fading[i];
    f->level = level;
}

/* change: of velocity and rate over dt seconds by the model alone. */
static void filter_predict(flight_filter *f, const double *change, double dt) {
    const filter_options *o = &f->options;
    double left[AXES];
    for (int i = 0; i < AXES; i++) {
        left[i] = exp(-dt / o->fading_time[i]);
        f->state[i] += change[i] + dt * (f->state[STAYING + i] + f->state[FADING + i]);
        f->state[FADING + i] *= left[i];
        for (int c = 0; c < FOLLOWED; c++) { /* F P: rows of velocity and rate, then of what fades */
            f->P[i][c] += dt * (f->P[STAYING + i][c] + f->P[FADING + i][c]);
            f->P[FADING + i][c] *= left[i];
        }
    }
    for (int r = 0; r < FOLLOWED; r++) /* (F P) F' */
        for (int i = 0; i < AXES; i++) {
            f->P[r][i] += dt * (f->P[r][STAYING + i] + f->P[r][FADING + i]);
            f->P[r][FADING + i] *= left[i];
        }
    for (int i = 0; i < AXES; i++) {
        const double level = i < 3 ? f->level * f->level : 1, walk = i < 3 ? o->walk : 0;
        f->P[i][i] += dt * walk * walk;
        f->P[STAYING + i][STAYING + i] += level * dt * o->drift[i] * o->drift[i];
        f->P[FADING + i][FADING + i] += level * (1 - left[i] * left[i]) * o->fading[i] * o->fading[i];
    }
}

/* Measured velocity and rate, one after the other. Returns whether they were used; those that jumped are not. */
static bool filter_take(flight_filter *f, const double *measured) {
    const filter_options *o = &f->options;
    double row[FOLLOWED], gain[FOLLOWED];
    for (int i = 0; i < AXES; i++) {
        const double away = measured[i] - f->state[i], noise = o->measurement[i] * o->measurement[i];
        if (!(away * away <= o->gate * o->gate * (f->P[i][i] + noise))) return false;
    }
    for (int i = 0; i < AXES; i++) {
        const double variance = f->P[i][i] + o->measurement[i] * o->measurement[i];
        const double innovation = measured[i] - f->state[i];
        for (int c = 0; c < FOLLOWED; c++) row[c] = f->P[i][c], gain[c] = row[c] / variance;
        for (int r = 0; r < FOLLOWED; r++) {
            f->state[r] += gain[r] * innovation;
            for (int c = 0; c < FOLLOWED; c++) f->P[r][c] -= gain[r] * row[c];
        }
    }
    for (int r = 0; r < FOLLOWED; r++)
        for (int c = 0; c < r; c++) f->P[r][c] = f->P[c][r] = 0.5 * (f->P[r][c] + f->P[c][r]);
    for (int i = 0; i < AXES; i++) {
        double *staying = &f->state[STAYING + i], *fading = &f->state[FADING + i];
        const double sum = fmin(fmax(*staying + *fading, -o->limit[i]), o->limit[i]);
        *staying = fmin(fmax(*staying, -o->limit[i]), o->limit[i]);
        *fading = sum - *staying;
    }
    return true;
}

/* Share of the linear disturbance that is more than the noise of its estimate: the positive-part estimator of James and
 * Stein (1961) of three means, here about zero, with the mean variance of the axes. */
static double filter_significance(const flight_filter *f) {
    double square = 0, variance = 0;
    for (int i = 0; i < 3; i++) {
        const double sum = f->state[STAYING + i] + f->state[FADING + i];
        const double *staying = f->P[STAYING + i], *fading = f->P[FADING + i];
        square += sum * sum;
        variance += (staying[STAYING + i] + 2 * staying[FADING + i] + fading[FADING + i]) / 3;
    }
    return square > variance ? 1 - variance / square : 0;
}

/* Disturbance that predictions are to have: both parts (2 AXES), as far as they are trusted. */
static void filter_flown(const flight_filter *f, double moments, double *flown) {
    const double significance = filter_significance(f);
    for (int i = 0; i < AXES; i++) {
        const double trust = i < 3 ? f->trust[0] : f->trust[1] * moments, share = i < 3 ? trust * significance : trust;
        flown[i] = share * f->state[STAYING + i] + (i < 3 ? trust * f->kept[i] : 0);
        flown[AXES + i] = share * f->state[FADING + i];
    }
}

/* Let what is not flown of the disturbance, as it may be noise, be flown where it persists: a constant one is, to all of
 * its size. */
static void filter_keep(flight_filter *f, double dt) {
    const double significance = filter_significance(f), share = fmin(dt / f->options.persistence, 1);
    for (int i = 0; i < 3; i++) {
        const double sum = f->state[STAYING + i] + f->state[FADING + i];
        f->kept[i] += share * ((1 - significance) * sum - f->kept[i]);
    }
}

/* Let the level of the noise follow what a forecast over so many seconds left, the staying part aside. away: (3) m/s. */
static void filter_follow_level(flight_filter *f, const double *away, double seconds, double dt) {
    const filter_options *o = &f->options;
    double excess = 0;
    for (int i = 0; i < 3; i++) {
        const double fade = o->fading_time[i] * (1 - exp(-seconds / o->fading_time[i])) / seconds;
        excess += (away[i] * away[i] - 2 * o->measurement[i] * o->measurement[i]) / (3 * fade * fade);
    }
    f->unexplained += fmin(dt / (excess > f->unexplained ? o->rising : o->falling), 1) * (excess - f->unexplained);
    filter_set_level(f, fmin(fmax(LEVEL_MARGIN * sqrt(fmax(f->unexplained, 0)) / (seconds * o->fading[0]), o->calm), 1));
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
    double square[2][2] = {{0}}, away[3];
    for (int i = 0; i < 3; i++) away[i] = beyond[i] - first->staying[i] * seconds;
    filter_follow_level(f, away, seconds, dt);
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

/* A measurement dt seconds after the last, before. change: by the model with the parameters as they are, and by the
 * file's. Returns whether it was used; if not, the filter goes on from it. */
static bool filter_update(flight_filter *f, const double *change, const double *change_by_file, const double *before,
                          const double *measured, double dt) {
    double sum = 0; /* not finite where one of these is not */
    for (int i = 0; i < AXES; i++) sum += change[i] + change_by_file[i] + measured[i];
    if (!isfinite(sum)) {
        filter_restart(f, measured);
        return false;
    }
    guard(f, change, change_by_file, measured, before, dt);
    filter_predict(f, change, dt);
    const bool used = filter_take(f, measured);
    if (!used) {
        filter_restart(f, measured);
        filter_set_level(f, 1);
    }
    filter_keep(f, dt);
    return used;
}

#endif

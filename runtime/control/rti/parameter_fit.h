/* Parameters of effects from the last seconds of flight: nonlinear least squares over rows of 0.1 s, a few of them at
 * every tick; derived in docs/adaptation.md.
 *
 * A row is the mean acceleration beyond the file's model, z = y - (a(theta) - a(file)) what the parameters leave of it.
 * That is an offset, noise of the estimates, and a disturbance that fades (first-order Gauss-Markov): the sum of the
 * latter two is an ARMA(1,1) process (Box and Jenkins, 1970), which whitens rows and their derivatives by axis. All rows
 * are linearised anew in every sweep: a recursive filter would keep slopes from where its estimate has been, and a force
 * is the product of drag and wind. */
#ifndef ALULA_PARAMETER_FIT_H
#define ALULA_PARAMETER_FIT_H

#include "flight_filter.h"

#define FIT_ROWS 300
#define FIT_BLOCK 0.1       /* s */
#define FIT_STEP 0.002      /* s over which the model's acceleration at a row is averaged */
#define FIT_AT_A_TICK 3     /* rows */
#define FIT_MIN_ROWS 10     /* rows */
#define FIT_MAX_STEP 0.5 /* of a parameter in one sweep, in standard deviations of its prior */
#define FIT_SHOWN 0.5 /* of the prior's deviation, below which the rows have shown a parameter */
#define FIT_FREE_OFFSET 10.0 /* m/s^2, prior of the offset while the wind is not followed */
#define FIT_DELAY 5          /* rows, and FIT_DELAYS times as many: by which slopes are delayed */
#define FIT_DELAYS 8
#define FIT_MIN_INDEPENDENT 0.2 /* of a delayed slope's variation that it has not in common with the slope */
#define FIT_MEAN 30          /* rows, over which the air is averaged for its change */
#define FIT_CHANGED 4.5      /* standard deviations of a step of such means, beyond which the air has changed */
#define FIT_SECOND 10        /* rows */
#define FIT_OUTLIER 3.0      /* standard deviations beyond which a row's weight falls: a wind that begins */
#define FIT_SHARES 9
#define COLUMNS (MAX_FOLLOWED + 2) /* of an axis: slopes, then the offsets now and before the air changed */
#define UNKNOWNS (MAX_FOLLOWED + 6)

typedef struct {
    double state[NX], inputs[NU];
    double usual[3], beyond[3]; /* accelerations: of the file's model, and measured beyond it */
    bool joined;                /* whether it follows the row before without a gap */
} fit_row;

typedef struct {
    fit_row rows[FIT_ROWS], filling;
    double seconds;          /* of the row that is filled */
    double push[3], surprise[3]; /* disturbance at its start, and change of velocity since beyond model and disturbance */
    long added, at, until;   /* rows so far; of the sweep: the next one, and its end */
    long oldest, changed;    /* row that is still used, and the one since which the air is as it is now */
    int restarts, clears;    /* of the filter, as they were last */
    double offset[2][3], variance[3]; /* offset: now, and before the air changed; variance: of whitened rows */
    double fading[3], share[3];    /* variance of the disturbance that fades, and its share in that of the rows */
    double normal[3][COLUMNS][COLUMNS], right[3][COLUMNS];
    double left[3], slopes[3][COLUMNS], white[3], white_slopes[3][COLUMNS]; /* of the row before */
    double sum[3], square[3], product[3], white_square[3]; /* of z, of z with the one before, of whitened z */
    double slope_sum[3][MAX_FOLLOWED], slope_square[3][MAX_FOLLOWED];
    long taken, pairs;
    double whites[3][FIT_ROWS], all_slopes[3][MAX_FOLLOWED][FIT_ROWS]; /* whitened, of the sweep's rows */
    double lefts[3][FIT_ROWS];
    double trial_white[3][FIT_SHARES], trial_square[3][FIT_SHARES]; /* whitened by each share: the last row, all squares */
} parameter_fit;

/* Shares of what fades in the variance of the rows, of which the likeliest is taken; means of a row go on for longer than
 * values do, by which it can be above 1. */
static const double FIT_SHARE[FIT_SHARES] = {0, 0.1, 0.25, 0.5, 0.7, 0.85, 0.95, 1.0, 1.03};

static double fit_value(const flight_filter *f, int j) {
    return f->options.prior[j] + f->options.scale[j] * f->state[FOLLOWED + j];
}

static void fit_begin(parameter_fit *t) {
    t->until = t->added;
    t->at = t->added > t->oldest + FIT_ROWS ? t->added - FIT_ROWS : t->oldest;
    t->taken = t->pairs = 0;
    memset(t->normal, 0, sizeof t->normal);
    memset(t->right, 0, sizeof t->right);
    memset(t->sum, 0, sizeof t->sum);
    memset(t->square, 0, sizeof t->square);
    memset(t->product, 0, sizeof t->product);
    memset(t->white_square, 0, sizeof t->white_square);
    memset(t->trial_square, 0, sizeof t->trial_square);
    memset(t->slope_sum, 0, sizeof t->slope_sum);
    memset(t->slope_square, 0, sizeof t->slope_square);
}

static void fit_clear(parameter_fit *t, const filter_options *o) {
    t->added = t->oldest = t->changed = 0, t->seconds = 0;
    memset(t->offset, 0, sizeof t->offset);
    for (int i = 0; i < 3; i++) t->share[i] = 1, t->variance[i] = t->fading[i] = o->fading[i] * o->fading[i];
    fit_begin(t);
}

/* Add what happened in dt seconds from a state on. beyond, beyond_adapted: changes of velocity and rate beyond the file's
 * and the adapted model. Returns whether a row was completed, which then lacks the file's accelerations.
 *
 * The velocity in the middle of a row is the one that was expected at its start. The measured one has what pushed in the
 * row's first half: in gusts a drag would be too small, as the air pushes, and the vehicle goes, the same way. */
static bool fit_add(parameter_fit *t, const flight_filter *f, const double *state, const double *inputs,
                    const double *beyond, const double *beyond_adapted, double dt) {
    fit_row *row = &t->filling;
    if (t->clears != f->clears) fit_clear(t, &f->options);
    if (t->clears != f->clears || t->restarts != f->restarts) t->seconds = 0, row->joined = false;
    t->clears = f->clears, t->restarts = f->restarts;
    if (t->seconds == 0) {
        memset(row->beyond, 0, sizeof row->beyond);
        for (int i = 0; i < 3; i++) t->push[i] = f->state[STAYING + i] + f->state[FADING + i], t->surprise[i] = 0;
    }
    if (t->seconds < 0.5 * FIT_BLOCK + 0.5 * dt) {
        memcpy(row->state, state, sizeof row->state);
        memcpy(row->inputs, inputs, sizeof row->inputs);
        for (int i = 0; i < 3; i++) row->state[3 + i] -= t->surprise[i];
    }
    for (int i = 0; i < 3; i++) {
        row->beyond[i] += beyond[i];
        t->surprise[i] += beyond_adapted[i] - dt * t->push[i];
    }
    t->seconds += dt;
    if (t->seconds < FIT_BLOCK - 0.5 * dt) return false;
    for (int i = 0; i < 3; i++) row->beyond[i] /= t->seconds;
    t->rows[t->added++ % FIT_ROWS] = *row;
    t->seconds = 0, row->joined = true;
    return true;
}

/* Whitening of an axis's z - keep z_before: by `mean` of the whitened one before, to the share `innovation` of z's
 * variance. share: of the fading part in that variance. */
static void fit_whitening(double keep, double share, double *mean, double *innovation) {
    const double own = share * (1 - keep * keep) + (1 - share) * (1 + keep * keep), next = (1 - share) * keep;
    *mean = fabs(next) > 1e-9 ? (own - sqrt(fmax(own * own - 4 * next * next, 0))) / (2 * next) : 0;
    *innovation = own / (1 + *mean * *mean);
}

/* Take a row into the sweep. left: (3) what the parameters leave. slopes: (3, n) of the model's acceleration. before:
 * whether the row is from before the air changed. */
static void fit_take(parameter_fit *t, const filter_options *o, const double *left, double slopes[3][MAX_FOLLOWED],
                     bool joined, bool before) {
    const int n = o->count;
    joined &= t->taken > 0;
    for (int i = 0; i < 3; i++) {
        const double keep = exp(-FIT_BLOCK / o->fading_time[i]), away = left[i] - t->offset[before][i];
        const double limit = FIT_OUTLIER * sqrt(t->variance[i]);
        double mean, innovation, white, column[COLUMNS], white_column[COLUMNS];
        for (int s = 0; s < FIT_SHARES; s++) {
            double *trial = &t->trial_white[i][s];
            fit_whitening(keep, FIT_SHARE[s], &mean, &innovation);
            *trial = joined ? away - keep * t->left[i] + mean * *trial : sqrt(innovation) * away;
            t->trial_square[i][s] += fmin(*trial * *trial, limit * limit);
        }
        fit_whitening(keep, t->share[i], &mean, &innovation);
        memcpy(column, slopes[i], sizeof(double) * n);
        column[n] = !before, column[n + 1] = before;
        white = joined ? away - keep * t->left[i] + mean * t->white[i] : sqrt(innovation) * away;
        for (int j = 0; j < n + 2; j++)
            white_column[j] = joined ? column[j] - keep * t->slopes[i][j] + mean * t->white_slopes[i][j]
                                     : sqrt(innovation) * column[j];
        const double weight = fmin(limit / fmax(fabs(white), 1e-12), 1); /* Huber's */
        for (int r = 0; r < n + 2; r++) {
            t->right[i][r] += weight * white_column[r] * white;
            for (int c = 0; c <= r; c++) t->normal[i][r][c] += weight * white_column[r] * white_column[c];
        }
        for (int j = 0; j < n; j++) {
            t->slope_sum[i][j] += slopes[i][j], t->slope_square[i][j] += slopes[i][j] * slopes[i][j];
            t->all_slopes[i][j][t->taken] = white_column[j];
        }
        if (joined) t->product[i] += away * t->left[i];
        t->sum[i] += away, t->square[i] += away * away, t->white_square[i] += fmin(white * white, limit * limit);
        t->left[i] = away, t->white[i] = white;
        t->whites[i][t->taken] = weight * white, t->lefts[i][t->taken] = away;
        memcpy(t->slopes[i], column, sizeof column);
        memcpy(t->white_slopes[i], white_column, sizeof white_column);
    }
    t->taken++, t->pairs += joined;
}

/* Which parameters the rows can show: a drag where its slope varies, since its constant part depends on the wind; the
 * wind beside a drag that is certain, and every drag beside one that the rows have made so; what scales thrust never,
 * since its effectiveness has it; any other always. */
static void fit_choose(const parameter_fit *t, flight_filter *f) {
    const filter_options *o = &f->options;
    bool certain = o->known_drag > 0, by_rows = false, shows[MAX_FOLLOWED] = {false};
    for (int j = 0; j < o->count; j++) {
        double variance = 0;
        for (int i = 0; i < 3; i++) {
            const double mean = t->slope_sum[i][j] / t->taken;
            variance += t->slope_square[i][j] / t->taken - mean * mean;
        }
        shows[j] = variance > o->variation * o->variation;
        const double enough = o->drag_deviations * o->scale[j] * f->deviation[j];
        const bool one = o->group[j] == 1 && fabs(fit_value(f, j)) > enough;
        certain |= one, by_rows |= one && f->deviation[j] < FIT_SHOWN;
    }
    for (int j = 0; j < o->count; j++)
        f->followed[j] = o->group[j] == 0 || (o->group[j] == 1 && (shows[j] || f->followed[j] || by_rows)) ||
                         (o->group[j] == 2 && certain);
}

/* Variance of the wind's state by drags that are certain and not followed, of which only the product with it shows. */
static double fit_drags(const flight_filter *f, int wind) {
    const filter_options *o = &f->options;
    double share = o->known_drag;
    for (int j = 0; j < o->count; j++)
        if (o->group[j] == 1 && !f->followed[j] && o->prior[j] != 0)
            share = fmax(share, f->deviation[j] * o->scale[j] / fabs(o->prior[j]));
    return pow(fmin(share, 1) * f->state[FOLLOWED + wind], 2);
}

/* Cholesky factor of the rows and columns of M that are free, in place (lower); the others become those of 1. */
static bool fit_factor(double M[UNKNOWNS][UNKNOWNS], const bool *unfree, int count) {
    for (int r = 0; r < count; r++)
        for (int c = 0; c <= r; c++)
            if (unfree[r] || unfree[c]) M[r][c] = r == c;
    for (int c = 0; c < count; c++) {
        for (int k = 0; k < c; k++) M[c][c] -= M[c][k] * M[c][k];
        if (!(M[c][c] > 0)) return false;
        M[c][c] = sqrt(M[c][c]);
        for (int r = c + 1; r < count; r++) {
            for (int k = 0; k < c; k++) M[r][c] -= M[r][k] * M[c][k];
            M[r][c] /= M[c][c];
        }
    }
    return true;
}

static void fit_solve(double L[UNKNOWNS][UNKNOWNS], double *x, int count) {
    for (int r = 0; r < count; r++) {
        for (int c = 0; c < r; c++) x[r] -= L[r][c] * x[c];
        x[r] /= L[r][r];
    }
    for (int r = count - 1; r >= 0; r--) {
        for (int c = r + 1; c < count; c++) x[r] -= L[c][r] * x[c];
        x[r] /= L[r][r];
    }
}

/* The unknown of an axis's column. */
static int fit_unknown(int count, int column, int axis) {
    return column < count ? column : count + 3 * (column - count) + axis;
}

/* Normal equations of the sweep with the priors: of the parameters' states about zero, of the offset about zero. Upwards
 * the offset is free beside the wind, too: what the effectiveness of thrust errs by is constant there. */
static void fit_equations(const parameter_fit *t, const flight_filter *f, double M[UNKNOWNS][UNKNOWNS], double *right) {
    const filter_options *o = &f->options;
    const int n = o->count;
    bool wind = false;
    for (int j = 0; j < n; j++) wind |= o->group[j] == 2 && f->followed[j];
    memset(M, 0, sizeof(double) * UNKNOWNS * UNKNOWNS);
    for (int j = 0; j < n; j++) M[j][j] = 1, right[j] = -f->state[FOLLOWED + j];
    for (int i = 0; i < 3; i++) {
        for (int before = 0; before < 2; before++) {
            const int row = n + 3 * before + i;
            const double offset = wind && !before && i != 2 ? o->offset : FIT_FREE_OFFSET;
            M[row][row] = 1 / (offset * offset), right[row] = -t->offset[before][i] / (offset * offset);
        }
        for (int r = 0; r < n + 2; r++) {
            const int row = fit_unknown(n, r, i);
            right[row] += t->right[i][r] / t->variance[i];
            for (int c = 0; c <= r; c++) M[row][fit_unknown(n, c, i)] += t->normal[i][r][c] / t->variance[i];
        }
    }
}

/* Move parameters and offset by a Gauss-Newton step; one that would leave its bounds stays at the bound, and the others
 * are the best beside it. Returns whether the step was short enough to be taken as it is. */
static bool fit_step(parameter_fit *t, flight_filter *f, double M[UNKNOWNS][UNKNOWNS], const double *right) {
    const filter_options *o = &f->options;
    const int n = o->count, count = n + 6;
    double L[UNKNOWNS][UNKNOWNS], step[UNKNOWNS], fixed[UNKNOWNS] = {0};
    bool unfree[UNKNOWNS] = {false};
    for (int j = 0; j < n; j++) unfree[j] = !f->followed[j];
    for (int turn = 0; turn <= n; turn++) {
        memcpy(L, M, sizeof L);
        for (int r = 0; r < count; r++) {
            step[r] = unfree[r] ? fixed[r] : right[r];
            for (int c = 0; c < count && !unfree[r]; c++)
                if (unfree[c]) step[r] -= (r > c ? M[r][c] : M[c][r]) * fixed[c];
        }
        if (!fit_factor(L, unfree, count)) return false;
        fit_solve(L, step, count);
        int worst = -1;
        double excess = 1e-12;
        for (int j = 0; j < n; j++) {
            const double lowest = (o->lower[j] - o->prior[j]) / o->scale[j] - f->state[FOLLOWED + j];
            const double highest = (o->upper[j] - o->prior[j]) / o->scale[j] - f->state[FOLLOWED + j];
            const double beyond = fmax(lowest - step[j], step[j] - highest);
            if (!unfree[j] && beyond > excess) excess = beyond, worst = j, fixed[j] = step[j] < lowest ? lowest : highest;
        }
        if (worst < 0) break;
        unfree[worst] = true;
    }
    double longest = 0;
    for (int j = 0; j < n; j++) longest = fmax(longest, fabs(step[j]));
    const double part = longest > FIT_MAX_STEP ? FIT_MAX_STEP / longest : 1;
    for (int j = 0; j < n; j++) f->state[FOLLOWED + j] += part * step[j];
    for (int i = 0; i < 6; i++) t->offset[i / 3][i % 3] += part * step[n + i];
    return part == 1;
}

/* By how much the noise is greater where a parameter's slopes vary than in the mean of all rows, at least 1: what slopes
 * explain of it once they are delayed, which is nothing of theirs. Wind that changes with the laps is such noise. */
static double fit_excess(const parameter_fit *t, int parameter) {
    const long rows = t->taken;
    double explained = 0, expected = 0;
    for (int i = 0; i < 3; i++) {
        const double *slope = t->all_slopes[i][parameter], *white = t->whites[i], variance = t->variance[i];
        double mean = 0, square = 0;
        for (long k = 0; k < rows; k++) mean += slope[k] / rows;
        for (long k = 0; k < rows; k++) square += (slope[k] - mean) * (slope[k] - mean);
        if (square < variance) continue; /* its prior shows more */
        for (long delay = FIT_DELAY; delay <= FIT_DELAYS * FIT_DELAY; delay += FIT_DELAY) {
            double product = 0, common = 0;
            for (long k = delay; k < rows; k++) {
                product += (slope[k - delay] - mean) * white[k];
                common += (slope[k - delay] - mean) * (slope[k] - mean);
            }
            const double own = 1 - common * common / (square * square);
            if (own < FIT_MIN_INDEPENDENT) continue;
            explained += product * product / (variance * variance), expected += own * square / variance;
        }
    }
    return expected > 0 ? fmax(explained / expected, 1) : 1;
}

/* Variance of the mean of so many rows where what fades has a variance. */
static double fit_mean_variance(double fading, double time, long rows) {
    const double span = rows * FIT_BLOCK / time;
    return fading * 2 / span * (1 - (1 - exp(-span)) / span);
}

/* The row of the sweep since which the air is another: where means before and after differ most, by more than gusts let
 * them; 0 where it is the same (a window that adapts, as Bifet and Gavalda, 2007). Gusts are told by how much a row has in
 * common with the next, and with one a second later: a wind that stays has as much in common with both. */
static long fit_change(const parameter_fit *t, const filter_options *o) {
    const long rows = t->taken, means = rows / FIT_MEAN, start = rows - means * FIT_MEAN;
    double threshold = FIT_CHANGED * FIT_CHANGED;
    long since = 0;
    for (int i = 0; i < 3 && means > 1; i++) {
        const double *left = t->lefts[i], time = o->fading_time[i];
        double total = 0, one = 0, second = 0, before = 0;
        for (long k = start; k < rows; k++) total += left[k];
        for (long k = start + FIT_SECOND; k < rows; k++) {
            const double away = left[k] - total / (rows - start);
            one += away * (left[k - 1] - total / (rows - start));
            second += away * (left[k - FIT_SECOND] - total / (rows - start));
        }
        const double common = exp(-FIT_BLOCK / time) - exp(-FIT_SECOND * FIT_BLOCK / time);
        double fading = fmax((one - second) / (common * (rows - start - FIT_SECOND)), 0) + 0.25 * o->offset * o->offset;
        for (long split = start + FIT_MEAN; split < rows; split += FIT_MEAN) {
            for (long k = split - FIT_MEAN; k < split; k++) before += left[k];
            const double step = before / (split - start) - (total - before) / (rows - split);
            const double usual = fit_mean_variance(fading, time, split - start) + fit_mean_variance(fading, time, rows - split);
            if (step * step > threshold * usual) threshold = step * step / usual, since = split;
        }
    }
    return since;
}

/* The noise of the rows, for the next sweep: its variance, and how much of it fades. */
static void fit_noise(parameter_fit *t, const filter_options *o) {
    for (int i = 0; i < 3; i++) {
        const double mean = t->sum[i] / t->taken, variance = t->square[i] / t->taken - mean * mean;
        const double next = t->product[i] / (t->pairs > 0 ? t->pairs : 1) - mean * mean;
        const double keep = exp(-FIT_BLOCK / o->fading_time[i]);
        const double minimum = 0.25 * o->offset * o->offset; /* the attitude's errors fade, too */
        t->fading[i] = fmin(fmax(next / keep, minimum), fmax(variance, minimum));
        int likeliest = 0;
        for (int s = 1; s < FIT_SHARES; s++)
            if (t->trial_square[i][s] < t->trial_square[i][likeliest]) likeliest = s;
        t->share[i] = FIT_SHARE[likeliest];
        t->variance[i] = fmax(t->white_square[i] / t->taken, o->walk * o->walk / FIT_BLOCK);
    }
}

/* Variance that a parameter of the wind has because gusts do not have their mean in the rows: what fades is wind, too. */
static double fit_gusts(const parameter_fit *t, const filter_options *o, int parameter) {
    double square = 0, push = 0, time = 0;
    for (int i = 0; i < 3; i++) {
        square += t->slope_square[i][parameter] / t->taken;
        push += t->fading[i] * t->slope_square[i][parameter] / t->taken;
        time += o->fading_time[i] / 3;
    }
    if (square <= 0) return 0;
    return push / (square * square) * fmin(2 * time / (t->taken * FIT_BLOCK), 1);
}

/* End a sweep: choose, move, and begin another. mean: (3) by how much the move changes the model's acceleration in the
 * mean of all rows. */
static void fit_end(parameter_fit *t, flight_filter *f, double *mean) {
    const filter_options *o = &f->options;
    const int count = o->count + 6;
    double M[UNKNOWNS][UNKNOWNS], right[UNKNOWNS], column[UNKNOWNS], from[MAX_FOLLOWED];
    bool unfree[UNKNOWNS] = {false};
    memcpy(from, f->state + FOLLOWED, sizeof from);
    fit_choose(t, f);
    fit_equations(t, f, M, right);
    if (fit_step(t, f, M, right)) {
        for (int j = 0; j < o->count; j++) unfree[j] = !f->followed[j];
        if (fit_factor(M, unfree, count))
            for (int j = 0; j < o->count; j++) {
                memset(column, 0, sizeof column);
                column[j] = 1;
                fit_solve(M, column, count);
                column[j] *= fit_excess(t, j);
                if (o->group[j] == 2) column[j] += fit_gusts(t, o, j) + fit_drags(f, j);
                f->deviation[j] = f->followed[j] ? sqrt(fmin(column[j], 1)) : fmax(f->deviation[j], 1);
            }
    }
    for (int i = 0; i < 3; i++) {
        mean[i] = 0;
        for (int j = 0; j < o->count; j++)
            mean[i] += t->slope_sum[i][j] / t->taken * (f->state[FOLLOWED + j] - from[j]);
    }
    fit_noise(t, o);
    const long since = fit_change(t, o);
    if (since) { /* rows from before tell of what has not changed, with an offset of their own */
        t->oldest = t->changed, t->changed = t->until - t->taken + since;
        memcpy(t->offset[1], t->offset[0], sizeof t->offset[1]);
    }
    fit_begin(t);
}

#endif

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
#define FIT_FEWEST 10       /* rows */
#define FIT_LARGEST_MOVE 0.5 /* of a parameter in one sweep, in standard deviations of its prior */
#define FIT_FREE_OFFSET 10.0 /* m/s^2, prior of the offset while the wind is not followed */
#define UNKNOWNS (MAX_FOLLOWED + 3)

typedef struct {
    double state[NX], inputs[NU];
    double usual[3], beyond[3]; /* accelerations: of the file's model, and measured beyond it */
    bool joined;                /* whether it follows the row before without a gap */
} fit_row;

typedef struct {
    fit_row rows[FIT_ROWS], filling;
    double seconds;          /* of the row that is filled */
    long added, at, until;   /* rows so far; of the sweep: the next one, and its end */
    int restarts, clears;    /* of the filter, as they were last */
    double offset[3], variance[3]; /* variance: of whitened rows */
    double fading[3], share[3];    /* variance of the disturbance that fades, and its share in that of the rows */
    double normal[3][MAX_FOLLOWED + 1][MAX_FOLLOWED + 1], right[3][MAX_FOLLOWED + 1];
    double left[3], slopes[3][MAX_FOLLOWED], white[3], white_slopes[3][MAX_FOLLOWED + 1]; /* of the row before */
    double sum[3], square[3], product[3], white_square[3]; /* of z, of z with the one before, of whitened z */
    double slope_sum[3][MAX_FOLLOWED], slope_square[3][MAX_FOLLOWED];
    long taken, pairs;
} parameter_fit;

static double fit_value(const flight_filter *f, int j) {
    return f->options.prior[j] + f->options.scale[j] * f->state[FOLLOWED + j];
}

static void fit_begin(parameter_fit *t) {
    t->until = t->added;
    t->at = t->added > FIT_ROWS ? t->added - FIT_ROWS : 0;
    t->taken = t->pairs = 0;
    memset(t->normal, 0, sizeof t->normal);
    memset(t->right, 0, sizeof t->right);
    memset(t->sum, 0, sizeof t->sum);
    memset(t->square, 0, sizeof t->square);
    memset(t->product, 0, sizeof t->product);
    memset(t->white_square, 0, sizeof t->white_square);
    memset(t->slope_sum, 0, sizeof t->slope_sum);
    memset(t->slope_square, 0, sizeof t->slope_square);
}

static void fit_clear(parameter_fit *t, const filter_options *o) {
    t->added = 0, t->seconds = 0;
    for (int i = 0; i < 3; i++) t->offset[i] = 0, t->share[i] = 1, t->variance[i] = t->fading[i] = o->fading[i] * o->fading[i];
    fit_begin(t);
}

/* Add what happened in dt seconds from a state on. beyond: changes of velocity and rate beyond the file's model. Returns
 * whether a row was completed, which then lacks the file's accelerations. */
static bool fit_add(parameter_fit *t, const flight_filter *f, const double *state, const double *inputs,
                    const double *beyond, double dt) {
    fit_row *row = &t->filling;
    if (t->clears != f->clears) fit_clear(t, &f->options);
    if (t->clears != f->clears || t->restarts != f->restarts) t->seconds = 0, row->joined = false;
    t->clears = f->clears, t->restarts = f->restarts;
    if (t->seconds == 0) memset(row->beyond, 0, sizeof row->beyond);
    for (int i = 0; i < 3; i++) row->beyond[i] += beyond[i];
    if (t->seconds < 0.5 * FIT_BLOCK) {
        memcpy(row->state, state, sizeof row->state);
        memcpy(row->inputs, inputs, sizeof row->inputs);
    }
    t->seconds += dt;
    if (t->seconds < FIT_BLOCK - 0.5 * dt) return false;
    for (int i = 0; i < 3; i++) row->beyond[i] /= t->seconds;
    t->rows[t->added++ % FIT_ROWS] = *row;
    t->seconds = 0, row->joined = true;
    return true;
}

/* Whitening of an axis's z - keep z_before: by `mean` of the whitened one before, to the share `least` of z's variance.
 * share: of the fading part in that variance. */
static void fit_whitening(double keep, double share, double *mean, double *least) {
    const double own = share * (1 - keep * keep) + (1 - share) * (1 + keep * keep), next = (1 - share) * keep;
    *mean = next > 0 ? (own - sqrt(fmax(own * own - 4 * next * next, 0))) / (2 * next) : 0;
    *least = own / (1 + *mean * *mean);
}

/* Take a row into the sweep. left: (3) what the parameters leave. slopes: (3, n) of the model's acceleration. */
static void fit_take(parameter_fit *t, const filter_options *o, const double *left, double slopes[3][MAX_FOLLOWED],
                     bool joined) {
    const int n = o->count;
    joined &= t->taken > 0;
    for (int i = 0; i < 3; i++) {
        const double keep = exp(-FIT_BLOCK / o->fading_time[i]);
        double mean, least, white, white_slopes[MAX_FOLLOWED + 1];
        fit_whitening(keep, t->share[i], &mean, &least);
        if (joined) {
            white = left[i] - t->offset[i] - keep * (t->left[i] - t->offset[i]) + mean * t->white[i];
            for (int j = 0; j < n; j++)
                white_slopes[j] = slopes[i][j] - keep * t->slopes[i][j] + mean * t->white_slopes[i][j];
            white_slopes[n] = 1 - keep + mean * t->white_slopes[i][n];
            t->product[i] += left[i] * t->left[i];
        } else {
            white = sqrt(least) * (left[i] - t->offset[i]);
            for (int j = 0; j < n; j++) white_slopes[j] = sqrt(least) * slopes[i][j];
            white_slopes[n] = sqrt(least);
        }
        for (int r = 0; r <= n; r++) {
            t->right[i][r] += white_slopes[r] * white;
            for (int c = 0; c <= r; c++) t->normal[i][r][c] += white_slopes[r] * white_slopes[c];
        }
        for (int j = 0; j < n; j++) {
            t->slope_sum[i][j] += slopes[i][j], t->slope_square[i][j] += slopes[i][j] * slopes[i][j];
            t->slopes[i][j] = slopes[i][j];
        }
        t->sum[i] += left[i], t->square[i] += left[i] * left[i], t->white_square[i] += white * white;
        t->left[i] = left[i], t->white[i] = white;
        memcpy(t->white_slopes[i], white_slopes, sizeof white_slopes);
    }
    t->taken++, t->pairs += joined;
}

/* Which parameters the rows can show: a drag where its slope varies, since its constant part depends on the wind; the
 * wind, and every drag, beside a drag that is certain; what scales thrust never, since its effectiveness has it; any
 * other always. */
static void fit_choose(const parameter_fit *t, flight_filter *f) {
    const filter_options *o = &f->options;
    bool certain = false, shows[MAX_FOLLOWED] = {false};
    for (int j = 0; j < o->count; j++) {
        double variance = 0;
        for (int i = 0; i < 3; i++) {
            const double mean = t->slope_sum[i][j] / t->taken;
            variance += t->slope_square[i][j] / t->taken - mean * mean;
        }
        shows[j] = variance > o->variation * o->variation;
        const double enough = o->drag_deviations * o->scale[j] * f->deviation[j];
        certain |= o->group[j] == 1 && fabs(fit_value(f, j)) > enough;
    }
    for (int j = 0; j < o->count; j++)
        f->followed[j] = o->group[j] == 0 || (o->group[j] == 1 && (shows[j] || f->followed[j] || certain)) ||
                         (o->group[j] == 2 && certain);
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

/* Normal equations of the sweep with the priors: of the parameters' states about zero, of the offset about zero. */
static void fit_equations(const parameter_fit *t, const flight_filter *f, double M[UNKNOWNS][UNKNOWNS], double *right) {
    const filter_options *o = &f->options;
    const int n = o->count;
    bool wind = false;
    for (int j = 0; j < n; j++) wind |= o->group[j] == 2 && f->followed[j];
    const double offset = wind ? o->offset : FIT_FREE_OFFSET;
    memset(M, 0, sizeof(double) * UNKNOWNS * UNKNOWNS);
    for (int j = 0; j < n; j++) M[j][j] = 1, right[j] = -f->state[FOLLOWED + j];
    for (int i = 0; i < 3; i++) {
        M[n + i][n + i] = 1 / (offset * offset), right[n + i] = -t->offset[i] / (offset * offset);
        for (int r = 0; r <= n; r++) {
            const int row = r < n ? r : n + i;
            right[row] += t->right[i][r] / t->variance[i];
            for (int c = 0; c <= r; c++) M[row][c < n ? c : n + i] += t->normal[i][r][c] / t->variance[i];
        }
    }
}

/* Move parameters and offset by a Gauss-Newton step; one that would leave its bounds stays at the bound, and the others
 * are the best beside it. Returns whether the step was short enough to be taken as it is. */
static bool fit_step(parameter_fit *t, flight_filter *f, double M[UNKNOWNS][UNKNOWNS], const double *right) {
    const filter_options *o = &f->options;
    const int n = o->count, count = n + 3;
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
    const double part = longest > FIT_LARGEST_MOVE ? FIT_LARGEST_MOVE / longest : 1;
    for (int j = 0; j < n; j++) f->state[FOLLOWED + j] += part * step[j];
    for (int i = 0; i < 3; i++) t->offset[i] += part * step[n + i];
    return part == 1;
}

/* The noise of the rows, for the next sweep: its variance, and how much of it fades. */
static void fit_noise(parameter_fit *t, const filter_options *o) {
    for (int i = 0; i < 3; i++) {
        const double mean = t->sum[i] / t->taken, variance = t->square[i] / t->taken - mean * mean;
        const double next = t->product[i] / (t->pairs > 0 ? t->pairs : 1) - mean * mean;
        const double keep = exp(-FIT_BLOCK / o->fading_time[i]);
        const double least = 0.25 * o->offset * o->offset; /* the attitude's errors fade, too */
        t->fading[i] = fmin(fmax(next / keep, least), fmax(variance, least));
        t->share[i] = fmin(t->fading[i] / fmax(variance, least), 1);
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
    const int count = o->count + 3;
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
                if (o->group[j] == 2) column[j] = fmin(column[j] + fit_gusts(t, o, j), 1);
                f->deviation[j] = f->followed[j] ? sqrt(column[j]) : fmax(f->deviation[j], 1);
            }
    }
    for (int i = 0; i < 3; i++) {
        mean[i] = 0;
        for (int j = 0; j < o->count; j++)
            mean[i] += t->slope_sum[i][j] / t->taken * (f->state[FOLLOWED + j] - from[j]);
    }
    fit_noise(t, o);
    fit_begin(t);
}

#endif

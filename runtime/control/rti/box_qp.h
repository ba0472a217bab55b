/* A dense quadratic program with bounds on every variable and, optionally, soft rows:
 *
 *   minimise 1/2 v'Hv + g'v + sum_r p(row_r v - upper_r) + p(lower_r - row_r v)   subject to  lower <= v <= upper,
 *
 * H positive definite, p(x) = penalty (x + x^2 / 2) for x > 0, else 0. The linear price is exact (Fletcher, 1987, section
 * 14.3): a row whose multiplier stays below it is kept. The quadratic one makes a large excess dearer than a small one.
 *
 * Call box_qp_factor first. Where nothing acts the optimum is -H^-1 g, for two triangular solves with its factor.
 * Else Mehrotra's predictor-corrector method (SIAM J. Optimization 2, 1992), in which a soft row is
 *
 *   row v + slack - excess = upper,  slack price = mu,  excess rest = mu,  price + rest = penalty (1 + excess).
 *
 * Slacks, excesses and multipliers are eliminated row by row, so that an iteration is one factor of
 * H + diagonal + rows' diagonal rows, whatever the number of rows. v lies within its bounds at every iterate: one that is
 * cut is feasible. box_qp_begin walks to a central iterate before the state is measured, from which box_qp_solve goes on
 * (Yildirim and Wright, SIAM J. Optimization 12, 2002, on warm starts from central iterates).
 *
 * As soon as two consecutive iterations agree which bounds act and that no row does, the optimum on those bounds is solved
 * for; where it stays in the box and its multipliers have the right sign it is the optimum, to rounding.
 *
 * Required from the including file: NV, the number of variables, SOFT, the largest number of rows, and VECTOR_BYTES.
 * Nothing is allocated. */
#ifndef ALULA_BOX_QP_H
#define ALULA_BOX_QP_H

#include "box_factor.h"

#define BOX_START 0.1     /* of the mean of |gradient| times width: complementarity at the start */
#define BOX_STAY 0.995    /* of the step to the nearest bound */
#define BOX_EXACT 1e-9    /* of the width: what a variable may lie over a bound by rounding */
#define BOX_CURVATURE 0.1 /* of a variable's curvature: about what remains with the others optimised out */
#define BOX_HOT 1e-3      /* of the penalty: complementarity from which a solve goes on; lower ones lie too near bounds */
#define BOX_MARGIN 1e-2   /* of the width: how far from bounds a solve begins */
#define BOX_LIGHT 1e-2   /* of the smallest curvature: what a row may add to it and be left out of the barrier's Hessian */
#define BOX_SHORT 8      /* entries of a row that are added one by one */

/* A point of the method. Pairs are of the lower bounds, then of the upper ones; those of the rows the reverse. */
typedef struct {
    double slack[2][SOFT_ROWS] __attribute__((aligned(64))), excess[2][SOFT_ROWS], price[2][SOFT_ROWS];
    double rest[2][SOFT_ROWS], v[NV], dual[2][NV];
} box_point;

/* Behind NV pairs hold ones and steps of zero. */
typedef struct {
    box_factor free, barrier;
    box_point at, hot;
    double gradient[NV], right[NV], target[2][NV];
    double step[BOX_ROWS] __attribute__((aligned(64))), dual_step[2][BOX_ROWS], slack[2][BOX_ROWS], dual[2][BOX_ROWS];
    double slack_step[2][SOFT_ROWS] __attribute__((aligned(64))), excess_step[2][SOFT_ROWS], price_step[2][SOFT_ROWS];
    double rest_step[2][SOFT_ROWS], error[2][SOFT_ROWS], price_error[2][SOFT_ROWS], per_slack[2][SOFT_ROWS];
    double per_excess[2][SOFT_ROWS], per_stiffness[2][SOFT_ROWS]; /* reciprocals */
    double share[2][SOFT_ROWS], value[SOFT_ROWS], weight[SOFT_ROWS];
    double slack_target[2][SOFT_ROWS], rest_target[2][SOFT_ROWS];
    signed char acts[NV], acted[NV]; /* -1 lower, 1 upper bound, 0 none */
    bool definite; /* whether H is, set by box_qp_factor */
    bool is_hot, factored; /* whether there is a point to go on from; whether its barrier is factored */
    int rows_act; /* how many rows do */
} box_qp;

/* H (NV, NV), g (NV), bounds (NV). */
typedef struct {
    const double *H, *g, *lower, *upper;
    const soft_rows *soft;
} box_program;

/* Factor of H itself; returns whether H is positive definite. */
static bool box_qp_factor(box_qp *q, const double *H) {
    q->free.size = NV, q->free.rows = 0;
    memset(q->free.begin, 0, sizeof q->free.begin);
    q->is_hot = q->factored = false;
    for (int j = 0; j < NV; j++) memcpy(&q->free.columns[j][j], H + j * NV + j, sizeof(double) * (size_t)(NV - j));
    return q->definite = box_cholesky(&q->free);
}

/* v = -H^-1 g; returns whether H is positive definite and v finite and inside the box. */
static bool box_qp_free_optimum(box_qp *q, const double *g, const double *lower, const double *upper, double *v) {
    bool inside = q->definite;
    if (!inside) return false;
    box_solve(&q->free, g, v);
    for (int i = 0; i < NV; i++) {
        v[i] = -v[i];
        inside &= v[i] >= lower[i] && v[i] <= upper[i]; /* false for what is not a number */
    }
    return inside;
}

/* gradient = H v + g. */
static void box_gradient(const double *H, const double *g, const double *v, double *gradient) {
    memcpy(gradient, g, sizeof(double) * NV);
    for (int j = 0; j < NV; j++)
        for (int i = 0; i < NV; i++) gradient[i] += H[j * NV + i] * v[j];
}

/* Solve on the active bounds; returns whether the solution is the optimum of the program. */
static bool box_qp_on_bounds(box_qp *q, const double *H, const double *g, const double *lower, const double *upper,
                             double tolerance, double *v) {
    int index[NV], free = 0;
    double gradient[NV];
    for (int i = 0; i < NV; i++) {
        v[i] = q->acts[i] < 0 ? lower[i] : q->acts[i] > 0 ? upper[i] : 0;
        if (!q->acts[i]) index[free++] = i;
    }
    box_factor *f = &q->barrier;
    f->size = free, f->rows = 0, q->factored = false;
    memset(f->begin, 0, sizeof f->begin);
    box_gradient(H, g, v, gradient);
    for (int j = 0; j < free; j++) {
        q->right[j] = -gradient[index[j]];
        for (int i = j; i < free; i++) f->columns[j][i] = H[index[j] * NV + index[i]];
    }
    if (!box_cholesky(f)) return false;
    box_solve(f, q->right, q->step);
    for (int j = 0; j < free; j++) {
        const int i = index[j];
        const double over = fmax(lower[i] - q->step[j], q->step[j] - upper[i]);
        if (!(over <= BOX_EXACT * (upper[i] - lower[i]))) return false;
        v[i] = fmin(fmax(q->step[j], lower[i]), upper[i]);
    }
    box_gradient(H, g, v, gradient);
    for (int i = 0; i < NV; i++)
        if (!(q->acts[i] * gradient[i] <= tolerance)) return false;
    return true;
}

/* The objective at v (NV). */
static double box_cost(const box_program *p, const double *v) {
    double slope[NV], value[SOFT_ROWS], cost = 0;
    box_gradient(p->H, p->g, v, slope);
    for (int i = 0; i < NV; i++) cost += 0.5 * v[i] * (slope[i] + p->g[i]);
    soft_values(p->soft, v, value);
    for (int r = 0; r < p->soft->count; r++) {
        const double over = fmax(fmax(value[r] - p->soft->bound[0][r], p->soft->bound[1][r] - value[r]), 0);
        cost += p->soft->penalty * over * (1 + 0.5 * over);
    }
    return cost;
}

/* Whether v keeps all rows, but for rounding. */
static bool box_rows_kept(const box_program *p, const double *v) {
    double value[SOFT_ROWS];
    soft_values(p->soft, v, value);
    for (int r = 0; r < p->soft->count; r++) {
        const double room = BOX_EXACT * (1 + fabs(p->soft->bound[0][r]) + fabs(p->soft->bound[1][r]));
        if (!(value[r] <= p->soft->bound[0][r] + room && value[r] >= p->soft->bound[1][r] - room)) return false;
    }
    return true;
}

/* The longest step, at most 1, that keeps x + sign d step positive. */
static double box_reach(const double *x, const double *d, double sign, int count) {
    box_vector largest = {0};
    double limit = 1;
    for (int i = 0; i < count; i += BOX_LANES) {
        const box_vector ratio = -sign * *(const box_vector *)&d[i] / *(const box_vector *)&x[i];
        largest = (box_vector)(((box_lanes)ratio & (ratio > largest)) | ((box_lanes)largest & ~(ratio > largest)));
    }
    for (int lane = 0; lane < BOX_LANES; lane++)
        if (largest[lane] > limit) limit = largest[lane];
    return 1 / limit;
}

/* Newton's step towards the targets of the complementarities, from the factored barrier's Hessian. */
static void box_newton(box_qp *q, const box_program *p) {
    const int rows = p->soft->count;
    const double penalty = p->soft->penalty;
    box_point *x = &q->at;
    double pull[SOFT_ROWS] = {0}, moved[SOFT_ROWS];
    for (int i = 0; i < NV; i++)
        q->right[i] = -q->gradient[i] + q->target[0][i] / q->slack[0][i] - q->target[1][i] / q->slack[1][i];
    for (int side = 0; side < 2; side++)
        for (int r = 0; r < rows; r++) {
            const double price = q->slack_target[side][r] * q->per_slack[side][r];
            const double rest = q->rest_target[side][r] * q->per_excess[side][r];
            /* by which dual steps would go with no step of slack and excess */
            const double both = price - x->price[side][r] + rest - x->rest[side][r] - q->price_error[side][r];
            const double soften = penalty + x->rest[side][r] * q->per_excess[side][r];
            const double k = q->share[side][r] * (soften * q->error[side][r] - both) + price;
            pull[r] -= side ? -k : k;
        }
    if (rows) soft_combine(p->soft, pull, q->right);
    box_solve(&q->barrier, q->right, q->step);
    for (int i = 0; i < NV; i++) {
        q->dual_step[0][i] = (q->target[0][i] - q->dual[0][i] * q->step[i]) / q->slack[0][i] - q->dual[0][i];
        q->dual_step[1][i] = (q->target[1][i] + q->dual[1][i] * q->step[i]) / q->slack[1][i] - q->dual[1][i];
    }
    if (!rows) return;
    soft_values(p->soft, q->step, moved);
    for (int side = 0; side < 2; side++)
        for (int r = 0; r < rows; r++) {
            const double price = x->price[side][r], rest = x->rest[side][r];
            const double a = q->slack_target[side][r] * q->per_slack[side][r] - price;
            const double b = q->rest_target[side][r] * q->per_excess[side][r] - rest;
            const double shift = q->error[side][r] + (side ? -moved[r] : moved[r]), stiff = price * q->per_slack[side][r];
            const double step = (a + b - q->price_error[side][r] + stiff * shift) * q->per_stiffness[side][r];
            q->excess_step[side][r] = step;
            q->slack_step[side][r] = step - shift;
            q->price_step[side][r] = a - stiff * (step - shift);
            q->rest_step[side][r] = b - rest * q->per_excess[side][r] * step;
        }
}

/* The longest step that leaves everything positive. */
static double box_longest(const box_qp *q, int rows) {
    double reach = 1;
    for (int side = 0; side < 2; side++) {
        reach = fmin(reach, box_reach(q->slack[side], q->step, side ? -1 : 1, BOX_ROWS));
        reach = fmin(reach, box_reach(q->dual[side], q->dual_step[side], 1, BOX_ROWS));
        if (!rows) continue;
        reach = fmin(reach, box_reach(q->at.slack[side], q->slack_step[side], 1, rows));
        reach = fmin(reach, box_reach(q->at.excess[side], q->excess_step[side], 1, rows));
        reach = fmin(reach, box_reach(q->at.price[side], q->price_step[side], 1, rows));
        reach = fmin(reach, box_reach(q->at.rest[side], q->rest_step[side], 1, rows));
    }
    return reach;
}

/* Mean complementarity after a step of this length. */
static double box_complementarity(const box_qp *q, int rows, double length) {
    const box_point *x = &q->at;
    double sum = 0;
    for (int i = 0; i < NV; i++)
        sum += (q->slack[0][i] + length * q->step[i]) * (q->dual[0][i] + length * q->dual_step[0][i]) +
               (q->slack[1][i] - length * q->step[i]) * (q->dual[1][i] + length * q->dual_step[1][i]);
    for (int side = 0; side < 2; side++)
        for (int r = 0; r < rows; r++)
            sum += (x->slack[side][r] + length * q->slack_step[side][r]) *
                       (x->price[side][r] + length * q->price_step[side][r]) +
                   (x->excess[side][r] + length * q->excess_step[side][r]) *
                       (x->rest[side][r] + length * q->rest_step[side][r]);
    return sum / (2 * NV + 4 * rows);
}

/* Factor the barrier's Hessian. Rows that hardly change it are left out of it, not of the residual: the step is then an
 * inexact Newton step. */
static bool box_barrier(box_qp *q, const box_program *p) {
    box_factor *f = &q->barrier;
    const soft_rows *soft = p->soft;
    int vector = 0;
    double smallest = INFINITY;
    f->size = NV, f->rows = 0;
    for (int j = 0; j < NV; j++) {
        memcpy(&f->columns[j][j], p->H + j * NV + j, sizeof(double) * (size_t)(NV - j));
        smallest = fmin(smallest, f->columns[j][j]);
        f->columns[j][j] += q->dual[0][j] / q->slack[0][j] + q->dual[1][j] / q->slack[1][j];
    }
    for (int r = 0; r < soft->count; r++) {
        const double *row = soft->rows[r];
        if (!(q->weight[r] * soft->largest[r] > BOX_LIGHT * smallest)) continue;
        if (soft->end[r] - soft->start[r] <= BOX_SHORT) {
            for (int j = soft->start[r]; j < soft->end[r]; j++)
                for (int i = j; i < soft->end[r]; i++) f->columns[j][i] += q->weight[r] * row[j] * row[i];
            continue;
        }
        const double root = sqrt(q->weight[r]);
        while (vector * BOX_LANES < soft->end[r]) f->begin[vector++] = f->rows;
        for (int i = 0; i < BOX_ROWS; i += BOX_LANES)
            *(box_vector *)&f->scaled[f->rows][i] = root * *(const box_vector *)&row[i];
        f->rows++;
    }
    while (vector <= BOX_ROWS / BOX_LANES) f->begin[vector++] = f->rows;
    return box_cholesky(f);
}

static void box_clear_steps(box_qp *q) {
    memset(q->step, 0, sizeof q->step), memset(q->dual_step, 0, sizeof q->dual_step);
    memset(q->slack_step, 0, sizeof q->slack_step), memset(q->excess_step, 0, sizeof q->excess_step);
    memset(q->price_step, 0, sizeof q->price_step), memset(q->rest_step, 0, sizeof q->rest_step);
}

/* One iteration of predictor and corrector; returns false when the barrier's Hessian is not positive definite, or the
 * step not finite, as where rounding makes a slack zero. */
static bool box_iterate(box_qp *q, const box_program *p) {
    const int rows = p->soft->count;
    box_point *x = &q->at;
    if (!q->factored && !box_barrier(q, p)) return false;
    q->factored = false;
    const double present = box_complementarity(q, rows, 0);
    memset(q->target, 0, sizeof q->target);
    if (rows) memset(q->slack_target, 0, sizeof q->slack_target), memset(q->rest_target, 0, sizeof q->rest_target);
    box_newton(q, p);
    const double after = box_complementarity(q, rows, box_longest(q, rows)) / present;
    const double centre = after * after * after * present;
    for (int i = 0; i < NV; i++) {
        q->target[0][i] = centre - q->step[i] * q->dual_step[0][i];
        q->target[1][i] = centre + q->step[i] * q->dual_step[1][i];
    }
    for (int side = 0; side < 2; side++)
        for (int r = 0; r < rows; r++) {
            q->slack_target[side][r] = centre - q->slack_step[side][r] * q->price_step[side][r];
            q->rest_target[side][r] = centre - q->excess_step[side][r] * q->rest_step[side][r];
        }
    box_newton(q, p);
    const double length = BOX_STAY * box_longest(q, rows);
    if (!isfinite(box_complementarity(q, rows, length))) {
        box_clear_steps(q); /* which a next solve begins with, times zero */
        return false;
    }
    for (int i = 0; i < NV; i++) {
        x->v[i] += length * q->step[i];
        x->dual[0][i] += length * q->dual_step[0][i];
        x->dual[1][i] += length * q->dual_step[1][i];
    }
    for (int side = 0; side < 2; side++)
        for (int r = 0; r < rows; r++) {
            x->slack[side][r] += length * q->slack_step[side][r];
            x->excess[side][r] += length * q->excess_step[side][r];
            x->price[side][r] += length * q->price_step[side][r];
            x->rest[side][r] += length * q->rest_step[side][r];
        }
    return true;
}

/* The central point of complementarity mu at x->v, as far as v allows: slacks and multipliers of bounds and rows. */
static void box_centre(box_qp *q, const box_program *p, double mu) {
    const double penalty = p->soft->penalty;
    box_point *x = &q->at;
    for (int i = 0; i < NV; i++) {
        x->dual[0][i] = mu / (x->v[i] - p->lower[i]);
        x->dual[1][i] = mu / (p->upper[i] - x->v[i]);
    }
    soft_values(p->soft, x->v, q->value);
    for (int side = 0; side < 2; side++)
        for (int r = 0; r < p->soft->count; r++) {
            const double sign = side ? -1 : 1, room = sign * (p->soft->bound[side][r] - q->value[r]);
            /* the quadratic price left out: penalty slack^2 - b slack + mu room = 0, solved without cancellation */
            const double b = penalty * room + 2 * mu, root = sqrt(fmax(b * b - 4 * penalty * mu * room, 0));
            const double slack = b > 0 ? (b + root) / (2 * penalty) : 2 * mu * room / (b - root);
            const double excess = room > 0 ? mu / (penalty - mu / slack) : slack - room;
            x->slack[side][r] = slack, x->excess[side][r] = excess;
            x->price[side][r] = mu / slack, x->rest[side][r] = mu / excess;
        }
}

/* From the middle of the box, with equal complementarities; returns whether all numbers are finite. */
static bool box_start(box_qp *q, const box_program *p) {
    double mean = 0;
    for (int i = 0; i < NV; i++) q->at.v[i] = 0.5 * (p->lower[i] + p->upper[i]);
    box_gradient(p->H, p->g, q->at.v, q->gradient);
    for (int i = 0; i < NV; i++) mean += fabs(q->gradient[i]) * (p->upper[i] - p->lower[i]) / NV;
    box_centre(q, p, BOX_START * mean);
    return isfinite(mean);
}

/* Error of stationarity, feasibility of the rows and complementarity, the largest. Writes the gradient, the slacks, the
 * rows' weights, and which bounds act: those whose multiplier exceeds the slack times the curvature. */
static double box_residual(box_qp *q, const box_program *p) {
    const soft_rows *soft = p->soft;
    box_point *x = &q->at;
    double worst = 0, dual[SOFT_ROWS], slope[NV], largest = 0, finite = 0;
    for (int side = 0; side < 2; side++)
        for (int i = NV; i < BOX_ROWS; i++) q->slack[side][i] = q->dual[side][i] = 1, q->step[i] = q->dual_step[side][i] = 0;
    memcpy(q->dual[0], x->dual[0], sizeof x->dual[0]), memcpy(q->dual[1], x->dual[1], sizeof x->dual[1]);
    box_gradient(p->H, p->g, x->v, q->gradient);
    memcpy(slope, q->gradient, sizeof slope);
    q->rows_act = 0;
    if (soft->count) {
        soft_values(soft, x->v, q->value);
        for (int r = 0; r < soft->count; r++) finite += q->value[r], q->weight[r] = 0, dual[r] = x->price[0][r] - x->price[1][r];
        for (int side = 0; side < 2; side++)
            for (int r = 0; r < soft->count; r++) {
                const double per_slack = 1 / x->slack[side][r], per_excess = 1 / x->excess[side][r];
                const double sign = side ? -1 : 1, stiff = x->price[side][r] * per_slack;
                const double soften = soft->penalty + x->rest[side][r] * per_excess, per_sum = 1 / (stiff + soften);
                q->per_slack[side][r] = per_slack, q->per_excess[side][r] = per_excess;
                q->per_stiffness[side][r] = per_sum;
                q->error[side][r] = sign * (q->value[r] - soft->bound[side][r]) + x->slack[side][r] - x->excess[side][r];
                q->price_error[side][r] = soft->penalty * (1 + x->excess[side][r]) - x->price[side][r] - x->rest[side][r];
                q->share[side][r] = stiff * per_sum;
                q->weight[r] += q->share[side][r] * soften;
            }
        for (int side = 0; side < 2; side++)
            for (int r = 0; r < soft->count; r++) {
                const double a = fabs(q->error[side][r]), b = fabs(q->price_error[side][r]);
                const double c = x->slack[side][r] * x->price[side][r], d = x->excess[side][r] * x->rest[side][r];
                const double ab = a > b ? a : b, cd = c > d ? c : d, greatest = ab > cd ? ab : cd;
                largest = greatest > largest ? greatest : largest;
                q->rows_act += x->price[side][r] > x->slack[side][r];
            }
        soft_combine(soft, dual, slope);
    }
    worst = largest;
    for (int i = 0; i < NV; i++) {
        q->slack[0][i] = x->v[i] - p->lower[i], q->slack[1][i] = p->upper[i] - x->v[i];
        worst = fmax(worst, fabs(slope[i] - q->dual[0][i] + q->dual[1][i]));
        finite += slope[i]; /* fmax drops what is not a number */
        worst = fmax(worst, fmax(q->slack[0][i] * q->dual[0][i], q->slack[1][i] * q->dual[1][i]));
        const double curvature = BOX_CURVATURE * p->H[i * NV + i];
        const bool low = q->dual[0][i] > curvature * q->slack[0][i], high = q->dual[1][i] > curvature * q->slack[1][i];
        q->acts[i] = (signed char)(high - low);
    }
    return isfinite(finite) ? worst : NAN;
}

static bool box_has_room(const box_program *p) {
    for (int i = 0; i < NV; i++)
        if (!(p->upper[i] - p->lower[i] > 0 && p->upper[i] - p->lower[i] < INFINITY)) return false;
    return true;
}

/* Factor the barrier of the point to go on from, which neither g nor the rows' bounds change. */
static void box_factor_hot(box_qp *q, const box_program *p) {
    if (!q->is_hot) return;
    memcpy(&q->at, &q->hot, sizeof q->at);
    q->is_hot = isfinite(box_residual(q, p)) && box_barrier(q, p);
    q->factored = q->is_hot;
}

/* Walk towards the optimum, to a central point from which box_qp_solve will go on once g and the rows' bounds are
 * measured. Returns the number of iterations. */
static int box_qp_begin(box_qp *q, const box_program *p, int max_iterations) {
    int iterations = 0;
    q->is_hot = q->factored = false;
    if (!q->definite || !box_has_room(p) || !box_start(q, p)) return 0;
    const double hot = BOX_HOT * p->soft->penalty;
    for (;; iterations++) {
        if (!isfinite(box_residual(q, p))) break;
        memcpy(&q->hot, &q->at, sizeof q->hot), q->is_hot = true;
        if (iterations == max_iterations || box_complementarity(q, p->soft->count, 0) <= hot) break;
        if (!box_iterate(q, p)) break;
    }
    box_factor_hot(q, p);
    return iterations;
}

/* As box_qp_begin, from the optimum v (NV) itself, where nothing acts. */
static void box_qp_begin_at(box_qp *q, const box_program *p, const double *v) {
    q->is_hot = box_has_room(p);
    for (int i = 0; i < NV; i++) {
        const double margin = BOX_MARGIN * (p->upper[i] - p->lower[i]);
        q->at.v[i] = fmin(fmax(v[i], p->lower[i] + margin), p->upper[i] - margin);
    }
    box_centre(q, p, BOX_HOT * p->soft->penalty);
    memcpy(&q->hot, &q->at, sizeof q->hot);
    box_factor_hot(q, p);
}

/* v: the optimum. Returns 0; 1 when the iterations ran out, or rounding left no step: v is then the last iterate, or the one
 * that it began from where that costs less, within its bounds; 3 when the
 * problem is not one of this kind: H not positive definite, a number that is not finite, no room between two bounds.
 * tolerance: of stationarity, the rows' feasibility and complementarity. */
static int box_qp_solve(box_qp *q, const box_program *p, double tolerance, int max_iterations, double *v,
                        int *iterations) {
    *iterations = 0;
    if (!q->definite || !box_has_room(p)) return 3;
    if (q->is_hot) memcpy(&q->at, &q->hot, sizeof q->at);
    else if (!box_start(q, p)) return 3;
    for (bool tried = false;; ++*iterations) {
        const double residual = box_residual(q, p);
        const bool solved = residual <= tolerance;
        const bool settled = *iterations && !q->rows_act && !memcmp(q->acts, q->acted, sizeof q->acts);
        if (!isfinite(residual)) return 3;
        memcpy(q->acted, q->acts, sizeof q->acts);
        tried &= settled; /* the same bounds would fail again */
        if ((settled || (solved && !q->rows_act)) && !tried) {
            if (box_qp_on_bounds(q, p->H, p->g, p->lower, p->upper, tolerance, v) && box_rows_kept(p, v)) return 0;
            tried = true;
        }
        if (solved || *iterations == max_iterations || !box_iterate(q, p)) {
            const bool worse = !solved && q->is_hot && box_cost(p, q->hot.v) < box_cost(p, q->at.v);
            memcpy(v, worse ? q->hot.v : q->at.v, sizeof q->at.v);
            return solved ? 0 : 1;
        }
    }
}

#endif

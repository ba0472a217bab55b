/* A dense quadratic program whose only constraints are bounds on every variable:
 *
 *   minimise 1/2 v'Hv + g'v   subject to  lower <= v <= upper,   H positive definite.
 *
 * Call box_qp_factor first. Where no bound acts the optimum is -H^-1 g, for two triangular solves with its factor.
 * Else Mehrotra's predictor-corrector method (SIAM J. Optimization 2, 1992) starts from the middle of the box. As soon
 * as two consecutive iterations agree which bounds act, the optimum on those bounds is solved for; where it stays in the
 * box and its multipliers have the right sign it is the optimum of the program, to rounding.
 *
 * Required from the including file: NV, the number of variables, and VECTOR_BYTES. Nothing is allocated. */
#ifndef ALULA_BOX_QP_H
#define ALULA_BOX_QP_H

#include <math.h>
#include <stdbool.h>
#include <string.h>

#define BOX_LANES (VECTOR_BYTES / (int)sizeof(double))
#define BLOCK 4 /* columns that are factored at once */
#define TILE 3  /* vectors of rows that their sums are kept for in registers */
#define BOX_ROUND(n, step) (((n) + (step) - 1) / (step) * (step))
#define BOX_ROWS BOX_ROUND(BOX_ROUND(NV, BLOCK), BOX_LANES)
#define BOX_START 0.1     /* of the mean of |gradient| times width: complementarity at the start */
#define BOX_STAY 0.995    /* of the step to the nearest bound */
#define BOX_EXACT 1e-9    /* of the width: what a variable may lie over a bound by rounding */
#define BOX_CURVATURE 0.1 /* of a variable's curvature: about what remains with the others optimised out */

typedef double box_vector __attribute__((vector_size(VECTOR_BYTES)));
typedef long long box_lanes __attribute__((vector_size(VECTOR_BYTES)));

/* Lower factor by columns; behind the size come ones on the diagonal. */
typedef struct {
    double columns[BOX_ROWS][BOX_ROWS] __attribute__((aligned(64))), inverse[BOX_ROWS]; /* of the diagonal */
    int size;
} box_factor;

/* Pairs are of the lower bounds, then of the upper ones; behind NV they hold ones and steps of zero. */
typedef struct {
    box_factor free, barrier;
    double v[NV], gradient[NV], right[NV], target[2][NV];
    double step[BOX_ROWS] __attribute__((aligned(64))), dual_step[2][BOX_ROWS], slack[2][BOX_ROWS], dual[2][BOX_ROWS];
    signed char acts[NV], acted[NV]; /* -1 lower, 1 upper bound, 0 none */
    bool definite; /* whether H is, set by box_qp_factor */
} box_qp;

#define BOX_AT(f, column, row) (*(box_vector *)&(f)->columns[column][row])

/* Columns first .. first + BLOCK of a tile of rows, less the contributions of the factored columns before them. */
static inline __attribute__((always_inline)) void box_tile(box_factor *f, int first, int row, const int vectors,
                                                           box_vector sums[BLOCK][TILE]) {
    _Pragma("GCC unroll 4") for (int c = 0; c < BLOCK; c++)
        _Pragma("GCC unroll 3") for (int r = 0; r < vectors; r++)
            sums[c][r] = BOX_AT(f, first + c, row + r * BOX_LANES);
    for (int k = 0; k < first; k++)
        _Pragma("GCC unroll 3") for (int r = 0; r < vectors; r++) {
            box_vector x = BOX_AT(f, k, row + r * BOX_LANES);
            _Pragma("GCC unroll 4") for (int c = 0; c < BLOCK; c++) sums[c][r] -= f->columns[k][first + c] * x;
        }
}

/* A tile divided by the factored block on the diagonal. */
static inline __attribute__((always_inline)) void box_divide(box_factor *f, int first, int row, const int vectors,
                                                             const double corner[BLOCK][BLOCK],
                                                             box_vector sums[BLOCK][TILE]) {
    _Pragma("GCC unroll 3") for (int r = 0; r < vectors; r++)
        _Pragma("GCC unroll 4") for (int c = 0; c < BLOCK; c++) {
            _Pragma("GCC unroll 3") for (int k = 0; k < c; k++) sums[c][r] -= corner[c][k] * sums[k][r];
            sums[c][r] *= f->inverse[first + c];
            BOX_AT(f, first + c, row + r * BOX_LANES) = sums[c][r];
        }
}

/* Factor the block on the diagonal; returns whether it is positive definite. */
static bool box_diagonal(box_factor *f, int first, double corner[BLOCK][BLOCK]) {
    for (int c = 0; c < BLOCK; c++)
        for (int i = c; i < BLOCK; i++) {
            double sum = f->columns[first + c][first + i];
            for (int k = 0; k < c; k++) sum -= corner[c][k] * corner[i][k];
            if (i > c) corner[i][c] = sum * f->inverse[first + c];
            else if (!(sum > 0)) return false; /* true for what is not a number as well */
            else corner[c][c] = sqrt(sum), f->inverse[first + c] = 1 / corner[c][c];
        }
    return true;
}

/* Cholesky factor, in place, of the matrix whose lower part the columns hold. Returns whether it is positive definite. */
static bool box_cholesky(box_factor *f) {
    const int size = BOX_ROUND(f->size, BLOCK), rows = BOX_ROUND(size, BOX_LANES);
    for (int j = 0; j < size; j++) {
        const int first = j / BLOCK * BLOCK / BOX_LANES * BOX_LANES, from = j < f->size ? f->size : first;
        for (int i = first; i < j; i++) f->columns[j][i] = 0; /* else they would grow from factor to factor */
        for (int i = from; i < rows; i++) f->columns[j][i] = i == j;
    }
    for (int first = 0; first < size; first += BLOCK) {
        box_vector sums[BLOCK][TILE];
        double corner[BLOCK][BLOCK];
        int row = first / BOX_LANES * BOX_LANES; /* rows above the diagonal are computed as well and not used */
        for (int i = row; i < first + BLOCK; i += BOX_LANES) {
            box_tile(f, first, i, 1, sums);
            for (int c = 0; c < BLOCK; c++) BOX_AT(f, first + c, i) = sums[c][0];
        }
        if (!box_diagonal(f, first, corner)) return false;
        for (; row < first + BLOCK; row += BOX_LANES) {
            for (int c = 0; c < BLOCK; c++) sums[c][0] = BOX_AT(f, first + c, row);
            box_divide(f, first, row, 1, corner, sums);
        }
        for (; row + TILE * BOX_LANES <= rows; row += TILE * BOX_LANES) {
            box_tile(f, first, row, TILE, sums);
            box_divide(f, first, row, TILE, corner, sums);
        }
        for (; row < rows; row += BOX_LANES) {
            box_tile(f, first, row, 1, sums);
            box_divide(f, first, row, 1, corner, sums);
        }
    }
    return true;
}

/* x = (L L')^-1 b, x may be b. Entries not solved for yet, and those above the diagonal, are multiplied by zero. */
static void box_solve(const box_factor *f, const double *b, double *x) {
    const int size = BOX_ROUND(f->size, BLOCK), rows = BOX_ROUND(size, BOX_LANES);
    double rest[BOX_ROWS] __attribute__((aligned(64))) = {0}, solution[BOX_ROWS] __attribute__((aligned(64))) = {0};
    double half[BOX_ROWS]; /* L^-1 b */
    memcpy(rest, b, sizeof(double) * (size_t)f->size);
    for (int first = 0; first < size; first += BLOCK) {
        double *y = half + first;
        for (int c = 0; c < BLOCK; c++) {
            y[c] = rest[first + c];
            for (int k = 0; k < c; k++) y[c] -= f->columns[first + k][first + c] * y[k];
            y[c] *= f->inverse[first + c];
        }
        for (int i = (first + BLOCK) / BOX_LANES * BOX_LANES; i < rows; i += BOX_LANES) {
            box_vector sum = *(box_vector *)&rest[i];
            for (int c = 0; c < BLOCK; c++) sum -= y[c] * BOX_AT(f, first + c, i);
            *(box_vector *)&rest[i] = sum;
        }
    }
    for (int first = size - BLOCK; first >= 0; first -= BLOCK) {
        box_vector sums[BLOCK] = {{0}};
        for (int i = (first + BLOCK) / BOX_LANES * BOX_LANES; i < rows; i += BOX_LANES)
            for (int c = 0; c < BLOCK; c++) sums[c] += BOX_AT(f, first + c, i) * *(box_vector *)&solution[i];
        double z[BLOCK];
        for (int c = BLOCK - 1; c >= 0; c--) {
            z[c] = half[first + c];
            for (int lane = 0; lane < BOX_LANES; lane++) z[c] -= sums[c][lane];
            for (int k = c + 1; k < BLOCK; k++) z[c] -= f->columns[first + c][first + k] * z[k];
            z[c] *= f->inverse[first + c];
        }
        memcpy(solution + first, z, sizeof z);
    }
    memcpy(x, solution, sizeof(double) * (size_t)f->size);
}

/* Factor of H itself; returns whether H is positive definite. */
static bool box_qp_factor(box_qp *q, const double *H) {
    q->free.size = NV;
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
    f->size = free;
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

/* The longest step, at most 1, that keeps x + sign d step positive. */
static double box_reach(const double *x, const double *d, double sign) {
    box_vector largest = {0};
    double limit = 1;
    for (int i = 0; i < BOX_ROWS; i += BOX_LANES) {
        const box_vector ratio = -sign * *(const box_vector *)&d[i] / *(const box_vector *)&x[i];
        largest = (box_vector)(((box_lanes)ratio & (ratio > largest)) | ((box_lanes)largest & ~(ratio > largest)));
    }
    for (int lane = 0; lane < BOX_LANES; lane++)
        if (largest[lane] > limit) limit = largest[lane];
    return 1 / limit;
}

/* Newton's step towards the targets of the complementarities, from the factored barrier's Hessian. */
static void box_newton(box_qp *q) {
    for (int i = 0; i < NV; i++)
        q->right[i] = -q->gradient[i] + q->target[0][i] / q->slack[0][i] - q->target[1][i] / q->slack[1][i];
    box_solve(&q->barrier, q->right, q->step);
    for (int i = 0; i < NV; i++) {
        q->dual_step[0][i] = (q->target[0][i] - q->dual[0][i] * q->step[i]) / q->slack[0][i] - q->dual[0][i];
        q->dual_step[1][i] = (q->target[1][i] + q->dual[1][i] * q->step[i]) / q->slack[1][i] - q->dual[1][i];
    }
}

static double box_primal_reach(const box_qp *q) {
    return fmin(box_reach(q->slack[0], q->step, 1), box_reach(q->slack[1], q->step, -1));
}

static double box_dual_reach(const box_qp *q) {
    return fmin(box_reach(q->dual[0], q->dual_step[0], 1), box_reach(q->dual[1], q->dual_step[1], 1));
}

/* Mean complementarity after steps of these lengths. */
static double box_complementarity(const box_qp *q, double primal, double dual) {
    double sum = 0;
    for (int i = 0; i < NV; i++)
        sum += (q->slack[0][i] + primal * q->step[i]) * (q->dual[0][i] + dual * q->dual_step[0][i]) +
               (q->slack[1][i] - primal * q->step[i]) * (q->dual[1][i] + dual * q->dual_step[1][i]);
    return sum / (2 * NV);
}

/* One iteration of predictor and corrector; returns false when the barrier's Hessian is not positive definite, or the
 * step not finite, as where rounding makes a slack zero. */
static bool box_iterate(box_qp *q, const double *H) {
    box_factor *f = &q->barrier;
    f->size = NV;
    for (int j = 0; j < NV; j++) {
        memcpy(&f->columns[j][j], H + j * NV + j, sizeof(double) * (size_t)(NV - j));
        f->columns[j][j] += q->dual[0][j] / q->slack[0][j] + q->dual[1][j] / q->slack[1][j];
    }
    if (!box_cholesky(f)) return false;
    const double now = box_complementarity(q, 0, 0);
    memset(q->target, 0, sizeof q->target);
    box_newton(q);
    const double after = box_complementarity(q, box_primal_reach(q), box_dual_reach(q)) / now;
    const double centre = after * after * after * now;
    for (int i = 0; i < NV; i++) {
        q->target[0][i] = centre - q->step[i] * q->dual_step[0][i];
        q->target[1][i] = centre + q->step[i] * q->dual_step[1][i];
    }
    box_newton(q);
    const double primal = BOX_STAY * box_primal_reach(q), dual = BOX_STAY * box_dual_reach(q);
    if (!isfinite(box_complementarity(q, primal, dual))) return false;
    for (int i = 0; i < NV; i++) {
        q->v[i] += primal * q->step[i];
        q->dual[0][i] += dual * q->dual_step[0][i];
        q->dual[1][i] += dual * q->dual_step[1][i];
    }
    return true;
}

/* From the middle of the box, with equal complementarities; returns whether all numbers are finite. */
static bool box_start(box_qp *q, const double *H, const double *g, const double *lower, const double *upper) {
    double mean = 0;
    memset(q->step, 0, sizeof q->step), memset(q->dual_step, 0, sizeof q->dual_step); /* may hold non-finite values */
    for (int side = 0; side < 2; side++)
        for (int i = NV; i < BOX_ROWS; i++) q->slack[side][i] = q->dual[side][i] = 1;
    for (int i = 0; i < NV; i++) q->v[i] = 0.5 * (lower[i] + upper[i]);
    box_gradient(H, g, q->v, q->gradient);
    for (int i = 0; i < NV; i++) mean += fabs(q->gradient[i]) * (upper[i] - lower[i]) / NV;
    for (int i = 0; i < NV; i++) q->dual[0][i] = q->dual[1][i] = BOX_START * mean / (0.5 * (upper[i] - lower[i]));
    return isfinite(mean);
}

/* How far v and the multipliers are from an optimum: the largest error of stationarity and complementarity. Writes the
 * gradient, the slacks, and which bounds act: those whose multiplier exceeds the slack times the curvature. */
static double box_residual(box_qp *q, const double *H, const double *g, const double *lower, const double *upper) {
    double worst = 0;
    box_gradient(H, g, q->v, q->gradient);
    for (int i = 0; i < NV; i++) {
        q->slack[0][i] = q->v[i] - lower[i], q->slack[1][i] = upper[i] - q->v[i];
        worst = fmax(worst, fabs(q->gradient[i] - q->dual[0][i] + q->dual[1][i]));
        worst = fmax(worst, fmax(q->slack[0][i] * q->dual[0][i], q->slack[1][i] * q->dual[1][i]));
        const double slope = BOX_CURVATURE * H[i * NV + i];
        const bool low = q->dual[0][i] > slope * q->slack[0][i], high = q->dual[1][i] > slope * q->slack[1][i];
        q->acts[i] = (signed char)(high - low);
    }
    return worst;
}

/* v: the optimum. Returns 0; 1 when the iterations ran out, 3 when the problem is not one of this kind: H not positive
 * definite, a number that is not finite, no room between two bounds. tolerance: of stationarity and complementarity. */
static int box_qp_solve(box_qp *q, const double *H, const double *g, const double *lower, const double *upper,
                        double tolerance, int max_iterations, double *v, int *iterations) {
    *iterations = 0;
    for (int i = 0; i < NV; i++)
        if (!(upper[i] - lower[i] > 0 && upper[i] - lower[i] < INFINITY)) return 3;
    if (!q->definite || !box_start(q, H, g, lower, upper)) return 3;
    for (bool tried = false;; ++*iterations) {
        const bool solved = box_residual(q, H, g, lower, upper) <= tolerance;
        const bool settled = *iterations && !memcmp(q->acts, q->acted, sizeof q->acts);
        memcpy(q->acted, q->acts, sizeof q->acts);
        tried &= settled; /* the same bounds would fail again */
        if ((settled || solved) && !tried) {
            if (box_qp_on_bounds(q, H, g, lower, upper, tolerance, v)) return 0;
            tried = true;
        }
        if (solved || *iterations == max_iterations) {
            memcpy(v, q->v, sizeof q->v);
            return solved ? 0 : 1;
        }
        if (!box_iterate(q, H)) return 3;
    }
}

#endif

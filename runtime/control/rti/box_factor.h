/* Linear algebra of box_qp.h in the compiler's vectors: the Cholesky factor of a symmetric matrix plus squares of rows, and
 * products with soft rows.
 *
 * The factor is left-looking by blocks of columns, with the sums of a tile of rows in registers (Golub and Van Loan,
 * Matrix Computations, 4th edition, section 4.2); the rows' squares are added to these sums as the earlier columns are
 * taken from them, so that the matrix with them is never formed.
 *
 * Required from the including file: NV, the number of variables, SOFT, the largest number of rows, and VECTOR_BYTES. */
#ifndef ALULA_BOX_FACTOR_H
#define ALULA_BOX_FACTOR_H

#include <math.h>
#include <stdbool.h>
#include <string.h>

#define BOX_LANES (VECTOR_BYTES / (int)sizeof(double))
#define BLOCK 4 /* columns that are factored at once */
#define TILE 3  /* vectors of rows that their sums are kept for in registers */
#define BOX_ROUND(n, step) (((n) + (step) - 1) / (step) * (step))
#define BOX_ROWS BOX_ROUND(BOX_ROUND(NV, BLOCK), BOX_LANES)
#define SOFT_ROWS BOX_ROUND(SOFT + 1, BOX_LANES)

typedef double box_vector __attribute__((vector_size(VECTOR_BYTES)));
typedef long long box_lanes __attribute__((vector_size(VECTOR_BYTES)));

/* Lower factor by columns; behind the size come ones on the diagonal. */
typedef struct {
    double columns[BOX_ROWS][BOX_ROWS] __attribute__((aligned(64))), inverse[BOX_ROWS]; /* of the diagonal */
    int size, rows;
    int begin[BOX_ROWS / BOX_LANES + 1]; /* by vector of columns: the first row that reaches it */
    double scaled[SOFT_ROWS][BOX_ROWS] __attribute__((aligned(64))); /* rows whose squares are added before factoring */
} box_factor;

/* Soft rows in the order of their ends, the numbers of columns up to the last that is not zero. */
typedef struct {
    int count;
    double rows[SOFT_ROWS][BOX_ROWS] __attribute__((aligned(64))), bound[2][SOFT_ROWS]; /* upper, lower */
    double largest[SOFT_ROWS]; /* square of the row's largest entry */
    int start[SOFT_ROWS], end[SOFT_ROWS];
    double penalty;
} soft_rows;

#define BOX_AT(f, column, row) (*(box_vector *)&(f)->columns[column][row])

/* Columns first .. first + BLOCK of a tile of rows, less the contributions of the factored columns before them, plus
 * those of the soft rows. */
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
    for (int k = f->begin[row / BOX_LANES]; k < f->rows; k++)
        _Pragma("GCC unroll 3") for (int r = 0; r < vectors; r++) {
            box_vector x = *(box_vector *)&f->scaled[k][row + r * BOX_LANES];
            _Pragma("GCC unroll 4") for (int c = 0; c < BLOCK; c++) sums[c][r] += f->scaled[k][first + c] * x;
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

/* Values of the rows at v. */
static void soft_values(const soft_rows *soft, const double *v, double *value) {
    double padded[BOX_ROWS] __attribute__((aligned(64))) = {0};
    memcpy(padded, v, sizeof(double) * NV);
    for (int r = 0; r < soft->count; r++) {
        box_vector sum = {0};
        for (int i = 0; i < soft->end[r]; i += BOX_LANES)
            sum += *(const box_vector *)&soft->rows[r][i] * *(const box_vector *)&padded[i];
        double total = 0;
        for (int lane = 0; lane < BOX_LANES; lane++) total += sum[lane];
        value[r] = total;
    }
}

/* out += the rows' sum, each times its factor. */
static void soft_combine(const soft_rows *soft, const double *factor, double *out) {
    double sum[BOX_ROWS] __attribute__((aligned(64))) = {0};
    for (int r = 0; r < soft->count; r++)
        for (int i = 0; i < soft->end[r]; i += BOX_LANES)
            *(box_vector *)&sum[i] += factor[r] * *(const box_vector *)&soft->rows[r][i];
    for (int i = 0; i < NV; i++) out[i] += sum[i];
}

#endif

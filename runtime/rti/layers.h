/* The arithmetic of the network kernel: layers forward, one column at a time; many rows times a small packed matrix.
 *
 * Vectors are GCC's, VECTOR_BYTES wide; the compiler turns them into AVX-512, AVX2, SSE2 or NEON. Functions marked
 * INLINE get their dimensions as constants, so that each use is a kernel of its own with its sums in registers. */
#ifndef ALULA_LAYERS_H
#define ALULA_LAYERS_H

#include <string.h>

#define LANES (VECTOR_BYTES / (int)sizeof(real))
#define PAD(n) (((n) + LANES - 1) / LANES * LANES)
#define INLINE static inline __attribute__((always_inline))
#define UNROLL _Pragma("GCC unroll 16")

typedef real vector __attribute__((vector_size(VECTOR_BYTES)));

/* Rows of a block's output and vectors along its columns that fit the registers: 32 of them, or 16. */
#if VECTOR_BYTES == 64 || defined(__aarch64__)
#define BLOCK_ROWS 12
#else
#define BLOCK_ROWS 6
#endif
#define BLOCK_VECTORS 2

/* The entries above zero of a ReLU's output; only these let tangents through. */
typedef struct {
    unsigned char count, index[WIDEST + 1];
} active_set;

INLINE void find_active(active_set *set, int entries, const real *values) {
    int count = 0;
    for (int i = 0; i < entries; i++) {
        set->index[count] = (unsigned char)i;
        count += values[i] > 0;
    }
    set->count = (unsigned char)count;
}

/* sums += x' W over `inputs` rows of W (inputs, 16 n); partial sums side by side, so that additions do not wait. */
INLINE void accumulate(const int inputs, const int outputs, const int partial, const real *W, const real *x,
                       vector *sums) {
    const int vectors = outputs / LANES;
    for (int i = 0; i < inputs; i++) {
        vector *sum = sums + (i % partial) * vectors;
        UNROLL for (int v = 0; v < vectors; v++) sum[v] += x[i] * ((const vector *)(W + i * outputs))[v];
    }
}

/* y = max(0, sums + b), or without max. */
INLINE void finish(const int outputs, const int partial, const vector *sums, const real *b, const int rectify,
                   real *y) {
    const int vectors = outputs / LANES;
    UNROLL for (int v = 0; v < vectors; v++) {
        vector sum = ((const vector *)b)[v];
        UNROLL for (int part = 0; part < partial; part++) sum += sums[part * vectors + v];
        if (rectify) sum = (vector)((__typeof__(sum > 0))sum & (sum > 0));
        ((vector *)y)[v] = sum;
    }
}

/* As many partial sums as hide the additions' latency in eight registers. */
#define PARTIAL(outputs) ((outputs) / LANES >= 8 ? 1 : (outputs) / LANES >= 4 ? 2 : 4)

INLINE void dense(const int inputs, const int outputs, const int rectify, const real *W, const real *b, const real *x,
                  real *y) {
    vector sums[PARTIAL(outputs) * outputs / LANES];
    memset(sums, 0, sizeof sums);
    accumulate(inputs, outputs, PARTIAL(outputs), W, x, sums);
    finish(outputs, PARTIAL(outputs), sums, b, rectify, y);
}

/* y = ReLU(b + sum over taps of x[-tap * dilation]' W[tap]); tap 0 is the newest column, columns lie `width` apart. */
INLINE void convolve(const int inputs, const int outputs, const int taps, const int dilation, const int width,
                     const real *W, const real *b, const real *x, real *y) {
    vector sums[PARTIAL(outputs) * outputs / LANES];
    memset(sums, 0, sizeof sums);
    for (int tap = 0; tap < taps; tap++)
        accumulate(inputs, outputs, PARTIAL(outputs), W + tap * inputs * outputs, x - tap * dilation * width, sums);
    finish(outputs, PARTIAL(outputs), sums, b, 1, y);
}

/* packed = the entries of w (16 n) that are in the set. */
INLINE void pack(const int entries, const real *w, const active_set *set, real *packed) {
    for (int o = 0; o < set->count; o++) packed[o] = w[set->index[o]];
    (void)entries;
}

/* out (rows, inputs) = J (rows, outputs) D W, D the ReLU's mask and W (outputs, inputs): one layer of a reverse sweep. */
INLINE void reverse(const int rows, const int inputs, const int stride, const active_set *set, const real *J,
                    const real *W, real *out) {
    const int vectors = inputs / LANES % 4 == 0 && BLOCK_ROWS == 12 ? 4 : inputs / LANES % 2 == 0 ? 2 : 1;
    for (int c = 0; c < inputs; c += vectors * LANES) {
        vector sums[4][6];
        memset(sums, 0, sizeof sums);
        for (int q = 0; q < set->count; q++) {
            const int o = set->index[q];
            const vector *w = (const vector *)(W + o * inputs + c);
            UNROLL for (int v = 0; v < vectors; v++)
                UNROLL for (int r = 0; r < rows; r++) sums[v][r] += J[r * stride + o] * w[v];
        }
        UNROLL for (int v = 0; v < vectors; v++)
            UNROLL for (int r = 0; r < rows; r++) ((vector *)(out + r * stride + c))[v] = sums[v][r];
    }
}

INLINE void block(const int outs, const int vectors, int count, const real *const *rows, const real *weights,
                  int stride, int c, real *const *out) {
    vector sums[BLOCK_ROWS][BLOCK_VECTORS];
    UNROLL for (int o = 0; o < outs; o++) UNROLL for (int v = 0; v < vectors; v++) sums[o][v] = (vector){0};
    for (int i = 0; i < count; i++) {
        const vector *x = (const vector *)(rows[i] + c);
        const real *w = weights + i * stride;
        UNROLL for (int o = 0; o < outs; o++) UNROLL for (int v = 0; v < vectors; v++) sums[o][v] += w[o] * x[v];
    }
    UNROLL for (int o = 0; o < outs; o++)
        UNROLL for (int v = 0; v < vectors; v++) ((vector *)(out[o] + c))[v] = sums[o][v];
}

INLINE void block_row(const int outs, int count, const real *const *rows, const real *weights, int stride, int columns,
                      real *const *out) {
    int c = 0;
    for (; c + BLOCK_VECTORS * LANES <= columns; c += BLOCK_VECTORS * LANES)
        block(outs, BLOCK_VECTORS, count, rows, weights, stride, c, out);
    if (c < columns) block(outs, 1, count, rows, weights, stride, c, out);
}

/* out[o][c] = sum over i < count of weights[i][o] rows[i][c], for c < columns, a multiple of LANES. */
static void multiply(int outs, int count, const real *const *rows, const real *weights, int stride, int columns,
                     real *const *out) {
    int blocks = (outs + BLOCK_ROWS - 1) / BLOCK_ROWS;
    for (int b = 0, first = 0; b < blocks; b++) {
        int size = (outs - first) / (blocks - b); /* as even as can be: a block of one row waits for itself */
#define BLOCK_OF(n) \
    case n: block_row(n, count, rows, weights + first, stride, columns, out + first); break;
        switch (size) {
            BLOCK_OF(1) BLOCK_OF(2) BLOCK_OF(3) BLOCK_OF(4) BLOCK_OF(5) BLOCK_OF(6)
#if BLOCK_ROWS == 12
            BLOCK_OF(7) BLOCK_OF(8) BLOCK_OF(9) BLOCK_OF(10) BLOCK_OF(11) BLOCK_OF(12)
#endif
        }
        first += size;
    }
}

#endif

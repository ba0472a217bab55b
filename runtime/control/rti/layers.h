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
typedef NETWORK_INTEGER lane_numbers __attribute__((vector_size(VECTOR_BYTES))); /* as wide as real */
typedef unsigned char lane_bytes __attribute__((vector_size(LANES)));

#ifdef COUNT_OPERATIONS
static double operations; /* multiplications and additions of floats so far */
#define COUNT(products) (operations += 2.0 * (products))
#else
#define COUNT(products) ((void)0)
#endif

/* Rows of a block's output and vectors along its columns that fit the registers: 32 of them, or 16. */
#if VECTOR_BYTES == 64 || defined(__aarch64__)
#define BLOCK_ROWS 12
#else
#define BLOCK_ROWS 6
#endif
#define BLOCK_VECTORS 2

/* The entries above zero of a ReLU's output; only these pass tangents on. Where registers can be permuted, a row of
 * weights is packed vector by vector: `order` moves a vector's active lanes to its front, `start` is where they go. */
#define PERMUTES (VECTOR_BYTES >= 32)
typedef struct {
    unsigned char count, index[MAX_WIDTH + LANES];
#if PERMUTES
    unsigned char start[MAX_WIDTH / LANES];
    lane_numbers order[MAX_WIDTH / LANES];
#endif
} active_set;

INLINE int list_active(const int entries, const real *values, unsigned char *index) {
    int count = 0;
    UNROLL for (int i = 0; i < entries; i++) {
        index[count] = (unsigned char)i;
        count += values[i] > 0;
    }
    return count;
}

INLINE void find_active(active_set *set, const int entries, const real *values) {
    int count = 0;
    UNROLL for (int v = 0; v < entries / LANES; v++) {
        int more = list_active(LANES, values + v * LANES, set->index + count);
#if PERMUTES
        lane_bytes lanes;
        memcpy(&lanes, set->index + count, sizeof lanes);
        set->order[v] = __builtin_convertvector(lanes, lane_numbers); /* entries behind the active ones are not used */
        set->start[v] = (unsigned char)count;
#endif
        for (int q = 0; v && q < more; q++) set->index[count + q] += (unsigned char)(v * LANES);
        count += more;
    }
    set->count = (unsigned char)count;
}

/* sums += x' W over `inputs` rows of W (inputs, 16 n); partial sums side by side, so that additions do not wait. */
INLINE void accumulate(const int inputs, const int outputs, const int partial, const real *W, const real *x,
                       vector *sums) {
    const int vectors = outputs / LANES;
#define ADD(i, part) \
    UNROLL for (int v = 0; v < vectors; v++) \
        sums[(part) * vectors + v] += x[i] * ((const vector *)(W + (i) * outputs))[v];
    int i = 0;
    UNROLL for (; i + partial <= inputs; i += partial) UNROLL for (int part = 0; part < partial; part++) { ADD(i + part, part) }
    UNROLL for (; i < inputs; i++) { ADD(i, i % partial) }
#undef ADD
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
#define PARTIAL(outputs) ((outputs) / LANES >= 8 ? 1 : 8 / ((outputs) / LANES))

INLINE void dense(const int inputs, const int outputs, const int rectify, const real *W, const real *b, const real *x,
                  real *y) {
    COUNT(inputs * outputs);
    vector sums[PARTIAL(outputs) * outputs / LANES];
    memset(sums, 0, sizeof sums);
    accumulate(inputs, outputs, PARTIAL(outputs), W, x, sums);
    finish(outputs, PARTIAL(outputs), sums, b, rectify, y);
}

/* y = ReLU(b + sum over taps of x[-tap * dilation]' W[tap]); tap 0 is the newest column, columns lie `width` apart. */
INLINE void convolve(const int inputs, const int outputs, const int taps, const int dilation, const int width,
                     const real *W, const real *b, const real *x, real *y) {
    COUNT(taps * inputs * outputs);
    vector sums[PARTIAL(outputs) * outputs / LANES];
    memset(sums, 0, sizeof sums);
    UNROLL for (int tap = 0; tap < taps; tap++)
        accumulate(inputs, outputs, PARTIAL(outputs), W + tap * inputs * outputs, x - tap * dilation * width, sums);
    finish(outputs, PARTIAL(outputs), sums, b, 1, y);
}

/* packed = those entries of w that are in the set; up to a vector behind them is written as well. */
INLINE void pack(const int entries, const real *w, const active_set *set, real *packed) {
#if PERMUTES
    UNROLL for (int v = 0; v < entries / LANES; v++) {
        vector moved = __builtin_shuffle(((const vector *)w)[v], set->order[v]);
        memcpy(packed + set->start[v], &moved, sizeof moved);
    }
#else
    (void)entries;
    for (int o = 0; o < set->count; o++) packed[o] = w[set->index[o]];
#endif
}

/* out (rows, inputs) = J (rows, outputs) D W, D the ReLU's mask and W (outputs, inputs): one layer of a reverse sweep. */
INLINE void reverse(const int rows, const int inputs, const int outputs, int active, const unsigned char *index,
                    const real *J, const real *W, real *out) {
    COUNT(rows * inputs * active);
    const int vectors = inputs / LANES % 4 == 0 && BLOCK_ROWS == 12 ? 4 : inputs / LANES % 2 == 0 ? 2 : 1;
    for (int c = 0; c < inputs; c += vectors * LANES) {
        vector sums[4][6];
        memset(sums, 0, sizeof sums);
        for (int q = 0; q < active; q++) {
            const int o = index[q];
            const vector *w = (const vector *)(W + o * inputs + c);
            UNROLL for (int v = 0; v < vectors; v++)
                UNROLL for (int r = 0; r < rows; r++) sums[v][r] += J[r * outputs + o] * w[v];
        }
        UNROLL for (int v = 0; v < vectors; v++)
            UNROLL for (int r = 0; r < rows; r++) ((vector *)(out + r * inputs + c))[v] = sums[v][r];
    }
}

INLINE void block(const int outs, const int vectors, int count, const real *const *rows, const real *const *weights,
                  const int spread, int first, int c, real *const *out) {
    vector sums[BLOCK_ROWS][BLOCK_VECTORS];
    UNROLL for (int o = 0; o < outs; o++) UNROLL for (int v = 0; v < vectors; v++) sums[o][v] = (vector){0};
    for (int i = 0; i < count; i++) {
        const vector *x = (const vector *)(rows[i] + c);
        const real *w = weights[i] + first * spread;
        UNROLL for (int o = 0; o < outs; o++)
            UNROLL for (int v = 0; v < vectors; v++) sums[o][v] += w[o * spread] * x[v];
    }
    UNROLL for (int o = 0; o < outs; o++)
        UNROLL for (int v = 0; v < vectors; v++) ((vector *)(out[first + o] + c))[v] = sums[o][v];
}

/* out[first + o][c] = sum over i < count of weights[i][(first + o) spread] rows[i][c], for c < columns, a multiple of
 * LANES. */
INLINE void block_row(const int outs, int count, const real *const *rows, const real *const *weights, const int spread,
                      int first, int columns, real *const *out) {
    COUNT(outs * count * columns);
    int c = 0;
    for (; c + BLOCK_VECTORS * LANES <= columns; c += BLOCK_VECTORS * LANES)
        block(outs, BLOCK_VECTORS, count, rows, weights, spread, first, c, out);
    if (c < columns) block(outs, 1, count, rows, weights, spread, first, c, out);
}

/* out[o][c] = sum over i < count of weights[i][o] rows[i][c], for o < outs. */
static void multiply(int outs, int count, const real *const *rows, const real *const *weights, int columns,
                     real *const *out) {
    int blocks = (outs + BLOCK_ROWS - 1) / BLOCK_ROWS;
    for (int b = 0, first = 0; b < blocks; b++) {
        int size = (outs - first) / (blocks - b); /* as even as can be: a block of one row waits for itself */
#define BLOCK_OF(n) \
    case n: block_row(n, count, rows, weights, 1, first, columns, out); break;
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

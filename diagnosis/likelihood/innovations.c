/* Innovations of a filter with a constant gain, for many inputs at once: the data's first, then one for each parameter.

   nu(t) = D(t) - C(t) x(t),   x(t+1) = A(t) x(t) + B(t) + K nu(t)        (Anderson and Moore, Optimal Filtering, ch. 5)

   A and C are constant and sparse but for the rigid body's own block, which is dense and changes from row to row, and
   for entries that are proportional to the specific force and the body rate of the row. Columns do not depend on each
   other: they go through a few rows in groups whose states fit into the nearest cache and whose sums stay in registers. */
#include <stddef.h>
#include <stdint.h>
#include <string.h>

/* A vector is as wide as the processor's: GCC keeps a wider one in memory, and each sum waits for its store.
   WIDE: vectors of a group of columns, whose sums fill half of the registers. */
#if defined(__AVX512F__)
#define LANES 8
#define WIDE 4
#elif defined(__AVX__)
#define LANES 4
#define WIDE 8
#else
#define LANES 2
#define WIDE 8
#endif
#define LINE 8 /* numbers of a cache line */
#define RIGID 9
#define ROWS 4 /* that a group of columns goes through while its states are near */
typedef double lanes __attribute__((vector_size(LANES * sizeof(double))));

/* Rows of a sparse matrix one after another: of row i the entries first[i] to first[i + 1]. which: of the conditions
   that multiplies an entry; null where none does. */
typedef struct {
    const int *first, *column, *which;
    const double *value;
} sparse;

/* A_rigid (N, 9, 9), C_rigid (N, m, 9); A, C, turning beside these. conditions (N, 6). K (n, m). W (m, m) lower
   triangular: what is returned is W nu. B (N, inputs, k), D (N, m, k): inputs of the first states, and of readings.
   out (N, m, k). path: (N, n) states of the first column, or null. */
typedef struct {
    int rows, states, readings, columns, inputs;
    const double *A_rigid, *C_rigid;
    sparse A, C, turning;
    const double *conditions, *K, *W, *B, *D;
    double *out, *path;
} problem;

static inline int smaller(int a, int b)
{
    return a < b ? a : b;
}

/* Fetch numbers in their order: groups of columns then read them out of it. */
static inline void near(const double *from, size_t count)
{
    for (size_t i = 0; i < count; i += LINE) __builtin_prefetch(from + i);
}

/* GROUP vectors of columns. */
#define DEFINE_PASS(NAME, GROUP)                                                                                       \
    typedef struct {                                                                                                   \
        lanes of[GROUP];                                                                                               \
    } group_##NAME;                                                                                                    \
                                                                                                                       \
    static inline group_##NAME read_##NAME(const double *from, int count)                                              \
    {                                                                                                                  \
        group_##NAME made;                                                                                             \
        if (count == GROUP * LANES) {                                                                                  \
            memcpy(&made, from, sizeof made);                                                                          \
            return made;                                                                                               \
        }                                                                                                              \
        memset(&made, 0, sizeof made);                                                                                 \
        memcpy(&made, from, (size_t)count * sizeof(double));                                                           \
        return made;                                                                                                   \
    }                                                                                                                  \
                                                                                                                       \
    static inline void add_##NAME(group_##NAME *to, double factor, const group_##NAME *from)                           \
    {                                                                                                                  \
        for (int g = 0; g < GROUP; g++) to->of[g] += factor * from->of[g];                                             \
    }                                                                                                                  \
                                                                                                                       \
    static inline void add_row_##NAME(group_##NAME *to, double sign, const sparse *M, int row,                         \
                                       const double *conditions, const group_##NAME *x)                                \
    {                                                                                                                  \
        for (int e = M->first[row]; e < M->first[row + 1]; e++)                                                        \
            add_##NAME(to, sign * M->value[e] * (M->which ? conditions[M->which[e]] : 1.0), x + M->column[e]);         \
    }                                                                                                                  \
                                                                                                                       \
    /* Columns begin to begin + count of row t, from states `now` to `next`. nu: m groups of space. */                 \
    static inline void row_##NAME(const problem *p, int t, int begin, int count, const group_##NAME *now,              \
                                   group_##NAME *next, group_##NAME *nu)                                               \
    {                                                                                                                  \
        const int n = p->states, m = p->readings;                                                                      \
        const size_t k = (size_t)p->columns;                                                                           \
        const double *block = p->A_rigid + (size_t)RIGID * RIGID * t;                                                  \
        const double *reading = p->C_rigid + (size_t)RIGID * m * t, *c = p->conditions + (size_t)6 * t;                \
        const double *B = p->B + k * p->inputs * t + begin, *D = p->D + k * m * t + begin;                             \
        double *out = p->out + k * m * t + begin;                                                                      \
        for (int i = 0; i < m; i++) {                                                                                  \
            group_##NAME sum = read_##NAME(D + k * i, count);                                                          \
            for (int j = 0; j < RIGID; j++) add_##NAME(&sum, -reading[RIGID * i + j], now + j);                        \
            add_row_##NAME(&sum, -1.0, &p->C, i, c, now);                                                              \
            nu[i] = sum;                                                                                               \
        }                                                                                                              \
        for (int i = 0; i < m; i++) {                                                                                  \
            group_##NAME sum;                                                                                          \
            memset(&sum, 0, sizeof sum);                                                                               \
            for (int j = 0; j <= i; j++) add_##NAME(&sum, p->W[m * i + j], nu + j);                                    \
            memcpy(out + k * i, &sum, (size_t)count * sizeof(double));                                                 \
        }                                                                                                              \
        for (int i = 0; i < n; i++) {                                                                                  \
            group_##NAME sum;                                                                                          \
            memset(&sum, 0, sizeof sum);                                                                               \
            if (i < p->inputs) sum = read_##NAME(B + k * i, count);                                                    \
            if (i < RIGID)                                                                                             \
                for (int j = 0; j < RIGID; j++) add_##NAME(&sum, block[RIGID * i + j], now + j);                       \
            add_row_##NAME(&sum, 1.0, &p->A, i, c, now);                                                               \
            add_row_##NAME(&sum, 1.0, &p->turning, i, c, now);                                                         \
            for (int j = 0; j < m; j++) add_##NAME(&sum, p->K[m * i + j], nu + j);                                     \
            next[i] = sum;                                                                                             \
        }                                                                                                              \
    }                                                                                                                  \
                                                                                                                       \
    /* x (n, k): state, in and out. space: 2 n groups for each group of columns, and m more. */                        \
    static void pass_##NAME(const problem *p, double *x, group_##NAME *space)                                          \
    {                                                                                                                  \
        const int n = p->states, k = p->columns, width = GROUP * LANES, groups = (k + width - 1) / width;              \
        group_##NAME *now = space, *next = space + n * groups, *nu = space + 2 * n * groups;                           \
        for (int g = 0; g < groups; g++)                                                                               \
            for (int i = 0; i < n; i++)                                                                                \
                now[n * g + i] = read_##NAME(x + k * i + width * g, smaller(width, k - width * g));                    \
        for (int first = 0; first < p->rows; first += ROWS) {                                                          \
            const int last = smaller(first + ROWS, p->rows);                                                           \
            near(p->B + (size_t)k * p->inputs * first, (size_t)k * p->inputs * (last - first));                        \
            near(p->D + (size_t)k * p->readings * first, (size_t)k * p->readings * (last - first));                    \
            for (int g = 0; g < groups; g++) {                                                                         \
                group_##NAME *here = now + n * g, *there = next + n * g;                                               \
                for (int t = first; t < last; t++) {                                                                   \
                    if (p->path && g == 0)                                                                             \
                        for (int i = 0; i < n; i++) p->path[(size_t)n * t + i] = here[i].of[0][0];                     \
                    row_##NAME(p, t, width * g, smaller(width, k - width * g), here, there, nu);                       \
                    group_##NAME *swapped = here;                                                                      \
                    here = there;                                                                                      \
                    there = swapped;                                                                                   \
                }                                                                                                      \
            }                                                                                                          \
            if ((last - first) % 2) {                                                                                  \
                group_##NAME *swapped = now;                                                                           \
                now = next;                                                                                            \
                next = swapped;                                                                                        \
            }                                                                                                          \
        }                                                                                                              \
        for (int g = 0; g < groups; g++)                                                                               \
            for (int i = 0; i < n; i++)                                                                                \
                memcpy(x + k * i + width * g, now + n * g + i, (size_t)smaller(width, k - width * g) * sizeof(double));\
    }

DEFINE_PASS(narrow, 1)
DEFINE_PASS(wide, WIDE)

/* x (n, k): state, in and out. space: (2 n + m) (k + 32) + 8 numbers. */
void innovations(int rows, int states, int readings, int columns, int inputs, const double *A_rigid,
                 const double *C_rigid, const int *first_A, const int *column_A, const double *value_A,
                 const int *first_C, const int *column_C, const double *value_C, const int *first_turning,
                 const int *column_turning, const int *which, const double *value_turning, const double *conditions,
                 const double *K, const double *W, const double *B, const double *D, double *x, void *space,
                 double *out, double *path)
{
    const problem p = {
        .rows = rows, .states = states, .readings = readings, .columns = columns, .inputs = inputs,
        .A_rigid = A_rigid, .C_rigid = C_rigid, .A = {first_A, column_A, NULL, value_A},
        .C = {first_C, column_C, NULL, value_C}, .turning = {first_turning, column_turning, which, value_turning},
        .conditions = conditions, .K = K, .W = W, .B = B, .D = D, .out = out, .path = path,
    };
    void *groups = (void *)(((uintptr_t)space + sizeof(lanes) - 1) / sizeof(lanes) * sizeof(lanes));
    if (columns > 2 * LANES)
        pass_wide(&p, x, groups);
    else
        pass_narrow(&p, x, groups);
}

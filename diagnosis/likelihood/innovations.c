/* Innovations of a filter with a constant gain, for many inputs at once: the data's first, then one for each parameter.

   nu(t) = D(t) - C(t) x(t),   x(t+1) = A(t) x(t) + B(t) + K nu(t)        (Anderson and Moore, Optimal Filtering, ch. 5)

   A and C are constant (in triplets) but for the rigid body's own block, which is dense and changes from row to row,
   and for entries that are proportional to the specific force and the body rate of the row. Columns are contiguous. */
#include <stddef.h>
#include <string.h>

#define RIGID 9

typedef struct {
    const int *row, *column;
    const double *value;
    int count;
} triplets;

static void add(double *restrict to, double factor, const double *restrict from, int columns)
{
    for (int j = 0; j < columns; j++) to[j] += factor * from[j];
}

/* rows, states, readings, columns, inputs: N, n, m, k, and how many of the first states have an input.
   A_rigid (N, 9, 9), C_rigid (N, m, 9). A, C: constant triplets beside these. turning: triplets of A whose value is
   times conditions[t][which]. conditions (N, 6). K (n, m). W (m, m) lower triangular: what is returned is W nu.
   B (N, inputs, k), D (N, m, k). x (n, k): state, in and out. next (n, k), nu (m, k): space.
   out (N, m, k). path: (N, n) states of the first column, or null. */
void innovations(int rows, int states, int readings, int columns, int inputs, const double *A_rigid,
                 const double *C_rigid, int count_A, const int *row_A, const int *column_A, const double *value_A,
                 int count_C, const int *row_C, const int *column_C, const double *value_C, int count_turning,
                 const int *row_turning, const int *column_turning, const int *which, const double *value_turning,
                 const double *conditions, const double *K, const double *W, const double *B, const double *D,
                 double *x, double *next, double *nu, double *out, double *path)
{
    const size_t width = (size_t)columns, bytes = width * sizeof(double);
    for (int t = 0; t < rows; t++) {
        const double *block = A_rigid + (size_t)81 * t, *reading = C_rigid + (size_t)RIGID * readings * t;
        const double *c = conditions + (size_t)6 * t;
        if (path)
            for (int i = 0; i < states; i++) path[(size_t)states * t + i] = x[width * i];
        memcpy(nu, D + width * readings * t, bytes * readings);
        for (int i = 0; i < readings; i++)
            for (int j = 0; j < RIGID; j++)
                if (reading[RIGID * i + j] != 0) add(nu + width * i, -reading[RIGID * i + j], x + width * j, columns);
        for (int e = 0; e < count_C; e++) add(nu + width * row_C[e], -value_C[e], x + width * column_C[e], columns);
        memcpy(next, B + width * inputs * t, bytes * inputs);
        memset(next + width * inputs, 0, bytes * (states - inputs));
        for (int i = 0; i < RIGID; i++)
            for (int j = 0; j < RIGID; j++)
                if (block[RIGID * i + j] != 0) add(next + width * i, block[RIGID * i + j], x + width * j, columns);
        for (int e = 0; e < count_A; e++) add(next + width * row_A[e], value_A[e], x + width * column_A[e], columns);
        for (int e = 0; e < count_turning; e++)
            add(next + width * row_turning[e], value_turning[e] * c[which[e]], x + width * column_turning[e], columns);
        for (int i = 0; i < states; i++)
            for (int j = 0; j < readings; j++)
                if (K[readings * i + j] != 0) add(next + width * i, K[readings * i + j], nu + width * j, columns);
        double *white = out + width * readings * t;
        memset(white, 0, bytes * readings);
        for (int i = 0; i < readings; i++)
            for (int j = 0; j <= i; j++)
                if (W[readings * i + j] != 0) add(white + width * i, W[readings * i + j], nu + width * j, columns);
        memcpy(x, next, bytes * states);
    }
}

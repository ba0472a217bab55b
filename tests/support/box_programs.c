/* A program in a box solved by box_qp.h and by HPIPM, what is prepared before a tick left out of the time. */
#include <time.h>

#include "box_qp.h"
#include "dense_qp.h"

static box_qp ours __attribute__((aligned(64)));

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* Whether the optimum without bounds lies inside of them. */
int free_optimum(const double *H, const double *g, const double *lower, const double *upper, double *v) {
    box_qp_factor(&ours, H);
    return box_qp_free_optimum(&ours, g, lower, upper, v);
}

int by_box_qp(const double *H, const double *g, const double *lower, const double *upper, double tolerance, int most,
              double *v, int *iterations, double *seconds) {
    box_qp_factor(&ours, H);
    const double start = now();
    const int status = box_qp_solve(&ours, H, g, lower, upper, tolerance, most, v, iterations);
    *seconds = now() - start;
    return status;
}

int by_hpipm(double *H, double *g, double *lower, double *upper, double tolerance, int most, double *v, int *iterations,
             double *seconds) {
    dense_qp *p = dense_qp_create(V, 0, tolerance, most, 0);
    d_dense_qp_set_H(H, &p->qp), d_dense_qp_set_g(g, &p->qp);
    d_dense_qp_set_lb(lower, &p->qp), d_dense_qp_set_ub(upper, &p->qp);
    const double start = now();
    const int status = dense_qp_solve(p, v, iterations);
    *seconds = now() - start;
    dense_qp_free(p);
    return status;
}

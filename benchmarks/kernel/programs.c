/* A preparation's quadratic program, solved for many seeded states: what each takes of the processor, and whether its answer
 * can be flown. Compiled with the kernel's own sources, of which it reads the memory. */
#include "rti.c"

#define GROUPS 7
#define TIME_BINS 2000 /* of 1 us; the last one holds what takes longer */
#define ITERATION_BINS 64
#define TRIES 5 /* of a slow one, the shortest counts: another program or an interrupt is not in all of them */
#define SLOW 1.35 /* times the median of as many iterations */
#define FOLLOWING 0.005 /* of itself, by which the median moves with each program */

/* Counts by group of acting rows; times are this thread's processor time, s. */
typedef struct {
    long long times[GROUPS][TIME_BINS], steps[2 * TIME_BINS], iterations[GROUPS][ITERATION_BINS];
    long long programs[GROUPS], cut[GROUPS], failed, infeasible, differing;
    double once[GROUPS], worst[GROUPS]; /* the slowest at its first try, and by its shortest try */
    double worst_step, median[ITERATION_BINS];
    int max_rows, max_iterations;
} programs_report;

typedef struct {
    double columns[BOX_ROWS][BOX_ROWS], inverse[BOX_ROWS], x[NODES + 1][NX], u[NODES][NU];
    int size;
    bool factored;
} prepared_state;

static prepared_state prepared;

static double used(void) {
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* splitmix64 (Steele, Lea, Flood, OOPSLA 2014), and normal deviates by Box and Muller. */
static double uniform(unsigned long long *seed) {
    unsigned long long z = *seed += 0x9e3779b97f4a7c15ull;
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ull, z = (z ^ (z >> 27)) * 0x94d049bb133111ebull;
    return ((double)((z ^ (z >> 31)) >> 11) + 0.5) / 9007199254740992.0;
}

static double normal(unsigned long long *seed) {
    const double radius = sqrt(-2 * log(uniform(seed)));
    return radius * cos(2 * M_PI * uniform(seed));
}

static void keep(const condensed *r) {
    memcpy(prepared.columns, r->box.barrier.columns, sizeof prepared.columns);
    memcpy(prepared.inverse, r->box.barrier.inverse, sizeof prepared.inverse);
    memcpy(prepared.x, r->x, sizeof prepared.x), memcpy(prepared.u, r->u, sizeof prepared.u);
    prepared.size = r->box.barrier.size, prepared.factored = r->box.factored;
}

static void restore(condensed *r) {
    memcpy(r->box.barrier.columns, prepared.columns, sizeof prepared.columns);
    memcpy(r->box.barrier.inverse, prepared.inverse, sizeof prepared.inverse);
    memcpy(r->x, prepared.x, sizeof prepared.x), memcpy(r->u, prepared.u, sizeof prepared.u);
    r->box.barrier.size = prepared.size, r->box.factored = prepared.factored;
}

/* Whether the inputs lie in their box, but for rounding, and nothing is other than finite. */
static bool can_be_flown(const condensed *r) {
    for (int i = 0; i < NV; i++) {
        const double v = r->z[X0 + i], room = BOX_EXACT * (r->upper[i] - r->lower[i]);
        if (!(v >= r->lower[i] - room && v <= r->upper[i] + room)) return false;
    }
    return finite_all(&r->x[0][0], (NODES + 1) * NX) && finite_all(&r->u[0][0], NV);
}

static double feedback_time(condensed *r, const double *x) {
    restore(r);
    const double start = used();
    rti_feedback(r, x);
    return used() - start;
}

static double preparation_time(rti *r, const double *x, const double *x_reference, const double *u_reference) {
    double shortest = INFINITY;
    for (int again = 0; again < TRIES; again++) {
        const double start = used();
        rti_prepare(r, x, x_reference, u_reference);
        shortest = fmin(shortest, used() - start);
    }
    return shortest;
}

/* Prepare for x and the references, and solve for `count` states around x, whose deviations (13) are each drawn up to
 * `deviation`. groups: the most acting rows of each group. Leaves r as it was prepared. */
void solve_programs(rti *kernel, const double *x, const double *x_reference, const double *u_reference,
                    unsigned long long seed, int count, const double *deviation, const int *groups,
                    programs_report *report) {
    condensed *r = &kernel->ocp;
    const double preparation = preparation_time(kernel, x, x_reference, u_reference);
    if (!r->prepared) return;
    keep(r);
    for (int draw = 0; draw < count; draw++) {
        double state[NX], answer[NV], scale = uniform(&seed), norm = 0;
        memcpy(state, r->x_prepared, sizeof state);
        for (int i = 0; i < 13; i++) state[i] += scale * deviation[i] * normal(&seed);
        for (int i = 0; i < 4; i++) norm += state[ATTITUDE + i] * state[ATTITUDE + i];
        for (int i = 0; i < 4; i++) state[ATTITUDE + i] /= sqrt(norm);
        const double once = feedback_time(r, state);
        const int rows = r->report.rows, status = r->report.status;
        const int iterations = r->report.iterations < ITERATION_BINS ? r->report.iterations : ITERATION_BINS - 1;
        double shortest = once, *median = &report->median[iterations];
        if (*median == 0) *median = once;
        int group = 0;
        while (group < GROUPS - 1 && rows > groups[group]) group++;
        const double limit = fmin(SLOW * *median, fmax(report->worst[group], *median)); /* or the slowest up to now */
        memcpy(answer, r->z + X0, sizeof answer);
        for (int again = 1; again < TRIES && shortest > limit; again++) {
            shortest = fmin(shortest, feedback_time(r, state));
            report->differing += memcmp(answer, r->z + X0, sizeof answer) != 0;
        }
        *median *= shortest > *median ? 1 + FOLLOWING : 1 - FOLLOWING;
        const double step = preparation + shortest;
        report->programs[group]++;
        report->times[group][(int)fmin(1e6 * shortest, TIME_BINS - 1)]++;
        report->steps[(int)fmin(1e6 * step, 2 * TIME_BINS - 1)]++;
        report->iterations[group][iterations]++;
        report->cut[group] += status == 1;
        report->failed += status != 0 && status != 1;
        report->infeasible += !can_be_flown(r);
        report->once[group] = fmax(report->once[group], once);
        report->worst[group] = fmax(report->worst[group], shortest);
        report->worst_step = fmax(report->worst_step, step);
        if (rows > report->max_rows) report->max_rows = rows;
        if (iterations > report->max_iterations) report->max_iterations = iterations;
    }
    restore(r);
}

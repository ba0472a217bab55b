/* Runs the generated step many times: the loop around one millisecond of simulated time. */
#include "functions.c"

#include <string.h>

/* state: advanced in place. noise: one row a step. record: a ring of rows, written from row `first` on. */
int advance(long long steps, double *state, long long state_size, const double *command, const double *constants,
            const double *noise, long long noise_size, double *record, long long record_size, long long first,
            long long rows, double *next, const double **arguments, double **results, long long *integers,
            double *work) {
  for (long long i = 0; i < steps; ++i) {
    arguments[0] = state;
    arguments[1] = command;
    arguments[2] = constants;
    arguments[3] = noise + i * noise_size;
    results[0] = next;
    results[1] = record + ((first + i) % rows) * record_size;
    if (vehicle_step(arguments, results, integers, work, 0)) return 1;
    memcpy(state, next, (size_t)state_size * sizeof(double));
  }
  return 0;
}

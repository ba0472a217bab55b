/* Repeats a recorded tick with a bundle's kernel.so as it was exported, in a program: for a processor that
 * only an emulator has. Reads options and arguments, writes states, Hessian, gradient and new inputs. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { STATES, INPUTS, NODES, PARAMETERS, ENVIRONMENT, HISTORY, SUBSTEPS, VECTOR_BYTES, OPTIONS_BYTES, COUNT };
void rti_dimensions(int *);
void *rti_create(const void *);
double *rti_parameters(void *), *rti_environment(void *), *rti_states(void *), *rti_inputs(void *);
double *rti_hessian(void *), *rti_gradient(void *);
double *rti_history(void *) __attribute__((weak)); /* of a network's kernel alone */
int rti_prepare(void *, const double *, const double *, const double *), rti_feedback(void *, const double *);

static void *pull(void *to, size_t bytes) {
    if (fread(to, 1, bytes, stdin) != bytes) exit(2);
    return to;
}
static void push(const double *from, size_t count) { fwrite(from, sizeof *from, count, stdout); }

int main(void) {
    int n[COUNT];
    rti_dimensions(n);
    void *r = rti_create(pull(malloc(n[OPTIONS_BYTES]), n[OPTIONS_BYTES]));
    const size_t d = sizeof(double), x_count = (size_t)(n[NODES] + 1) * n[STATES], u_count = (size_t)n[NODES] * n[INPUTS];
    pull(rti_parameters(r), d * n[PARAMETERS]), pull(rti_environment(r), d * n[ENVIRONMENT]);
    if (n[HISTORY]) pull(rti_history(r), d * n[HISTORY] * (13 + n[INPUTS]));
    pull(rti_inputs(r), d * u_count);
    double *x_reference = pull(malloc(d * x_count), d * x_count), *u_reference = pull(malloc(d * u_count), d * u_count);
    double *x = pull(malloc(d * n[STATES]), d * n[STATES]);
    const int prepared = rti_prepare(r, x, x_reference, u_reference);
    push(rti_states(r), x_count), push(rti_hessian(r), u_count * u_count), push(rti_gradient(r), u_count);
    const int solved = rti_feedback(r, x);
    push(rti_inputs(r), u_count);
    return prepared || solved;
}

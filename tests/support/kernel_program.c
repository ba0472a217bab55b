/* Runs a kernel on one recorded case, in a program of its own: for a processor that only an emulator has.
 * Reads the case, writes what the kernel answers, in the order below. */
#include <stdio.h>

#include "network.c"

static void pull(void *to, size_t bytes) {
    if (fread(to, 1, bytes, stdin) != bytes) exit(2);
}
static void push(const void *from, size_t bytes) { fwrite(from, 1, bytes, stdout); }

int main(void) {
    static rti_options options;
    static double x[NX], u[NODES][NU], x_reference[NODES + 1][NX], u_reference[NODES][NU];
    pull(&options, sizeof options);
    network *r = rti_create(&options);
    pull(rti_parameters(r), sizeof(double) * NP), pull(rti_environment(r), sizeof(double) * NE);
    pull(rti_history(r), sizeof(double) * HISTORY * COLUMN_ENTRIES);
    pull(x, sizeof x), pull(u, sizeof u), pull(x_reference, sizeof x_reference), pull(u_reference, sizeof u_reference);
    memcpy(rti_inputs((condensed *)r), u, sizeof u);
    const int prepared = rti_prepare(r, x, &x_reference[0][0], &u_reference[0][0]);
    push(rti_states((condensed *)r), sizeof(double) * (NODES + 1) * NX);
    push(rti_hessian((condensed *)r), sizeof(double) * NV * NV);
    push(rti_gradient((condensed *)r), sizeof(double) * NV);
    const int solved = rti_feedback((condensed *)r, x);
    push(rti_inputs((condensed *)r), sizeof u);
    rti_free((condensed *)r);
    return prepared || solved;
}

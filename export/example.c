/* How to call a bundle's model.c from a C program of your own:
 *
 *   cc -O2 example.c model.c -o example -lm && ./example
 *
 * history: one column after the other, oldest first, each position (m), velocity (m/s, world), attitude (w, x, y, z,
 * body to world), body rates (rad/s), rotor speeds (rad/s); columns lie alula_model_dt seconds apart. */
#include <stdio.h>
#include <stdlib.h>

#include "model.h"

int main(void) {
    casadi_int args, results, integers, reals;
    alula_model_work(&args, &results, &integers, &reals);
    const casadi_int *shape = alula_model_sparsity_in(0); /* rows, columns, .. */
    const casadi_int rows = shape[0], columns = shape[1], hidden_states = alula_model_sparsity_in(1)[0];
    casadi_real *history = calloc((size_t)(rows * columns), sizeof *history);
    casadi_real *hidden = calloc((size_t)hidden_states + 1, sizeof *hidden);
    casadi_real *rate = calloc((size_t)hidden_states + 1, sizeof *rate);
    const casadi_real **arg = calloc((size_t)args, sizeof *arg);
    casadi_real **res = calloc((size_t)results, sizeof *res), acceleration[6];
    casadi_int *iw = calloc((size_t)integers + 1, sizeof *iw);
    casadi_real *w = calloc((size_t)reals + 1, sizeof *w);
    for (casadi_int t = 0; t < columns; t++) { /* level, at rest, every rotor at the same speed */
        history[t * rows + 6] = 1;
        for (casadi_int i = 13; i < rows; i++) history[t * rows + i] = HOVER_SPEED;
    }
    for (casadi_int i = 0; i < hidden_states; i++) hidden[i] = hidden_initial[i];
    arg[0] = history, arg[1] = hidden;
    res[0] = acceleration, res[1] = rate;
    alula_model(arg, res, iw, w, 0);
    for (int i = 0; i < 6; i++) printf("%.17g\n", acceleration[i]);
    free(history), free(hidden), free(rate), free(arg), free(res), free(iw), free(w);
    return 0;
}

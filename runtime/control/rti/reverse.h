/* How what the network says depends on what its last streamed layer gave, by a reverse sweep; derived in docs/kernel.md.
 *
 * Part of network.c. What is said at a substep has six rows, fewer than the tangents have columns: from some layer on it
 * costs less to pull these six back through the layers than to push the tangents through. Along the horizon the ReLUs'
 * masks seldom turn, so most of what a sweep would find is what the substep before has found one column earlier: only
 * what a turned mask changes is worked out anew. */

/* Whether two columns of a ReLU's output are active in the same places. */
INLINE bool same_signs(const int entries, const real *x, const real *y) {
    lane_numbers other = {0};
    UNROLL for (int v = 0; v < entries / LANES; v++)
        other |= (((const vector *)x)[v] > 0) ^ (((const vector *)y)[v] > 0);
    unsigned long long parts[VECTOR_BYTES / 8], any = 0;
    memcpy(parts, &other, sizeof parts);
    for (int i = 0; i < VECTOR_BYTES / 8; i++) any |= parts[i];
    return !any;
}

#define FIND(l, inputs, outputs, taps, dilation) find_active(&r->active[l + 1][t], outputs, r->a.column[l + 1][t]);
#define TURN(l, inputs, outputs, taps, above, below) \
    r->turned[l + 1][t] = !same_signs(outputs, r->a.column[l + 1][t], r->a.column[l + 1][t - 1]);

/* Masks of what streamed layers give in the horizon; where masks turn of what the others give, measured columns too. */
static void find_masks(network *r) {
    for (int t = HISTORY; t < COLUMNS; t++) { EACH_STREAMED(FIND) }
    for (int t = 1; t < COLUMNS; t++) { EACH_SWEPT(TURN) }
}

#define UNTHINK(l, inputs, outputs) \
    active = list_active(outputs, r->a.hidden_##l[s], index); \
    reverse(6, inputs, outputs, active, index, J, &perceptron_back_##l[0][0], buffer[at]); \
    J = buffer[at], at = 1 - at;
#define ALIKE(l, inputs, outputs) alike = alike && same_signs(outputs, r->a.hidden_##l[s], r->a.hidden_##l[s - 1]);

/* The perceptron's Jacobian (6, LAST_CODE) at substep s; returns whether it is another than at the one before. */
static bool sweep_perceptron(network *r, int s) {
    real buffer[2][6 * WIDEST] __attribute__((aligned(64)));
    const real *J = &output_back[0][0];
    unsigned char index[WIDEST + 1];
    bool alike = s > 0;
    int at = 0, active;
    if (alike) { EACH_HIDDEN(ALIKE) }
    if (alike) return false;
    EACH_HIDDEN_BACK(UNTHINK)
    memcpy(r->a.perceptron, J, sizeof r->a.perceptron);
    (void)index, (void)active, (void)buffer, (void)at;
    return true;
}

/* Pull what is said back through one layer, from its outputs at the columns `seen` behind t to its inputs at those that
 * its taps reach: the way through each tap is a part, and a column's parts are summed. `fresh`: outputs whose
 * derivatives changed since the substep before, `changed`: those of the inputs that then did. */
INLINE void sweep_layer(network *r, int t, const int layer, const int inputs, const int outputs, const int taps,
                        const int above, const int below, const short *seen, const bool *fresh, const real *given,
                        const short (*reached)[taps], const real *W, real (*parts)[taps][6 * inputs],
                        real (*sums)[6 * inputs], bool *changed) {
    for (int a = 0; a < above; a++) {
        const int column = t - seen[a];
        unsigned char index[outputs + 1];
        if (!fresh[a] && !r->turned[layer + 1][column]) continue;
        const int active = list_active(outputs, r->a.column[layer + 1][column], index);
        for (int tap = 0; tap < taps; tap++) {
            reverse(6, inputs, outputs, active, index, given + a * 6 * outputs, W + tap * outputs * inputs,
                    parts[a][tap]);
            changed[reached[a][tap]] = true;
        }
    }
    for (int b = 0; b < below; b++)
        if (changed[b]) memset(sums[b], 0, sizeof sums[b]);
    for (int a = 0; a < above; a++)
        for (int tap = 0; tap < taps; tap++)
            if (changed[reached[a][tap]])
                for (int i = 0; i < 6 * inputs; i += LANES)
                    *(vector *)&sums[reached[a][tap]][i] += *(const vector *)&parts[a][tap][i];
}

#define SWEEP(l, inputs, outputs, taps, above, below) \
    bool changed_##l[below] = {0}; \
    sweep_layer(r, HISTORY + s, l, inputs, outputs, taps, above, below, seen, fresh, given, reached_##l, \
                &convolution_back_##l[0][0][0], r->a.part_##l, r->a.back_##l, changed_##l); \
    seen = seen_##l, fresh = changed_##l, given = r->a.back_##l[0];

/* How the six that are said at substep s depend on what the last streamed layer gave, (CODE_SEEN, 6, CODE). */
static const real *sweep(network *r, int s) {
    const bool said_changed[1] = {sweep_perceptron(r, s)};
    const real *given = r->a.perceptron;
    const short *seen = seen_last;
    const bool *fresh = said_changed;
    EACH_SWEPT(SWEEP)
    (void)seen, (void)fresh;
    return given;
}

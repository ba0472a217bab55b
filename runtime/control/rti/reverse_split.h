/* Derivatives of the network's output by its last streamed layer's output, in reverse mode; derived in docs/kernel.md.
 *
 * Part of network.c. The output at a substep has six rows, fewer than the tangents have columns: from some layer on,
 * reverse mode for these six costs less than forward mode for the tangents. Along the horizon the ReLUs' masks seldom
 * change, so most derivatives equal those of the substep before, one column earlier: only those that a changed mask
 * affects are computed again. */

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

#define LIST_ACTIVE(l, inputs, outputs, taps, dilation) \
    find_active(&r->active[l + 1][t], outputs, r->tangents.column[l + 1][t]);
#define COMPARE_MASKS(l, inputs, outputs, taps, above, below) \
    r->mask_changed[l + 1][t] = \
        !same_signs(outputs, r->tangents.column[l + 1][t], r->tangents.column[l + 1][t - 1]);

/* Active outputs of the streamed layers in the horizon; where masks of the others change, measured columns included. */
static void find_masks(network *r) {
    for (int t = HISTORY; t < COLUMNS; t++) { EACH_STREAMED(LIST_ACTIVE) }
    for (int t = 1; t < COLUMNS; t++) { EACH_SWEPT(COMPARE_MASKS) }
}

#define DENSE_BACKWARD(l, inputs, outputs) \
    active = list_active(outputs, r->tangents.hidden_##l[s], index); \
    reverse(6, inputs, outputs, active, index, J, &perceptron_back_##l[0][0], buffer[at]); \
    J = buffer[at], at = 1 - at;
#define SAME_MASK(l, inputs, outputs) \
    same = same && same_signs(outputs, r->tangents.hidden_##l[s], r->tangents.hidden_##l[s - 1]);

/* The perceptron's Jacobian (6, LAST_CODE) at substep s; returns whether it differs from that of the substep before. */
static bool sweep_perceptron(network *r, int s) {
    real buffer[2][6 * MAX_WIDTH] __attribute__((aligned(64)));
    const real *J = &r->output.back[0][0];
    unsigned char index[MAX_WIDTH + 1];
    bool same = s > 0;
    int at = 0, active;
    if (same) { EACH_HIDDEN(SAME_MASK) }
    if (same) return false;
    EACH_HIDDEN_BACK(DENSE_BACKWARD)
    memcpy(r->tangents.perceptron, J, sizeof r->tangents.perceptron);
    (void)index, (void)active, (void)buffer, (void)at;
    return true;
}

/* Reverse mode through one layer, from its outputs at the columns t - offsets[] to its inputs at the columns that its
 * taps reach: each tap contributes a part, and a column's parts are summed. `by_output`: derivatives by the layer's
 * outputs. `fresh`: outputs whose derivatives changed since the substep before. `changed`: inputs whose then did. */
INLINE void sweep_layer(network *r, int t, const int layer, const int inputs, const int outputs, const int taps,
                        const int above, const int below, const short *offsets, const bool *fresh,
                        const real *by_output, const short (*reached)[taps], const real *W,
                        real (*parts)[taps][6 * inputs], real (*sums)[6 * inputs], bool *changed) {
    for (int a = 0; a < above; a++) {
        const int column = t - offsets[a];
        unsigned char index[outputs + 1];
        if (!fresh[a] && !r->mask_changed[layer + 1][column]) continue;
        const int active = list_active(outputs, r->tangents.column[layer + 1][column], index);
        for (int tap = 0; tap < taps; tap++) {
            reverse(6, inputs, outputs, active, index, by_output + a * 6 * outputs, W + tap * outputs * inputs,
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
    sweep_layer(r, HISTORY + s, l, inputs, outputs, taps, above, below, offsets, fresh, by_output, reached_##l, \
                &convolution_back_##l[0][0][0], r->tangents.part_##l, r->tangents.back_##l, changed_##l); \
    offsets = offsets_##l, fresh = changed_##l, by_output = r->tangents.back_##l[0];

/* Derivatives of the output at substep s by the last streamed layer's outputs, (CODE_OFFSETS, 6, CODE). */
static const real *sweep(network *r, int s) {
    const bool output_changed[1] = {sweep_perceptron(r, s)};
    const real *by_output = r->tangents.perceptron;
    const short *offsets = offsets_last;
    const bool *fresh = output_changed;
    EACH_SWEPT(SWEEP)
    (void)offsets, (void)fresh;
    return by_output;
}

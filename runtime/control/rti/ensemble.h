/* Spread of an ensemble's members over one window: how far they disagree, and so how much of a residual is flown.
 *
 * Part of network.c. Once a tick, on measured columns; it is not differentiated, and holds over the horizon. The members
 * that do not fly are evaluated over the receptive cone of the newest column alone, in the memory of the roll-out, which
 * writes it anew. */

#if MEMBERS
#define CONVOLVE_CONE(l, inputs, outputs, taps, dilation, W, b) \
    for (int i = 0; i < (int)(sizeof cone_##l / sizeof *cone_##l); i++) { \
        const int t = HISTORY - cone_##l[i]; \
        convolve(inputs, outputs, taps, dilation, WIDTH, W, b, r->tangents.column[l][t], r->tangents.column[l + 1][t]); \
    }
#define OWN_CONE(l, inputs, outputs, taps, dilation) \
    CONVOLVE_CONE(l, inputs, outputs, taps, dilation, &convolution_##l[0][0][0], convolution_bias_##l)
#define MEMBER_CONE(l, inputs, outputs, taps, dilation) \
    CONVOLVE_CONE(l, inputs, outputs, taps, dilation, &member_convolution_##l[m][0][0][0], \
                  member_convolution_bias_##l[m])
#define MEMBER_DENSE(l, inputs, outputs) \
    dense(inputs, outputs, 1, &member_perceptron_##l[m][0][0], member_perceptron_bias_##l[m], before, \
          r->tangents.hidden_##l[0]), \
        before = r->tangents.hidden_##l[0];

/* Mean square over the outputs of the members' standardised deviation, for the features that are written. */
static double disagreement(network *r) {
    real y[MEMBERS + 1][OUTPUTS] __attribute__((aligned(64)));
    const int s = 0;
    EACH_CONVOLUTION(OWN_CONE)
    const real *before = r->tangents.column[LAYERS][HISTORY];
    EACH_HIDDEN(DENSE_FORWARD)
    dense(LAST, OUTPUTS, 0, &output[0][0], output_bias, before, y[MEMBERS]);
    for (int m = 0; m < MEMBERS; m++) {
        EACH_CONVOLUTION(MEMBER_CONE)
        before = r->tangents.column[LAYERS][HISTORY];
        EACH_HIDDEN(MEMBER_DENSE)
        dense(LAST, OUTPUTS, 0, &member_output[m][0][0], member_output_bias[m], before, y[m]);
    }
    double square = 0;
    for (int i = 0; i < 6; i++) {
        double mean = 0;
        for (int m = 0; m <= MEMBERS; m++) mean += (double)y[m][i] / (MEMBERS + 1);
        for (int m = 0; m <= MEMBERS; m++) {
            const double away = output_gain[i] * (y[m][i] - mean);
            square += away * away / (6 * MEMBERS);
        }
    }
    return square;
}

/* certainty: the disagreement over what one validation row in 100 exceeds, and the share of the network's output that
 * is flown, all of it up to 1, then falling with the square. */
static void assess(network *r) {
    const double excess = disagreement(r) / (DISAGREEMENT * DISAGREEMENT);
    r->certainty[0] = sqrt(excess);
    r->certainty[1] = !FADES || excess <= 1 ? 1 : isfinite(excess) ? 1 / excess : 0;
}
#else
static void assess(network *r) { r->certainty[0] = NAN; }
#endif

/* The last layer as it is flown: the trained one with the change beside it, both as far as they are certain. */
static void set_output(network *r) {
    const real share = (real)r->certainty[1];
    for (int i = 0; i < LAST; i++)
        for (int o = 0; o < OUTPUTS; o++)
            r->output.weight[i][o] = share * (output[i][o] + (o < 6 ? (real)r->change[o][i] : 0));
    for (int o = 0; o < OUTPUTS; o++)
        r->output.bias[o] = share * (output_bias[o] + (o < 6 ? (real)r->change[o][LAST] : 0));
    for (int o = 0; o < 6; o++)
        for (int i = 0; i < LAST; i++) r->output.back[o][i] = share * (output_back[o][i] + (real)r->change[o][i]);
}

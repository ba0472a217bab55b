/* Exact tangents of the roll-out, streamed like it, and the condensed Hessian and gradient computed from them.
 *
 * Part of network.c. A row holds the derivative of one number by every free direction: the initial state without its
 * position, then the inputs of node 0, 1, .. Up to node k the columns behind node k's are zero and left out. */

static int columns_at(int node) { return PAD(BY_INPUT + NU * (node + 1)); }

INLINE void add_own_inputs(real *restrict row, const real *restrict weights) {
    UNROLL for (int i = 0; i < NU; i++) row[i] += weights[i];
}

/* One layer of convolution at substep s: active outputs from active inputs of the columns under its taps. Columns of
 * the measured history are constant, so taps that reach into it are left out. */
INLINE void stream_layer(network *r, int s, int columns, const int layer, const int inputs, const int outputs,
                         const int taps, const int dilation, const real *W, real (*ring)[inputs][STREAMED],
                         real (*out)[STREAMED]) {
    const int span = (taps - 1) * dilation + 1;
    const active_set *mine = &r->active[layer + 1][HISTORY + s];
    const real *rows[taps * inputs], *weights[taps * inputs];
    real packed[taps * inputs + 1][outputs] __attribute__((aligned(64))), *active[outputs];
    int count = 0;
    for (int tap = 0; tap < taps && s - tap * dilation >= 0; tap++) {
        const int from = s - tap * dilation;
        const active_set *theirs = &r->active[layer][HISTORY + from];
        for (int q = 0; q < theirs->count; q++) {
            const int i = theirs->index[q];
            rows[count] = ring[from % span][i];
            pack(outputs, W + (tap * inputs + i) * outputs, mine, packed[count]);
            weights[count] = packed[count], count++;
        }
    }
    for (int q = 0; q < mine->count; q++) active[q] = out[mine->index[q]];
    multiply(mine->count, count, rows, weights, columns, active);
    for (int tap = 0; layer == 0 && tap < taps && s - tap * dilation >= 0; tap++) {
        const int first = BY_INPUT + NU * r->node_of[s - tap * dilation];
        for (int q = 0; q < mine->count; q++) /* a node's own inputs: identities, so their columns are the weights */
            add_own_inputs(active[q] + first, r->by_own_input[tap][mine->index[q]]);
    }
}

/* Tangents of the features that depend on the state, from those of the state. */
static void stream_features(const network *r, int s, int columns, real (*out)[STREAMED]) {
    const real(*moving)[STREAMED] = r->tangents.moving;
    COUNT((BODY_INPUTS ? 36 : 10) * columns);
#if BODY_INPUTS
    double R[3][3], P[3][4], down[3][4];
    const double gravity[3] = {0, 0, -1};
    const double *attitude = r->state[s] + ATTITUDE, *velocity = r->state[s] + VELOCITY;
    rotation(attitude, R);
    rotation_by_attitude(attitude, velocity, 1, P);
    rotation_by_attitude(attitude, gravity, 1, down);
    real by_velocity[3][3], by_attitude[6][4];
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) by_velocity[i][j] = (real)(feature_gain[i] * R[j][i]);
        for (int j = 0; j < 4; j++) by_attitude[i][j] = (real)(feature_gain[i] * P[i][j]);
        for (int j = 0; j < 4; j++) by_attitude[3 + i][j] = (real)(feature_gain[3 + i] * down[i][j]);
    }
    for (int c = 0; c < columns; c += LANES) {
        vector v[3], q[4];
        for (int j = 0; j < 3; j++) v[j] = *(const vector *)&moving[VELOCITY + j][c];
        for (int j = 0; j < 4; j++) q[j] = *(const vector *)&moving[ATTITUDE + j][c];
        UNROLL for (int i = 0; i < 6; i++) {
            vector sum = by_attitude[i][0] * q[0];
            UNROLL for (int j = 1; j < 4; j++) sum += by_attitude[i][j] * q[j];
            if (i < 3) UNROLL for (int j = 0; j < 3; j++) sum += by_velocity[i][j] * v[j];
            *(vector *)&out[i][c] = sum;
        }
        for (int i = 0; i < 3; i++)
            *(vector *)&out[6 + i][c] = (real)feature_gain[6 + i] * *(const vector *)&moving[RATE + i][c];
    }
#else
    for (int i = 0; i < 10; i++)
        for (int c = 0; c < columns; c += LANES)
            *(vector *)&out[i][c] = (real)feature_gain[i] * *(const vector *)&moving[VELOCITY + i][c];
#endif
}

/* Tangents of the network's output, from those of its last streamed layer at the columns that it depends on. */
static void stream_net_out(network *r, int s, int columns) {
    const real *rows[CODE_OFFSETS * CODE], *weights[CODE_OFFSETS * CODE], *by_code = sweep(r, s);
    real *out[6];
    int count = 0;
    for (int b = 0; b < CODE_OFFSETS && offsets_code[b] <= s; b++) { /* measured columns are constant */
        const int from = s - offsets_code[b];
        const active_set *theirs = &r->active[STREAMED_LAYERS][HISTORY + from];
        for (int q = 0; q < theirs->count; q++) {
            rows[count] = r->tangents.code[from % CODE_SPAN][theirs->index[q]];
            weights[count++] = by_code + b * 6 * CODE + theirs->index[q];
        }
    }
    for (int o = 0; o < 6; o++) out[o] = r->tangents.net_out[o];
    block_row(6, count, rows, weights, CODE, 0, columns, out);
#if STREAMED_LAYERS == 0
    for (int b = 0; b < CODE_OFFSETS && offsets_code[b] <= s; b++) {
        const int first = BY_INPUT + NU * r->node_of[s - offsets_code[b]];
        for (int i = 0; i < NU; i++)
            for (int o = 0; o < 6; o++)
                out[o][first + i] += (real)(r->ocp.options.scale * feature_gain[STATE_FEATURES + i]) *
                                     by_code[(b * 6 + o) * CODE + STATE_FEATURES + i];
    }
#endif
}

/* Tangents of the nominal or identified model's accelerations. */
static void stream_physics(network *r, int s, int columns) {
#if RESIDUAL
    const int first = BY_INPUT + NU * r->node_of[s];
    const real *rows[NX], *weights[NX];
    real by_state[NX][6], *out[6];
    for (int i = FREE; i < NX; i++) {
        rows[i - FREE] = r->tangents.moving[i], weights[i - FREE] = by_state[i];
        for (int o = 0; o < 6; o++) by_state[i][o] = (real)r->by_state[s][i * PHYSICS_RATES + o];
    }
    for (int o = 0; o < 6; o++) out[o] = r->tangents.physical[o];
    multiply(6, NX - FREE, rows, weights, columns, out);
    for (int o = 0; o < 6; o++)
        for (int i = 0; i < NU; i++)
            out[o][first + i] += (real)(r->ocp.options.scale * r->by_input[s][i * PHYSICS_RATES + o]);
#else
    (void)r, (void)s, (void)columns;
#endif
}

/* Tangents of the accelerations, world and body axes: the network's output, rotated to world axes if it is in body
 * axes, d(R f) = R df + d(R f)/dq dq, plus the nominal or identified model's part. */
static void stream_rates(network *r, int s, int columns) {
    stream_net_out(r, s, columns);
    stream_physics(r, s, columns);
    COUNT(21 * columns);
    double exact[3][3], exact_by_attitude[3][4];
    real R[3][3], by_attitude[3][4];
    rotation(r->state[s] + ATTITUDE, exact);
    rotation_by_attitude(r->state[s] + ATTITUDE, r->net_out[s], 0, exact_by_attitude);
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) R[i][j] = BODY_OUTPUTS ? (real)exact[i][j] : (real)(i == j);
        for (int j = 0; j < 4; j++) by_attitude[i][j] = BODY_OUTPUTS ? (real)exact_by_attitude[i][j] : 0;
    }
    for (int c = 0; c < columns; c += LANES) {
        vector net_out[3], q[4], sum;
        for (int j = 0; j < 3; j++) net_out[j] = *(const vector *)&r->tangents.net_out[j][c];
        for (int j = 0; j < 4; j++) q[j] = *(const vector *)&r->tangents.moving[ATTITUDE + j][c];
        UNROLL for (int o = 0; o < 6; o++) {
            if (o < 3) {
                sum = R[o][0] * net_out[0] + R[o][1] * net_out[1] + R[o][2] * net_out[2];
                UNROLL for (int j = 0; j < 4; j++) sum += by_attitude[o][j] * q[j];
            } else
                sum = *(const vector *)&r->tangents.net_out[o][c];
#if RESIDUAL
            sum += *(const vector *)&r->tangents.physical[o][c];
#endif
            *(vector *)&r->tangents.rates[o][c] = sum;
        }
    }
}

/* Tangents of the hidden states' rates. */
static void stream_hidden(network *r, int s, int columns) {
#if RESIDUAL && NX > RIGID_BODY_STATES
    const real *rows[NX], *weights[NX];
    real by_state[NX][HIDDEN_STATES], *out[HIDDEN_STATES];
    for (int i = FREE; i < NX; i++) {
        rows[i - FREE] = r->tangents.moving[i], weights[i - FREE] = by_state[i];
        for (int o = 0; o < HIDDEN_STATES; o++) by_state[i][o] = (real)r->by_state[s][i * PHYSICS_RATES + 6 + o];
    }
    for (int o = 0; o < HIDDEN_STATES; o++) out[o] = r->tangents.other[o];
    multiply(HIDDEN_STATES, NX - FREE, rows, weights, columns, out);
    for (int o = 0; o < HIDDEN_STATES; o++)
        for (int i = 0; i < NU; i++)
            out[o][BY_INPUT + NU * r->node_of[s] + i] +=
                (real)(r->ocp.options.scale * r->by_input[s][i * PHYSICS_RATES + 6 + o]);
#else
    (void)r, (void)s, (void)columns;
#endif
}

/* Tangents of the state after substep s, in place (see move_body). */
static void stream_motion(network *r, int s, int columns) {
    const real h = (real)STEP_SECONDS, half = (real)0.5 * h;
    double by_attitude[4][4], by_half_rotation[4][3];
    real Q[4][4], M[4][3];
    COUNT(46 * columns);
    attitude_derivatives(r->state[s], r->angular[s], STEP_SECONDS, by_attitude, by_half_rotation);
    for (int i = 0; i < 4; i++) {
        for (int j = 0; j < 4; j++) Q[i][j] = (real)by_attitude[i][j];
        for (int j = 0; j < 3; j++) M[i][j] = (real)by_half_rotation[i][j];
    }
#define ROW(rows, i) (*(vector *)&r->tangents.rows[i][c])
    for (int c = 0; c < columns; c += LANES) {
        vector q[4], half_rotation[3];
        UNROLL for (int i = 0; i < 4; i++) q[i] = ROW(moving, ATTITUDE + i);
        UNROLL for (int i = 0; i < 3; i++) {
            vector linear = ROW(rates, i), angular = ROW(rates, 3 + i);
            half_rotation[i] = half * (ROW(moving, RATE + i) + half * angular);
            ROW(moving, POSITION + i) += h * (ROW(moving, VELOCITY + i) + half * linear);
            ROW(moving, VELOCITY + i) += h * linear;
            ROW(moving, RATE + i) += h * angular;
        }
        UNROLL for (int i = 0; i < 4; i++) {
            vector sum = Q[i][0] * q[0];
            UNROLL for (int j = 1; j < 4; j++) sum += Q[i][j] * q[j];
            UNROLL for (int j = 0; j < 3; j++) sum += M[i][j] * half_rotation[j];
            ROW(moving, ATTITUDE + i) = sum;
        }
        for (int i = 0; i < HIDDEN_STATES; i++) ROW(moving, RIGID_BODY_STATES + i) += h * ROW(other, i);
    }
#undef ROW
}

/* Tangents of `extrapolate`, over a whole substep. Those of the measured column before the first are zero. */
INLINE void extrapolate_rows(const int rows, int columns, real (*now)[STREAMED], real (*before)[STREAMED]) {
    for (int i = 0; i < rows; i++)
        for (int c = 0; c < columns; c += LANES) {
            vector value = *(vector *)&now[i][c];
            *(vector *)&now[i][c] += (real)0.5 * (value - *(vector *)&before[i][c]);
            *(vector *)&before[i][c] = value;
        }
}

#define CLEAR(l, inputs, outputs, taps, dilation) memset(r->tangents.ring_##l, 0, sizeof r->tangents.ring_##l);
#define PLACE(l, inputs, outputs, taps, dilation) into[l] = r->tangents.ring_##l[s % ((taps - 1) * dilation + 1)];
#define STREAM_LAYER(l, inputs, outputs, taps, dilation) \
    stream_layer(r, s, columns, l, inputs, outputs, taps, dilation, &convolution_##l[0][0][0], r->tangents.ring_##l, \
                 into[l + 1]);

/* Derivatives S of the states at the nodes by all free directions. */
static void stream_tangents(network *r) {
    find_masks(r);
    EACH_STREAMED(CLEAR)
    memset(r->tangents.code, 0, sizeof r->tangents.code);
    memset(r->tangents.moving, 0, sizeof r->tangents.moving);
    memset(r->tangents.rates, 0, sizeof r->tangents.rates);
    memset(r->tangents.other, 0, sizeof r->tangents.other);
#if EXTRAPOLATED
    memset(r->tangents.rates_before, 0, sizeof r->tangents.rates_before);
    memset(r->tangents.other_before, 0, sizeof r->tangents.other_before);
#endif
    for (int i = FREE; i < NX; i++) r->tangents.moving[i][i - FREE] = 1;
    for (int s = 0; s < STEPS; s++) {
        const int node = r->node_of[s], columns = columns_at(node);
        real(*into[STREAMED_LAYERS + 1])[STREAMED];
        EACH_STREAMED(PLACE)
        into[STREAMED_LAYERS] = r->tangents.code[s % CODE_SPAN];
        stream_features(r, s, columns, into[0]);
        EACH_STREAMED(STREAM_LAYER)
        stream_rates(r, s, columns);
        stream_hidden(r, s, columns);
#if EXTRAPOLATED
        extrapolate_rows(6, columns, r->tangents.rates, r->tangents.rates_before);
        extrapolate_rows(HIDDEN_STATES, columns, r->tangents.other, r->tangents.other_before);
#endif
        stream_motion(r, s, columns);
        if (s + 1 == r->first_of[node + 1])
            for (int i = 0; i < NX; i++)
                memcpy(&r->ocp.S[node + 1][i][LEAD], r->tangents.moving[i], sizeof(real) * (size_t)columns);
    }
}

static void weigh(network *r) {
    for (int k = 0; k < NODES; k++) {
        const double *weight = k == NODES - 1 ? r->ocp.options.P : r->ocp.options.Q;
        for (int i = 0; i < NX; i++)
            for (int c = 0; c < columns_at(k); c += LANES)
                *(vector *)&r->tangents.S_weighed[k][i][LEAD + c] =
                    (real)(r->ocp.share[k + 1] * weight[i]) * *(vector *)&r->ocp.S[k + 1][i][LEAD + c];
    }
}

/* H = sum_k S_k' Q S_k + R SCALE^2 + the damping, two nodes' rows at a time; G is the same for dx_0's columns. */
static void hessian(network *r) {
    const real *rows[NODES * NX], *weights[NODES * NX];
    for (int k = 0; k < NODES; k++)
        for (int i = 0; i < NX; i++) rows[k * NX + i] = &r->ocp.S[k + 1][i][LEAD];
    for (int j = 0; j < NODES; j += 2) {
        const int nodes = j + 1 < NODES ? 2 : 1;
        real *out[2 * NU];
        for (int v = 0; v < nodes * NU; v++) out[v] = r->tangents.H[j * NU + v];
        for (int k = j; k < NODES; k++)
            for (int i = 0; i < NX; i++) weights[k * NX + i] = &r->tangents.S_weighed[k][i][X0 + NU * j];
        multiply(nodes * NU, (NODES - j) * NX, rows + j * NX, weights + j * NX, columns_at(j + nodes - 1), out);
    }
    const rti_options *options = &r->ocp.options;
    for (int v = 0; v < NV; v++) {
        for (int w = 0; w <= v; w++) r->ocp.H[v * NV + w] = r->ocp.H[w * NV + v] = r->tangents.H[v][BY_INPUT + w];
        r->ocp.H[v * NV + v] += r->ocp.share[v / NU] * options->R[v % NU] * options->scale * options->scale + options->levenberg_marquardt;
        for (int i = FREE; i < NX; i++) r->ocp.G[v][i] = r->tangents.H[v][i - FREE];
        for (int i = 0; i < FREE; i++) {
            r->ocp.G[v][i] = 0;
            for (int k = v / NU; k < NODES; k++) r->ocp.G[v][i] += r->tangents.S_weighed[k][i][X0 + v];
        }
    }
}

static void gradient(network *r) {
    condensed *c = &r->ocp;
    for (int v = 0; v < NV; v++)
        c->g[v] = c->share[v / NU] * c->options.scale * c->options.R[v % NU] * (c->u[v / NU][v % NU] - c->u_reference[v / NU][v % NU]);
    for (int k = 1; k <= NODES; k++)
        for (int i = 0; i < NX; i++) {
            const double error = c->share[k] * (k == NODES ? c->options.P : c->options.Q)[i] * (c->x[k][i] - c->x_reference[k][i]);
            for (int v = 0; v < k * NU; v++) c->g[v] += error * (double)c->S[k][i][X0 + v];
        }
}

static void condense(network *r) {
    weigh(r);
    hessian(r);
    gradient(r);
}

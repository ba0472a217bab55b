/* Exact tangents of the roll-out, streamed like it, and the condensed Hessian and gradient that follow from them.
 *
 * Part of network.c. A row holds the derivative of one number by every free direction: the initial state without its
 * position, then the inputs of node 0, 1, .. Up to node k the columns behind node k's are zero and left out. */

static int columns_at(int node) { return PAD(BY_INPUT + NU * (node + 1)); }

INLINE void add_own_inputs(real *restrict row, const real *restrict weights) {
    UNROLL for (int i = 0; i < NU; i++) row[i] += weights[i];
}

/* One layer of convolution at substep s: active outputs from active inputs of the columns under its taps. Columns of
 * the measured history do not move, so taps that reach into it are left out. */
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
        const int first = BY_INPUT + NU * ((s - tap * dilation) / SUBSTEPS);
        for (int q = 0; q < mine->count; q++) /* a node's own inputs: identities, so their columns are the weights */
            add_own_inputs(active[q] + first, r->by_own_input[tap][mine->index[q]]);
    }
}

/* Tangents of the features that depend on the state, from those of the state. */
static void stream_features(const network *r, int s, int columns, real (*out)[STREAMED]) {
    const real(*moving)[STREAMED] = r->a.moving;
    COUNT((BODY_INPUTS ? 36 : 10) * columns);
#if BODY_INPUTS
    double R[3][3], P[3][4], down[3][4];
    const double gravity[3] = {0, 0, -1};
    rotation(r->state[s] + 6, R);
    rotation_by_attitude(r->state[s] + 6, r->state[s] + 3, 1, P);
    rotation_by_attitude(r->state[s] + 6, gravity, 1, down);
    real by_velocity[3][3], by_attitude[6][4];
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) by_velocity[i][j] = (real)(feature_gain[i] * R[j][i]);
        for (int j = 0; j < 4; j++) by_attitude[i][j] = (real)(feature_gain[i] * P[i][j]);
        for (int j = 0; j < 4; j++) by_attitude[3 + i][j] = (real)(feature_gain[3 + i] * down[i][j]);
    }
    for (int c = 0; c < columns; c += LANES) {
        vector v[3], q[4];
        for (int j = 0; j < 3; j++) v[j] = *(const vector *)&moving[3 + j][c];
        for (int j = 0; j < 4; j++) q[j] = *(const vector *)&moving[6 + j][c];
        UNROLL for (int i = 0; i < 6; i++) {
            vector sum = by_attitude[i][0] * q[0];
            UNROLL for (int j = 1; j < 4; j++) sum += by_attitude[i][j] * q[j];
            if (i < 3) UNROLL for (int j = 0; j < 3; j++) sum += by_velocity[i][j] * v[j];
            *(vector *)&out[i][c] = sum;
        }
        for (int i = 0; i < 3; i++)
            *(vector *)&out[6 + i][c] = (real)feature_gain[6 + i] * *(const vector *)&moving[10 + i][c];
    }
#else
    for (int i = 0; i < 10; i++)
        for (int c = 0; c < columns; c += LANES)
            *(vector *)&out[i][c] = (real)feature_gain[i] * *(const vector *)&moving[3 + i][c];
#endif
}

/* Tangents of what the network says, from those of what its last streamed layer gave at the columns that are seen. */
static void stream_said(network *r, int s, int columns) {
    const real *rows[CODE_SEEN * CODE], *weights[CODE_SEEN * CODE], *by_code = sweep(r, s);
    real *out[6];
    int count = 0;
    for (int b = 0; b < CODE_SEEN && seen_code[b] <= s; b++) { /* measured columns do not move */
        const int from = s - seen_code[b];
        const active_set *theirs = &r->active[STREAMED_LAYERS][HISTORY + from];
        for (int q = 0; q < theirs->count; q++) {
            rows[count] = r->a.code[from % CODE_SPAN][theirs->index[q]];
            weights[count++] = by_code + b * 6 * CODE + theirs->index[q];
        }
    }
    for (int o = 0; o < 6; o++) out[o] = r->a.said[o];
    block_row(6, count, rows, weights, CODE, 0, columns, out);
#if STREAMED_LAYERS == 0
    for (int b = 0; b < CODE_SEEN && seen_code[b] <= s; b++) {
        const int first = BY_INPUT + NU * ((s - seen_code[b]) / SUBSTEPS);
        for (int i = 0; i < NU; i++)
            for (int o = 0; o < 6; o++)
                out[o][first + i] += (real)(r->c.o.scale * feature_gain[STATE_FEATURES + i]) *
                                     by_code[(b * 6 + o) * CODE + STATE_FEATURES + i];
    }
#endif
}

/* Tangents of the physical model's accelerations. */
static void stream_physics(network *r, int s, int columns) {
#if RESIDUAL
    const int first = BY_INPUT + NU * (s / SUBSTEPS);
    const real *rows[NX], *weights[NX];
    real by_state[NX][6], *out[6];
    for (int i = FREE; i < NX; i++) {
        rows[i - FREE] = r->a.moving[i], weights[i - FREE] = by_state[i];
        for (int o = 0; o < 6; o++) by_state[i][o] = (real)r->by_state[s][i * PHYSICS_RATES + o];
    }
    for (int o = 0; o < 6; o++) out[o] = r->a.physical[o];
    multiply(6, NX - FREE, rows, weights, columns, out);
    for (int o = 0; o < 6; o++)
        for (int i = 0; i < NU; i++)
            out[o][first + i] += (real)(r->c.o.scale * r->by_input[s][i * PHYSICS_RATES + o]);
#else
    (void)r, (void)s, (void)columns;
#endif
}

/* Tangents of the accelerations, world and body axes: what the network says, turned to world axes if it speaks of body
 * axes, d(R f) = R df + d(R f)/dq dq, and what the physical model adds. */
static void stream_rates(network *r, int s, int columns) {
    stream_said(r, s, columns);
    stream_physics(r, s, columns);
    COUNT(21 * columns);
    double exact[3][3], exact_by_attitude[3][4];
    real R[3][3], by_attitude[3][4];
    rotation(r->state[s] + 6, exact);
    rotation_by_attitude(r->state[s] + 6, r->said[s], 0, exact_by_attitude);
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) R[i][j] = BODY_OUTPUTS ? (real)exact[i][j] : (real)(i == j);
        for (int j = 0; j < 4; j++) by_attitude[i][j] = BODY_OUTPUTS ? (real)exact_by_attitude[i][j] : 0;
    }
    for (int c = 0; c < columns; c += LANES) {
        vector said[3], q[4], sum;
        for (int j = 0; j < 3; j++) said[j] = *(const vector *)&r->a.said[j][c];
        for (int j = 0; j < 4; j++) q[j] = *(const vector *)&r->a.moving[6 + j][c];
        UNROLL for (int o = 0; o < 6; o++) {
            if (o < 3) {
                sum = R[o][0] * said[0] + R[o][1] * said[1] + R[o][2] * said[2];
                UNROLL for (int j = 0; j < 4; j++) sum += by_attitude[o][j] * q[j];
            } else
                sum = *(const vector *)&r->a.said[o][c];
#if RESIDUAL
            sum += *(const vector *)&r->a.physical[o][c];
#endif
            *(vector *)&r->a.rates[o][c] = sum;
        }
    }
}

/* Tangents of the hidden states' rates. */
static void stream_hidden(network *r, int s, int columns) {
#if RESIDUAL && NX > 13
    const real *rows[NX], *weights[NX];
    real by_state[NX][HIDDEN_STATES], *out[HIDDEN_STATES];
    for (int i = FREE; i < NX; i++) {
        rows[i - FREE] = r->a.moving[i], weights[i - FREE] = by_state[i];
        for (int o = 0; o < HIDDEN_STATES; o++) by_state[i][o] = (real)r->by_state[s][i * PHYSICS_RATES + 6 + o];
    }
    for (int o = 0; o < HIDDEN_STATES; o++) out[o] = r->a.other[o];
    multiply(HIDDEN_STATES, NX - FREE, rows, weights, columns, out);
    for (int o = 0; o < HIDDEN_STATES; o++)
        for (int i = 0; i < NU; i++)
            out[o][BY_INPUT + NU * (s / SUBSTEPS) + i] +=
                (real)(r->c.o.scale * r->by_input[s][i * PHYSICS_RATES + 6 + o]);
#else
    (void)r, (void)s, (void)columns;
#endif
}

/* Tangents of the state after substep s, in place (see move_body). */
static void stream_motion(network *r, int s, int columns) {
    const real h = (real)STEP_SECONDS, half = (real)0.5 * h;
    double by_attitude[4][4], by_turn[4][3];
    real Q[4][4], M[4][3];
    COUNT(46 * columns);
    attitude_derivatives(r->state[s], r->angular[s], STEP_SECONDS, by_attitude, by_turn);
    for (int i = 0; i < 4; i++) {
        for (int j = 0; j < 4; j++) Q[i][j] = (real)by_attitude[i][j];
        for (int j = 0; j < 3; j++) M[i][j] = (real)by_turn[i][j];
    }
#define ROW(rows, i) (*(vector *)&r->a.rows[i][c])
    for (int c = 0; c < columns; c += LANES) {
        vector q[4], turn[3];
        UNROLL for (int i = 0; i < 4; i++) q[i] = ROW(moving, 6 + i);
        UNROLL for (int i = 0; i < 3; i++) {
            vector linear = ROW(rates, i), angular = ROW(rates, 3 + i);
            turn[i] = half * (ROW(moving, 10 + i) + half * angular);
            ROW(moving, i) += h * (ROW(moving, 3 + i) + half * linear);
            ROW(moving, 3 + i) += h * linear;
            ROW(moving, 10 + i) += h * angular;
        }
        UNROLL for (int i = 0; i < 4; i++) {
            vector sum = Q[i][0] * q[0];
            UNROLL for (int j = 1; j < 4; j++) sum += Q[i][j] * q[j];
            UNROLL for (int j = 0; j < 3; j++) sum += M[i][j] * turn[j];
            ROW(moving, 6 + i) = sum;
        }
        for (int i = 0; i < HIDDEN_STATES; i++) ROW(moving, 13 + i) += h * ROW(other, i);
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

#define CLEAR(l, inputs, outputs, taps, dilation) memset(r->a.ring_##l, 0, sizeof r->a.ring_##l);
#define PLACE(l, inputs, outputs, taps, dilation) into[l] = r->a.ring_##l[s % ((taps - 1) * dilation + 1)];
#define STREAM_LAYER(l, inputs, outputs, taps, dilation) \
    stream_layer(r, s, columns, l, inputs, outputs, taps, dilation, &convolution_##l[0][0][0], r->a.ring_##l, \
                 into[l + 1]);

/* Derivatives S of the states at the nodes by all free directions. */
static void stream_tangents(network *r) {
    find_masks(r);
    EACH_STREAMED(CLEAR)
    memset(r->a.code, 0, sizeof r->a.code);
    memset(r->a.moving, 0, sizeof r->a.moving);
    memset(r->a.rates, 0, sizeof r->a.rates);
    memset(r->a.other, 0, sizeof r->a.other);
#if EXTRAPOLATED
    memset(r->a.rates_before, 0, sizeof r->a.rates_before);
    memset(r->a.other_before, 0, sizeof r->a.other_before);
#endif
    for (int i = FREE; i < NX; i++) r->a.moving[i][i - FREE] = 1;
    for (int s = 0; s < STEPS; s++) {
        const int node = s / SUBSTEPS, columns = columns_at(node);
        real(*into[STREAMED_LAYERS + 1])[STREAMED];
        EACH_STREAMED(PLACE)
        into[STREAMED_LAYERS] = r->a.code[s % CODE_SPAN];
        stream_features(r, s, columns, into[0]);
        EACH_STREAMED(STREAM_LAYER)
        stream_rates(r, s, columns);
        stream_hidden(r, s, columns);
#if EXTRAPOLATED
        extrapolate_rows(6, columns, r->a.rates, r->a.rates_before);
        extrapolate_rows(HIDDEN_STATES, columns, r->a.other, r->a.other_before);
#endif
        stream_motion(r, s, columns);
        if (s % SUBSTEPS == SUBSTEPS - 1)
            for (int i = 0; i < NX; i++)
                memcpy(&r->c.S[node + 1][i][LEAD], r->a.moving[i], sizeof(real) * (size_t)columns);
    }
}

static void weigh(network *r) {
    for (int k = 0; k < N; k++) {
        const double *weight = k == N - 1 ? r->c.o.P : r->c.o.Q;
        for (int i = 0; i < NX; i++)
            for (int c = 0; c < columns_at(k); c += LANES)
                *(vector *)&r->a.S_weighed[k][i][LEAD + c] =
                    (real)weight[i] * *(vector *)&r->c.S[k + 1][i][LEAD + c];
    }
}

/* H = sum_k S_k' Q S_k + R SCALE^2 + the damping, two nodes' rows at a time; G is the same for dx_0's columns. */
static void hessian(network *r) {
    const real *rows[N * NX], *weights[N * NX];
    for (int k = 0; k < N; k++)
        for (int i = 0; i < NX; i++) rows[k * NX + i] = &r->c.S[k + 1][i][LEAD];
    for (int j = 0; j < N; j += 2) {
        const int nodes = j + 1 < N ? 2 : 1;
        real *out[2 * NU];
        for (int v = 0; v < nodes * NU; v++) out[v] = r->a.H[j * NU + v];
        for (int k = j; k < N; k++)
            for (int i = 0; i < NX; i++) weights[k * NX + i] = &r->a.S_weighed[k][i][X0 + NU * j];
        multiply(nodes * NU, (N - j) * NX, rows + j * NX, weights + j * NX, columns_at(j + nodes - 1), out);
    }
    for (int v = 0; v < V; v++) {
        for (int w = 0; w <= v; w++) r->c.H[v * V + w] = r->c.H[w * V + v] = r->a.H[v][BY_INPUT + w];
        r->c.H[v * V + v] += r->c.o.R[v % NU] * r->c.o.scale * r->c.o.scale + r->c.o.levenberg_marquardt;
        for (int i = FREE; i < NX; i++) r->c.G[v][i] = r->a.H[v][i - FREE];
        for (int i = 0; i < FREE; i++) {
            r->c.G[v][i] = 0;
            for (int k = v / NU; k < N; k++) r->c.G[v][i] += r->a.S_weighed[k][i][X0 + v];
        }
    }
}

static void gradient(network *r) {
    condensed *c = &r->c;
    for (int v = 0; v < V; v++)
        c->g[v] = c->o.scale * c->o.R[v % NU] * (c->u[v / NU][v % NU] - c->u_reference[v / NU][v % NU]);
    for (int k = 1; k <= N; k++)
        for (int i = 0; i < NX; i++) {
            const double error = (k == N ? c->o.P : c->o.Q)[i] * (c->x[k][i] - c->x_reference[k][i]);
            for (int v = 0; v < k * NU; v++) c->g[v] += error * (double)c->S[k][i][X0 + v];
        }
}

static void condense(network *r) {
    weigh(r);
    hessian(r);
    gradient(r);
}

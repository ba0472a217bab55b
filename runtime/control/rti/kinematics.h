/* Rigid-body kinematics of the roll-out and their derivatives, in doubles; attitudes are (w, x, y, z), body to world.
 *
 * state.h, generated from dynamics.state, has the offsets of the state's parts and GRAVITY. */
#ifndef ALULA_KINEMATICS_H
#define ALULA_KINEMATICS_H

#include <math.h>

#include "state.h"

/* R (3, 3), body to world, of a unit quaternion. */
static void rotation(const double *q, double R[3][3]) {
    double w = q[0], x = q[1], y = q[2], z = q[3];
    R[0][0] = 1 - 2 * (y * y + z * z), R[0][1] = 2 * (x * y - w * z), R[0][2] = 2 * (x * z + w * y);
    R[1][0] = 2 * (x * y + w * z), R[1][1] = 1 - 2 * (x * x + z * z), R[1][2] = 2 * (y * z - w * x);
    R[2][0] = 2 * (x * z - w * y), R[2][1] = 2 * (y * z + w * x), R[2][2] = 1 - 2 * (x * x + y * y);
}

/* P (3, 4) = d(R v)/dq, or with inverse d(R' v)/dq: the same with the vector part negated. */
static void rotation_by_attitude(const double *q, const double *v, int inverse, double P[3][4]) {
    double s = inverse ? -1 : 1, w = q[0], x = s * q[1], y = s * q[2], z = s * q[3], a = v[0], b = v[1], c = v[2];
    double derivative[3][4] = {
        {2 * (y * c - z * b), 2 * (y * b + z * c), 2 * (w * c + x * b) - 4 * y * a, 2 * (x * c - w * b) - 4 * z * a},
        {2 * (z * a - x * c), 2 * (y * a - w * c) - 4 * x * b, 2 * (x * a + z * c), 2 * (w * a + y * c) - 4 * z * b},
        {2 * (x * b - y * a), 2 * (w * b + z * a) - 4 * x * c, 2 * (z * b - w * a) - 4 * y * c, 2 * (x * a + y * b)},
    };
    for (int i = 0; i < 3; i++) {
        P[i][0] = derivative[i][0];
        for (int j = 1; j < 4; j++) P[i][j] = s * derivative[i][j];
    }
}

/* A step's rotation: half the rotation vector, t = h/2 (omega + h/2 alpha), and its quaternion (cosine, sinc t). */
typedef struct {
    double t[3], square, cosine, sinc;
} step_rotation;

static step_rotation rotation_over(const double *rate, const double *angular, double h) {
    step_rotation r = {.square = 0};
    for (int i = 0; i < 3; i++) {
        r.t[i] = 0.5 * h * (rate[i] + 0.5 * h * angular[i]);
        r.square += r.t[i] * r.t[i];
    }
    double n = r.square; /* accurate to 1e-14 up to 250 rad/s in 10 ms, which a diverging prediction reaches */
    r.cosine = 1 - n / 2 * (1 - n / 12 * (1 - n / 30 * (1 - n / 56 * (1 - n / 90 * (1 - n / 132 * (1 - n / 182 * (1 -
               n / 240 * (1 - n / 306))))))));
    r.sinc = 1 - n / 6 * (1 - n / 20 * (1 - n / 42 * (1 - n / 72 * (1 - n / 110 * (1 - n / 156 * (1 - n / 210 * (1 -
             n / 272 * (1 - n / 342))))))));
    return r;
}

/* The rigid body (13,) after h seconds under mean accelerations: linear, world axes, and angular, body axes. */
static void move_body(const double *x, const double *linear, const double *angular, double h, double *next) {
    step_rotation r = rotation_over(x + RATE, angular, h);
    double w = r.cosine, a = r.sinc * r.t[0], b = r.sinc * r.t[1], c = r.sinc * r.t[2];
    double q[4] = {x[ATTITUDE], x[ATTITUDE + 1], x[ATTITUDE + 2], x[ATTITUDE + 3]}; /* next may be x */
    for (int i = 0; i < 3; i++) {
        next[POSITION + i] = x[POSITION + i] + h * (x[VELOCITY + i] + 0.5 * h * linear[i]);
        next[VELOCITY + i] = x[VELOCITY + i] + h * linear[i];
        next[RATE + i] = x[RATE + i] + h * angular[i];
    }
    next[ATTITUDE] = q[0] * w - q[1] * a - q[2] * b - q[3] * c;
    next[ATTITUDE + 1] = q[0] * a + q[1] * w + q[2] * c - q[3] * b;
    next[ATTITUDE + 2] = q[0] * b - q[1] * c + q[2] * w + q[3] * a;
    next[ATTITUDE + 3] = q[0] * c + q[1] * b - q[2] * a + q[3] * w;
}

/* dq_next = R dq + M dt, t half the rotation vector. */
static void attitude_derivatives(const double *x, const double *angular, double h, double R[4][4], double M[4][3]) {
    step_rotation r = rotation_over(x + RATE, angular, h);
    const double *q = x + ATTITUDE;
    double n = r.square;
    double w = r.cosine, a = r.sinc * r.t[0], b = r.sinc * r.t[1], c = r.sinc * r.t[2];
    double by_attitude[4][4] = {{w, -a, -b, -c}, {a, w, c, -b}, {b, -c, w, a}, {c, b, -a, w}};
    /* d sinc / dn = -1/6 + n/60 - n^2/1680 + n^3/90720, and dn = 2 t dt */
    double slope = -1.0 / 3 * (1 - n / 10 * (1 - n / 28 * (1 - n / 54 * (1 - n / 88 * (1 - n / 130 * (1 - n / 180))))));
    double by_half_rotation[4][3];
    for (int j = 0; j < 3; j++) {
        by_half_rotation[0][j] = -r.sinc * r.t[j];
        for (int i = 0; i < 3; i++) by_half_rotation[1 + i][j] = (i == j ? r.sinc : 0) + slope * r.t[i] * r.t[j];
    }
    double left[4][4] = {
        {q[0], -q[1], -q[2], -q[3]}, {q[1], q[0], -q[3], q[2]}, {q[2], q[3], q[0], -q[1]}, {q[3], -q[2], q[1], q[0]}};
    for (int i = 0; i < 4; i++) {
        for (int j = 0; j < 4; j++) R[i][j] = by_attitude[i][j];
        for (int j = 0; j < 3; j++) {
            M[i][j] = 0;
            for (int k = 0; k < 4; k++) M[i][j] += left[i][k] * by_half_rotation[k][j];
        }
    }
}

#endif

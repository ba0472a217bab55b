/* A setpoint that may be the last one: whether the vehicle stays in its box and above ground if no other follows it.
 *
 * The autopilot holds the last body rates and thrust for `hold` seconds; then its failsafe levels, brakes and sinks to
 * land. Both are predicted with a rigid body that turns as its rate loop does, under thrust, weight and linear drag.
 * Plain C without memory of its own; docs/last_setpoint.md derives it and says what it does not cover. */
#ifndef ALULA_LAST_SETPOINT_H
#define ALULA_LAST_SETPOINT_H

#include <math.h>
#include <string.h>

#include "state.h"

#define LAST_HOLD_STEP 0.05      /* s, of the prediction while the setpoint is held, at most */
#define LAST_FAILSAFE_STEP 0.05  /* s, of the failsafe's */
#define LAST_POSITION_GAIN 0.95  /* MPC_XY_P, 1/s */
#define LAST_VELOCITY_GAIN 1.5   /* MPC_XY_VEL_P_ACC over 1 + MPC_XY_VEL_D_ACC, 1/s */
#define LAST_CLIMB_GAIN 4.0      /* MPC_Z_VEL_P_ACC, 1/s */
#define LAST_SPEED 5.0           /* MPC_XY_CRUISE, m/s */
#define LAST_LEAD 0.5            /* s of the velocity ahead at which PX4's modes stop */
#define LAST_MIN_THRUST 0.12     /* MPC_THR_MIN */
#define LAST_REST 0.3            /* m/s, below which the failsafe has braked */
#define LAST_COUNTER_TILT 0.4    /* rad against the velocity, in which a setpoint that brakes ends at most */
#define LAST_DEVIATION 0.1       /* of the distance travelled, in which failsafes differ from the one predicted */
#define LAST_ROOM 0.5            /* of the way to a side of the box, that the margin takes at most */
#define LAST_ALTERNATIVES 3
#define LAST_BISECTIONS 3        /* between a setpoint that passes and the one that does not: to 1/8 of the way */
#define LAST_TURN 1.6            /* rad, within which the way is looked at: a quarter turn more than it never passes */

enum { LAST_PASSES, LAST_REPLACED, LAST_NONE_PASSES };

/* All that the check knows of vehicle, autopilot and surroundings. */
typedef struct {
    double hold;              /* s from a setpoint until the failsafe acts, at the latest */
    double lag[3];            /* s, of body rates behind their setpoints */
    double thrust_lag;        /* s */
    double mass;              /* kg */
    double drag;              /* linear, over the mass, 1/s */
    double thrust_max;        /* N, by the present effectiveness */
    double rate_max[3];       /* rad/s, of setpoints */
    double attitude_gain;     /* of the failsafe, 1/s */
    double attitude_rate_max; /* of the failsafe, rad/s */
    double sink;              /* m/s, of the failsafe's landing */
    double patience;          /* s of the failsafe that are predicted, at most */
    double low[3], high[3];   /* m, corners of the box; infinite without one */
    double ground;            /* m, height at which the vehicle touches the ground; -infinite where it is not known */
    double edge, spread;      /* m from the box's sides, and m/s by which the prediction's error grows */
    double touch_speed;       /* m/s downwards, up to which a contact is a landing */
    double touch_upright;     /* cosine of the tilt, from which on it is */
} last_setpoint_model;

typedef struct {
    double position[3], velocity[3], attitude[4], rate[3], thrust; /* attitude: body to world, w first */
    double up[3];                                                  /* the body's z axis, world */
    double low[3], high[3]; /* of the box, with where the vehicle is already */
    double room_low[3], room_high[3]; /* m that the margin may take of the way to them */
    double start[3];        /* position when the setpoint begins to act */
    double time;            /* s, since the setpoint */
    double outside, impact; /* m outside of the box at most; m/s of a contact that is no landing */
    int touched;
} last_setpoint_motion;

/* Move by dt seconds under a thrust, N, along `up`, and note what box and ground say. */
static void last_move(const last_setpoint_model *m, last_setpoint_motion *s, double thrust, double dt) {
    double pull = thrust / m->mass;
    s->time += dt;
    double way[3] = {s->position[0] - s->start[0], s->position[1] - s->start[1], s->position[2] - s->start[2]};
    double distance = sqrt(way[0] * way[0] + way[1] * way[1] + way[2] * way[2]);
    double margin = m->edge + m->spread * s->time + LAST_DEVIATION * distance;
    for (int i = 0; i < 3; i++) {
        double a = pull * s->up[i] - m->drag * s->velocity[i] - (i == 2 ? GRAVITY : 0);
        s->position[i] += dt * (s->velocity[i] + 0.5 * dt * a);
        s->velocity[i] += dt * a;
        double below = s->low[i] + fmin(margin, s->room_low[i]) - s->position[i];
        double above = s->position[i] - s->high[i] + fmin(margin, s->room_high[i]);
        s->outside = fmax(s->outside, fmax(below, above));
    }
    double speed = -s->velocity[2], above = s->position[2] - m->ground;
    if (speed < 0 || above > m->spread * s->time) return;
    s->touched = above <= 0;
    if (speed > m->touch_speed || s->up[2] < m->touch_upright) s->touched = 1, s->impact = fmax(speed, 1e-3);
}

static void last_up(const double *q, double *up) {
    up[0] = 2 * (q[1] * q[3] + q[0] * q[2]);
    up[1] = 2 * (q[2] * q[3] - q[0] * q[1]);
    up[2] = 1 - 2 * (q[1] * q[1] + q[2] * q[2]);
}

/* q times r, in q. */
static void last_turn(double *q, const double *r) {
    double w = q[0], x = q[1], y = q[2], z = q[3];
    q[0] = w * r[0] - x * r[1] - y * r[2] - z * r[3];
    q[1] = w * r[1] + x * r[0] + y * r[3] - z * r[2];
    q[2] = w * r[2] - x * r[3] + y * r[0] + z * r[1];
    q[3] = w * r[3] + x * r[2] - y * r[1] + z * r[0];
}

/* A setpoint, body rates (3) and thrust, held for a duration, s: first-order lags, exact in each step but for the
 * change of the axis of rotation; thrust acts along the z axis of the step's middle. */
static void last_hold(const last_setpoint_model *m, last_setpoint_motion *s, const double *rate, double thrust,
                      double duration) {
    if (!(duration > 0)) return;
    int steps = (int)ceil(duration / LAST_HOLD_STEP - 1e-9);
    double dt = duration / steps, share[3], mean[3];
    for (int i = 0; i < 3; i++) share[i] = exp(-dt / m->lag[i]), mean[i] = m->lag[i] / dt * (1 - share[i]);
    double thrust_share = exp(-dt / m->thrust_lag), thrust_mean = m->thrust_lag / dt * (1 - thrust_share);
    for (int k = 0; k < steps && !s->touched; k++) {
        double half[4], square = 0;
        for (int i = 0; i < 3; i++) {
            double behind = s->rate[i] - rate[i];
            half[1 + i] = 0.25 * dt * (rate[i] + mean[i] * behind); /* half the vector of half the step's rotation */
            square += half[1 + i] * half[1 + i];
            s->rate[i] = rate[i] + share[i] * behind;
        }
        double angle = sqrt(square), sinc = angle > 1e-6 ? sin(angle) / angle : 1;
        half[0] = cos(angle);
        for (int i = 1; i < 4; i++) half[i] *= sinc;
        double behind = s->thrust - thrust;
        s->thrust = thrust + thrust_share * behind;
        last_turn(s->attitude, half);
        last_up(s->attitude, s->up);
        last_move(m, s, thrust + thrust_mean * behind, dt);
        last_turn(s->attitude, half);
    }
}

/* The thrust direction (unit) and thrust, N, that PX4's position control wants, braking to a point (2) and sinking. */
static double last_demand(const last_setpoint_model *m, const last_setpoint_motion *s, const double *anchor,
                          double *wanted) {
    double v[2], a[2];
    for (int i = 0; i < 2; i++) v[i] = LAST_POSITION_GAIN * (anchor[i] - s->position[i]);
    double speed = sqrt(v[0] * v[0] + v[1] * v[1]), slower = speed > LAST_SPEED ? LAST_SPEED / speed : 1;
    for (int i = 0; i < 2; i++) a[i] = LAST_VELOCITY_GAIN * (slower * v[i] - s->velocity[i]);
    double sideways = sqrt(a[0] * a[0] + a[1] * a[1]);
    double less = sideways > GRAVITY ? GRAVITY / sideways : 1; /* MPC_TILTMAX_AIR, 45 degrees */
    double length = sqrt(GRAVITY * GRAVITY + less * less * sideways * sideways);
    wanted[0] = less * a[0] / length, wanted[1] = less * a[1] / length, wanted[2] = GRAVITY / length;
    double climb = LAST_CLIMB_GAIN * (-m->sink - s->velocity[2]);
    double thrust = m->mass * (climb + GRAVITY) * length / GRAVITY;
    return fmin(fmax(thrust, LAST_MIN_THRUST * m->thrust_max), m->thrust_max);
}

static int last_rests(const last_setpoint_model *m, const last_setpoint_motion *s) {
    const double *v = s->velocity;
    return v[0] * v[0] + v[1] * v[1] < LAST_REST * LAST_REST && fabs(v[2] + m->sink) < LAST_REST && s->up[2] > 0.97;
}

/* The failsafe, until it has braked: position control as above, attitude control that turns the thrust axis there by
 * the shorter way, 2 sin(angle / 2) times its gain fast, behind the rate loop's lag. */
static void last_failsafe(const last_setpoint_model *m, last_setpoint_motion *s) {
    const double dt = LAST_FAILSAFE_STEP, *q = s->attitude;
    double share = 1 - exp(-dt / m->lag[0]), thrust_share = 1 - exp(-dt / m->thrust_lag), turning[3], wanted[3];
    double x[3] = {1 - 2 * (q[2] * q[2] + q[3] * q[3]), 2 * (q[1] * q[2] + q[0] * q[3]),
                   2 * (q[1] * q[3] - q[0] * q[2])};
    double y[3] = {2 * (q[1] * q[2] - q[0] * q[3]), 1 - 2 * (q[1] * q[1] + q[3] * q[3]),
                   2 * (q[2] * q[3] + q[0] * q[1])};
    for (int i = 0; i < 3; i++) turning[i] = s->rate[0] * x[i] + s->rate[1] * y[i]; /* of the z axis, world */
    last_up(q, s->up);
    double anchor[2] = {s->position[0] + LAST_LEAD * s->velocity[0], s->position[1] + LAST_LEAD * s->velocity[1]};
    int steps = (int)(m->patience / dt);
    for (int k = 0; k < steps && !s->touched && !last_rests(m, s); k++) {
        double demand = last_demand(m, s, anchor, wanted), *z = s->up;
        double cosine = z[0] * wanted[0] + z[1] * wanted[1] + z[2] * wanted[2];
        double axis[3] = {z[1] * wanted[2] - z[2] * wanted[1], z[2] * wanted[0] - z[0] * wanted[2],
                          z[0] * wanted[1] - z[1] * wanted[0]};
        if (cosine < -0.9995) axis[0] = 0.03, axis[1] = axis[2] = 0; /* upside down: whichever way */
        double gain = m->attitude_gain * sqrt(2 / fmax(1 + cosine, 1e-3));
        double rate = gain * sqrt(axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2]);
        if (rate > m->attitude_rate_max) gain *= m->attitude_rate_max / rate;
        for (int i = 0; i < 3; i++) turning[i] += share * (gain * axis[i] - turning[i]);
        double next[3] = {z[0] + dt * (turning[1] * z[2] - turning[2] * z[1]),
                          z[1] + dt * (turning[2] * z[0] - turning[0] * z[2]),
                          z[2] + dt * (turning[0] * z[1] - turning[1] * z[0])};
        double norm = 1 / sqrt(next[0] * next[0] + next[1] * next[1] + next[2] * next[2]);
        for (int i = 0; i < 3; i++) z[i] = norm * next[i];
        s->thrust += thrust_share * (demand - s->thrust);
        last_move(m, s, s->thrust, dt);
    }
}

/* Metres outside of the box plus m/s of an impact if a setpoint is the last one; 0 where it passes. */
static double last_harm(const last_setpoint_model *m, const last_setpoint_motion *acting, const double *setpoint) {
    last_setpoint_motion s = *acting;
    last_hold(m, &s, setpoint, setpoint[3], m->hold);
    if (!s.touched) last_failsafe(m, &s);
    double sum = s.position[0] + s.position[1] + s.position[2];
    return isfinite(sum) ? s.outside + s.impact : INFINITY; /* nan in a maximum would pass */
}

static double last_clip(double value, double limit) { return fmin(fmax(value, -limit), limit); }

/* A setpoint (4) that ends upright, or tilted by up to `tilt` rad against the velocity, and not falling. */
static void last_alternative(const last_setpoint_model *m, const last_setpoint_motion *s, int levels, double tilt,
                             double *setpoint) {
    const double *q = s->attitude, *v = s->velocity;
    double up[3], target[3] = {0, 0, 1}, speed = sqrt(v[0] * v[0] + v[1] * v[1]);
    last_up(q, up);
    if (speed > 1e-3) {
        double tangent = tan(fmin(tilt, 0.3 * tilt * speed)), length = sqrt(1 + tangent * tangent);
        target[0] = -tangent * v[0] / speed / length, target[1] = -tangent * v[1] / speed / length;
        target[2] = 1 / length;
    }
    /* angle and axis, world, then body: R' axis */
    double c[3] = {up[1] * target[2] - up[2] * target[1], up[2] * target[0] - up[0] * target[2],
                   up[0] * target[1] - up[1] * target[0]};
    double sine = sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2]);
    double cosine = up[0] * target[0] + up[1] * target[1] + up[2] * target[2];
    double per = levels && sine > 1e-9 ? atan2(sine, cosine) / sine / fmax(m->hold - m->lag[0], m->lag[0]) : 0;
    double back[4] = {q[0], -q[1], -q[2], -q[3]}, turned[4] = {0, per * c[0], per * c[1], per * c[2]};
    last_turn(back, turned);
    last_turn(back, q);
    for (int i = 0; i < 2; i++) setpoint[i] = last_clip(back[1 + i], m->rate_max[i]);
    setpoint[2] = 0;
    double upright = fmax(levels ? 0.5 * (up[2] + target[2]) : up[2], 0.5);
    double climb = last_clip(-v[2] / m->hold, 0.5 * GRAVITY);
    setpoint[3] = fmin(fmax(m->mass * (GRAVITY + climb) / upright, 0), m->thrust_max);
}

/* The motion when a setpoint begins to act, from a state (13) of `age` seconds before. */
static last_setpoint_motion last_acting(const last_setpoint_model *m, const double *state, double age, double thrust_now) {
    last_setpoint_motion s = {.thrust = thrust_now};
    memcpy(s.position, state + POSITION, sizeof s.position), memcpy(s.velocity, state + VELOCITY, sizeof s.velocity);
    memcpy(s.attitude, state + ATTITUDE, sizeof s.attitude), memcpy(s.rate, state + RATE, sizeof s.rate);
    for (int i = 0; i < 3; i++) {
        s.low[i] = -INFINITY, s.high[i] = INFINITY;
    }
    last_hold(m, &s, state + RATE, thrust_now, age);
    s.touched = 0, s.outside = s.impact = s.time = 0;
    memcpy(s.start, s.position, sizeof s.start);
    for (int i = 0; i < 3; i++) {
        s.low[i] = fmin(m->low[i], s.position[i]), s.high[i] = fmax(m->high[i], s.position[i]);
        s.room_low[i] = LAST_ROOM * (s.position[i] - s.low[i]);
        s.room_high[i] = LAST_ROOM * (s.high[i] - s.position[i]);
    }
    return s;
}

/* The harm of a setpoint alone; arguments as below. */
double last_setpoint_harm(const last_setpoint_model *m, const double *state, double age, double thrust_now,
                          const double *setpoint) {
    last_setpoint_motion s = last_acting(m, state, age, thrust_now);
    return last_harm(m, &s, setpoint);
}

/* Check body rates (3), rad/s, and thrust, N, within their limits, before they leave, and replace them where they must
 * not be the last ones: by the nearest setpoint that passes on a line to one that levels, brakes or stays, else by the least harmful one.
 *
 * state: (13) position, velocity, attitude, rates, as they were `age` seconds before the setpoint acts. thrust_now: N,
 * that acts until then. harm: (2) of the setpoint as given and of the one that leaves, metres outside of the box plus m/s
 * of an impact. Returns LAST_PASSES, LAST_REPLACED or LAST_NONE_PASSES. */
int last_setpoint_check(const last_setpoint_model *m, const double *state, double age, double thrust_now,
                        double *setpoint, double *harm) {
    last_setpoint_motion s = last_acting(m, state, age, thrust_now);
    for (int i = 0; i < 3; i++) setpoint[i] = last_clip(setpoint[i], m->rate_max[i]);
    setpoint[3] = fmin(fmax(setpoint[3], 0), m->thrust_max);
    harm[0] = harm[1] = last_harm(m, &s, setpoint);
    if (harm[0] == 0) return LAST_PASSES;
    double best[4], given[4];
    memcpy(given, setpoint, sizeof given), memcpy(best, setpoint, sizeof best);
    for (int k = 0; k < LAST_ALTERNATIVES && harm[1] > 0; k++) {
        double other[4];
        last_alternative(m, &s, k < 2, k == 1 ? LAST_COUNTER_TILT : 0, other);
        double of_other = last_harm(m, &s, other);
        if (of_other < harm[1]) harm[1] = of_other, memcpy(best, other, sizeof best);
    }
    memcpy(setpoint, best, sizeof best);
    if (harm[1] > 0) return LAST_NONE_PASSES;
    double apart[3], angle = 0; /* by which both turn the vehicle differently */
    for (int i = 0; i < 3; i++) apart[i] = m->hold * (given[i] - best[i]), angle += apart[i] * apart[i];
    double passing = 0, failing = fmin(1, LAST_TURN / fmax(sqrt(angle), 1e-9));
    for (int k = 0; k < LAST_BISECTIONS; k++) {
        double share = 0.5 * (passing + failing), between[4];
        for (int i = 0; i < 4; i++) between[i] = best[i] + share * (given[i] - best[i]);
        if (last_harm(m, &s, between) > 0) {
            failing = share;
        } else {
            passing = share;
            memcpy(setpoint, between, sizeof between);
        }
    }
    return LAST_REPLACED;
}
#endif

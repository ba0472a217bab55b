/* The urgent half of a tick: from a datagram of the autopilot to the setpoint that answers it, in one call.
 *
 * alula_tick reads MAVLink 2 frames, takes the vehicle's ODOMETRY, checks it, predicts the state at which a command acts,
 * lets the solver answer it, limits the answer, packs and signs SET_ATTITUDE_TARGET, and sends it where it is given a
 * socket. Where anything is unusual it does nothing and names the reason: who calls it has another way for that tick.
 *
 * Everything is plain data, in SI units, world ENU, body FLU, attitudes body to world with w first; times are seconds of
 * one monotonic clock. Python reads the structs below from this file: one member a line. */
#ifndef ALULA_TICK_H
#define ALULA_TICK_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define ALULA_STATE 13    /* numbers of a rigid body's state: position, velocity, attitude, body rates */
#define ALULA_STATES 64   /* at most, of a model's whole state */
#define ALULA_ROTORS 16   /* at most */
#define ALULA_LAGS 4      /* at most, of rotor speeds that a model lets lag */
#define ALULA_KINDS 512   /* of messages, at most */
#define ALULA_LINKS 256   /* of signed streams */
#define ALULA_FRAME 300   /* bytes, at least those of a frame */

/* Why a tick was left to its caller; ALULA_SENT where it was not. */
enum {
    ALULA_SENT = 0,
    ALULA_NO_ESTIMATE,   /* the datagram holds no ODOMETRY of the vehicle */
    ALULA_NOT_FRAMES,    /* it holds bytes that are no whole frame, or more than one estimate */
    ALULA_NOT_DUE,       /* the estimate came before the next tick is due */
    ALULA_SIGNATURE,     /* unsigned, signed with another key, or sent before */
    ALULA_CLOCK,         /* the vehicle's clock is not followed, or the stamp is not of it */
    ALULA_AXES,          /* frames in which the estimate is not usable */
    ALULA_NOT_FINITE,    /* a number that is none, or no unit quaternion */
    ALULA_OUT_OF_RANGE,  /* farther or faster than a local frame allows */
    ALULA_NOT_NEXT,      /* no estimate before it, an older one, or one after a long silence */
    ALULA_RESET,         /* the estimator was reset */
    ALULA_JUMP,          /* it moved farther than motion explains */
    ALULA_FROZEN,        /* the same as the one before, to the last bit */
    ALULA_STALE,         /* too old for the model to predict the present state from it */
    ALULA_SOLVER,        /* no answer that may be sent */
};

typedef void (*alula_propagate)(void *solver, const double *state, const double *speeds, double seconds, double *next);
typedef int (*alula_feedback)(void *solver, const double *state);
typedef int (*alula_check)(const void *model, const double *state, double age, double thrust_now, double *setpoint,
                           double *harm);

/* A solver that is prepared for this tick: a kernel's rti_propagate, rti_feedback, rti_states and rti_inputs, and its
 * last_setpoint_check (last_setpoint.h). */
typedef struct {
    void *handle;
    alula_propagate propagate;
    alula_feedback feedback;
    alula_check check;
    const double *states; /* (nodes + 1, state_count) predicted */
    const double *inputs; /* (nodes, rotor_count) predicted rotor speeds, rad/s */
    int32_t state_count;
    int32_t rotor_count;
} alula_solver;

/* The vehicle, its autopilot and its controller; constant in flight. */
typedef struct {
    double rate_limit[3];                 /* rad/s */
    double thrust_limit;                  /* N, of all rotors */
    double thrust_max;                    /* N, that a setpoint of 1 stands for at effectiveness 1 */
    double vehicle_curve;                 /* thrust over signal, of the vehicle file */
    double autopilot_curve;               /* THR_MDL_FAC */
    double thrust_constants[ALULA_ROTORS]; /* N s^2/rad^2 */
    double node;                          /* s between the solver's first two nodes */
    double max_step;                      /* s that the model is propagated in one piece */
    double delay;                         /* s from a command's departure to its action */
    double lead[3];                       /* s along the slope of the rates at which setpoints are read */
    double lookahead[3];                  /* the same in nodes, where the slope is that of the prediction */
    int32_t leads_lag;                    /* whether the slope is that of the commanded speeds */
    int32_t lag_count;                    /* lags of rotor speeds in the state */
    int32_t lag_start[ALULA_LAGS];        /* where each begins */
    int32_t hidden_count;                 /* numbers of the state beyond the rigid body's */
} alula_vehicle;

/* Limits that estimates have to keep, and how the wire's numbers become a state. */
typedef struct {
    double position_noise;   /* m */
    double velocity_noise;   /* m/s */
    double attitude_noise;   /* rad */
    double max_acceleration; /* m/s^2 */
    double max_rate;         /* rad/s */
    double attitude_length;  /* deviation of the quaternion's length from 1 */
    double max_distance;     /* m */
    double max_speed;        /* m/s */
    double forgotten_after;  /* s of silence */
    double max_stamp_age;    /* s */
    double max_stamp_ahead;  /* s */
    double stale;            /* s since the arrival */
    double oldest;           /* s since the stamp */
    double mean_time;        /* s within which the velocity's mean follows the position's slope */
    double max_gap;          /* s between two estimates whose slope counts */
    double max_mismatch;     /* m/s of one slope that counts */
    double max_correction;   /* m/s */
    double factor[ALULA_STATE];  /* state = factor * wire[first] + other * wire[second] */
    double other[ALULA_STATE];
    int32_t first[ALULA_STATE];
    int32_t second[ALULA_STATE];
} alula_limits;

/* Messages by rising id, with the byte that ties a checksum to a definition, and the greatest payload. */
typedef struct {
    int32_t count;
    uint32_t id[ALULA_KINDS];
    uint8_t extra[ALULA_KINDS];
    uint8_t size[ALULA_KINDS];
} alula_messages;

/* The link as it is known: who is at its ends, the vehicle's clock, the newest estimate. */
typedef struct {
    int32_t system;          /* the vehicle's */
    int32_t component;
    int32_t own_system;
    int32_t own_component;
    int32_t socket;          /* connected to the vehicle; -1: the caller sends the frame */
    int32_t has_latest;      /* whether there is an estimate by ODOMETRY and the vehicle's clock */
    int32_t latest_reset;    /* its reset counter */
    int32_t is_signed;       /* whether frames are signed */
    double clock_updated;    /* ours = updated + (theirs - offset - updated) / (1 + drift) */
    double clock_offset;
    double clock_drift;
    double clock_valid_until;
    double latest_time;      /* s, when its state held */
    double latest_received;  /* s, when it arrived */
    double latest_stamp;     /* s, of the vehicle */
    double latest_state[ALULA_STATE];
    double ticks_origin;     /* s, at which the signing clock had ticks_base */
    int64_t ticks_base;      /* 10 us since 2015 */
    int64_t last_timestamp;  /* of the newest frame that was signed for setpoints */
    int64_t heard[ALULA_LINKS]; /* the newest timestamp of the vehicle's stream with this link id, -1 for none */
    uint8_t key[32];
    int32_t link_id;         /* of setpoints */
} alula_link;

/* One tick, as it was prepared. The histories belong to the caller and stay as they are until the tick is over. */
typedef struct {
    const double *command_times;  /* (history,) s, when the commands before acted */
    const double *command_inputs; /* (history, rotor_count) rad/s */
    const double *hidden_states;  /* (history, hidden_count) at those times */
    int64_t commands;             /* so far; the newest is at (commands - 1) % history */
    int32_t history;
    int32_t has_before;           /* whether an estimate was flown before */
    int32_t hands_over;           /* whether thrust goes over from another one */
    int32_t padding;
    double not_before;            /* s, arrival of the first estimate that is due */
    double before_time;           /* s */
    double before_state[ALULA_STATE]; /* as it was received */
    double correction[3];         /* m/s, of its velocity */
    double tilt_rate;             /* rad/s, limit of roll and pitch rates */
    double hand_over_started;     /* s */
    double hand_over_thrust;      /* N */
    double hand_over_duration;    /* s */
    double effectiveness;         /* thrust per modelled thrust */
    const void *last_setpoint;    /* a last_setpoint_model by which setpoints are checked; 0: they are not */
    double transit;               /* s from now until a setpoint acts, for that check */
    double thrust_now;            /* N, of the setpoint before, which acts until then */
} alula_plan;

/* Everything that a tick has used and decided. */
typedef struct {
    int32_t reason;
    int32_t status;            /* of the solver: 0 solved, 1 cut short within its limits */
    int32_t reset_counter;
    int32_t frame_size;
    int32_t is_taken;          /* whether the operating system took the frame; 1 without a socket */
    int32_t padding;
    double received;           /* s, arrival of the datagram */
    double now;                /* s, when the tick ran */
    double departed;           /* s */
    double busy;               /* s of the processor */
    double stamp;              /* s, of the vehicle */
    double time;               /* s, when the state held */
    double state[ALULA_STATE]; /* as received */
    double corrected[ALULA_STATE]; /* with its velocity corrected, by: */
    double correction[3];
    double measured[ALULA_STATES]; /* the model's whole state then */
    double acting[ALULA_STATES];   /* the same when the command acts */
    double rotor_speed[ALULA_ROTORS];
    double solved_rate[3];     /* of the controller, before limits */
    double solved_thrust;
    double rate[3];            /* rad/s, as sent */
    double collective_thrust;  /* N, that it stands for */
    double thrust;             /* 0..1, as sent */
    int64_t timestamp;         /* of the signature, -1 without one */
    uint8_t frame[ALULA_FRAME];
} alula_result;

/* All of a tick. */
typedef struct {
    alula_solver solver;
    alula_vehicle vehicle;
    alula_limits limits;
    alula_messages messages;
    alula_link link;
    alula_plan plan;
    uint32_t sequence; /* of the next frame that leaves; others that send under the same ids count it on */
} alula_context;

/* The answer to a datagram that arrived at a time, s, computed now, s. Returns the reason, ALULA_SENT where a setpoint
 * has left, or is in the result's frame where there is no socket; then the link's newest estimate is this one. */
int alula_tick(alula_context *context, const uint8_t *datagram, int size, double received, double now,
               alula_result *result);

/* The answer to an estimate that was read: the second half of alula_tick. The result holds its arrival, time, stamp, state
 * and reset counter. */
int alula_answer(alula_context *context, double now, alula_result *result);

/* Take a datagram's estimate as the first one, which there is nothing to compare with, and the vehicle's clock as it is by
 * this one stamp: for a node that exchanges no TIMESYNC. */
int alula_begin(alula_context *context, const uint8_t *datagram, int size, double received, alula_result *result);

/* The estimate of a datagram alone, with its checks: the first half of alula_tick. */
int alula_read(const alula_context *context, const uint8_t *datagram, int size, double received, alula_result *result);

#ifdef __cplusplus
}
#endif

#endif

/* A thread of its own that reads a vehicle's socket: it answers an estimate by alula_tick where a tick is armed, and
 * passes every datagram on to Python, which it never waits for.
 *
 * Who may touch what: a plan belongs to Python until it is armed, and again once the tick is over; the link as it is known
 * comes under the lock. A tick that was left to Python is disarmed with it, so that nothing is answered twice. */
#include "tick.c"

#include <errno.h>
#include <netinet/in.h>
#include <pthread.h>
#include <sched.h>
#include <stdatomic.h>
#include <stdlib.h>

#define SLOTS 256         /* datagrams that Python has not read yet */
#define MAX_DATAGRAM 65536
#define MAX_AGE 1.0       /* s, of a datagram by the wall clock, which may have been set meanwhile */

enum { IDLE, ARMED, TICKING, SENT, REFUSED };

typedef struct {
    double received;
    int32_t size;
    int32_t error;   /* of the socket, 0 for none */
    int32_t answered; /* whether a setpoint answered it; then its estimate: */
    int32_t reset_counter;
    double time;     /* s, when the state held */
    double stamp;    /* s, of the vehicle */
    double state[ALULA_STATE];
    uint8_t address[32];
    uint8_t *bytes;
} alula_datagram;

typedef struct {
    alula_context context;
    alula_link link;     /* by Python, under the lock */
    alula_result result;
    pthread_t thread;
    pthread_mutex_t lock;
    pthread_cond_t filled, over;
    atomic_int stage, disarmed, stopping;
    unsigned head, tail;
    int socket;
    alula_datagram slots[SLOTS];
    uint8_t bytes[SLOTS][MAX_DATAGRAM];
} receiver;

/* Arrival of a datagram, s: by the kernel's stamp, so that waiting for the processor counts as its age. */
static double arrival(struct msghdr *message, double now) {
    for (struct cmsghdr *part = CMSG_FIRSTHDR(message); part; part = CMSG_NXTHDR(message, part)) {
        if (part->cmsg_level != SOL_SOCKET || part->cmsg_type != SCM_TIMESTAMPNS) continue;
        struct timespec stamp, wall;
        memcpy(&stamp, CMSG_DATA(part), sizeof stamp);
        clock_gettime(CLOCK_REALTIME, &wall);
        const double age = (double)((int64_t)(wall.tv_sec - stamp.tv_sec) * 1000000000 + (wall.tv_nsec - stamp.tv_nsec)) * 1e-9;
        if (0.0 <= age && age < MAX_AGE) return now - age;
    }
    return now;
}

/* Answer a datagram where a tick is armed; whether it was. */
static bool answer(receiver *r, alula_datagram *datagram, double now) {
    int armed = ARMED;
    if (!atomic_compare_exchange_strong(&r->stage, &armed, TICKING)) return false;
    pthread_mutex_lock(&r->lock);
    const int64_t newest = r->context.link.last_timestamp;
    r->context.link = r->link;
    if (newest > r->context.link.last_timestamp) r->context.link.last_timestamp = newest;
    pthread_mutex_unlock(&r->lock);
    const int reason = alula_tick(&r->context, datagram->bytes, datagram->size, datagram->received, now, &r->result);
    pthread_mutex_lock(&r->lock);
    if (reason == ALULA_SENT) {
        take_estimate(&r->context, &r->link, datagram->bytes, datagram->size, &r->result);
        datagram->reset_counter = r->result.reset_counter;
        datagram->time = r->result.time, datagram->stamp = r->result.stamp;
        memcpy(datagram->state, r->result.state, sizeof datagram->state);
    }
    /* what is not the tick's leaves it armed, unless it was disarmed meanwhile */
    const bool waits = reason == ALULA_NO_ESTIMATE || reason == ALULA_NOT_DUE;
    atomic_store(&r->stage, reason == ALULA_SENT ? SENT : waits && !atomic_load(&r->disarmed) ? ARMED : REFUSED);
    pthread_cond_broadcast(&r->over);
    pthread_mutex_unlock(&r->lock);
    return reason == ALULA_SENT;
}

/* One priority above the thread that started this one: Python's threads of that priority would run on until they wait. */
static void rise(void) {
    struct sched_param scheduling;
    int policy;
    if (pthread_getschedparam(pthread_self(), &policy, &scheduling) || policy != SCHED_FIFO) return;
    scheduling.sched_priority++;
    pthread_setschedparam(pthread_self(), policy, &scheduling); /* where that is refused it stays as it is */
}

static void *receive(void *argument) {
    receiver *r = argument;
    rise();
    while (!atomic_load(&r->stopping)) {
        alula_datagram *next = &r->slots[r->tail % SLOTS];
        pthread_mutex_lock(&r->lock);
        while (r->tail - r->head == SLOTS && !atomic_load(&r->stopping)) pthread_cond_wait(&r->over, &r->lock);
        pthread_mutex_unlock(&r->lock);
        uint8_t control[128];
        struct iovec part = {next->bytes, MAX_DATAGRAM};
        struct msghdr message = {.msg_name = next->address, .msg_namelen = sizeof next->address,
                                 .msg_iov = &part, .msg_iovlen = 1, .msg_control = control,
                                 .msg_controllen = sizeof control};
        const ssize_t size = recvmsg(r->socket, &message, 0);
        if (size < 0 && (errno == EAGAIN || errno == EWOULDBLOCK || errno == EINTR)) continue;
        const double now = clock_now();
        next->error = size < 0 ? errno : 0;
        next->size = size < 0 ? 0 : (int32_t)size;
        next->received = size < 0 ? now : arrival(&message, now);
        next->answered = size > 0 && answer(r, next, now);
        pthread_mutex_lock(&r->lock);
        r->tail++;
        pthread_cond_signal(&r->filled);
        pthread_mutex_unlock(&r->lock);
    }
    return 0;
}

/* A receiver of a socket that gives up a wait by itself, with SO_TIMESTAMPNS; 0 without memory or a thread. It takes the
 * scheduling of the thread that calls this. */
receiver *receiver_start(int socket) {
    receiver *r = calloc(1, sizeof *r);
    if (!r) return 0;
    pthread_condattr_t clock;
    pthread_condattr_init(&clock);
    pthread_condattr_setclock(&clock, CLOCK_MONOTONIC);
    pthread_mutex_init(&r->lock, 0);
    pthread_cond_init(&r->filled, &clock);
    pthread_cond_init(&r->over, &clock);
    pthread_condattr_destroy(&clock);
    r->socket = socket;
    for (int i = 0; i < SLOTS; i++) r->slots[i].bytes = r->bytes[i];
    if (pthread_create(&r->thread, 0, receive, r)) {
        free(r);
        return 0;
    }
    return r;
}

/* End the thread; nothing is answered after this. */
void receiver_stop(receiver *r) {
    atomic_store(&r->stopping, 1);
    pthread_mutex_lock(&r->lock);
    pthread_cond_broadcast(&r->over);
    pthread_mutex_unlock(&r->lock);
    pthread_join(r->thread, 0);
}

void receiver_free(receiver *r) { free(r); }

alula_context *receiver_context(receiver *r) { return &r->context; }
alula_result *receiver_result(receiver *r) { return &r->result; }

/* Number of datagrams that wait to be read. */
int receiver_waiting(receiver *r) {
    pthread_mutex_lock(&r->lock);
    const int waiting = (int)(r->tail - r->head);
    pthread_mutex_unlock(&r->lock);
    return waiting;
}

/* The oldest datagram that was not read, or 0 after some seconds without one. It stays until `receiver_read`. */
const alula_datagram *receiver_next(receiver *r, double seconds) {
    struct timespec until;
    clock_gettime(CLOCK_MONOTONIC, &until);
    const int64_t nanoseconds = until.tv_nsec + (int64_t)(seconds * 1e9);
    until.tv_sec += nanoseconds / 1000000000, until.tv_nsec = nanoseconds % 1000000000;
    pthread_mutex_lock(&r->lock);
    while (r->tail == r->head)
        if (pthread_cond_timedwait(&r->filled, &r->lock, &until)) break;
    const alula_datagram *next = r->tail == r->head ? 0 : &r->slots[r->head % SLOTS];
    pthread_mutex_unlock(&r->lock);
    return next;
}

/* Give the oldest datagram's place back. */
void receiver_read(receiver *r) {
    pthread_mutex_lock(&r->lock);
    r->head++;
    pthread_cond_broadcast(&r->over);
    pthread_mutex_unlock(&r->lock);
}

/* Take the link as Python knows it; an estimate that was answered meanwhile stays the newest. */
void receiver_know(receiver *r, const alula_link *link) {
    pthread_mutex_lock(&r->lock);
    const alula_link before = r->link;
    r->link = *link;
    if (link->has_latest && before.has_latest && before.latest_received > link->latest_received) {
        r->link.latest_time = before.latest_time, r->link.latest_received = before.latest_received;
        r->link.latest_stamp = before.latest_stamp, r->link.latest_reset = before.latest_reset;
        memcpy(r->link.latest_state, before.latest_state, sizeof before.latest_state);
    }
    for (int i = 0; i < ALULA_LINKS; i++)
        if (before.heard[i] > r->link.heard[i]) r->link.heard[i] = before.heard[i];
    pthread_mutex_unlock(&r->lock);
}

/* Arm a tick as the context's plan says. */
void receiver_arm(receiver *r) {
    atomic_store(&r->disarmed, 0);
    atomic_store(&r->stage, ARMED);
}

/* Disarm without waiting, as after news that a tick must not leave out; an answer on its way goes on. */
void receiver_disarm(receiver *r) {
    int armed = ARMED;
    atomic_store(&r->disarmed, 1);
    atomic_compare_exchange_strong(&r->stage, &armed, REFUSED);
}

/* Disarm. Returns whether a setpoint has left, as receiver_claim, or -1 while a tick runs. */
int receiver_try_claim(receiver *r) {
    receiver_disarm(r);
    if (atomic_load(&r->stage) == TICKING) return -1;
    return atomic_exchange(&r->stage, IDLE) == SENT;
}

/* Disarm, and wait for a tick that runs. Returns whether a setpoint has left, whose result then is valid until the next
 * tick is armed. */
int receiver_claim(receiver *r) {
    receiver_disarm(r);
    pthread_mutex_lock(&r->lock);
    while (atomic_load(&r->stage) == TICKING) pthread_cond_wait(&r->over, &r->lock);
    pthread_mutex_unlock(&r->lock);
    return atomic_exchange(&r->stage, IDLE) == SENT;
}

uint32_t receiver_sequence(receiver *r) { return __atomic_fetch_add(&r->context.sequence, 1, __ATOMIC_RELAXED); }

/* Sizes of the structs, for the loader to compare with its own. */
void alula_sizes(int32_t *sizes) {
    const int32_t built[] = {sizeof(alula_solver), sizeof(alula_vehicle), sizeof(alula_limits), sizeof(alula_messages),
                             sizeof(alula_link), sizeof(alula_plan), sizeof(alula_result), sizeof(alula_context),
                             sizeof(alula_datagram)};
    memcpy(sizes, built, sizeof built);
}

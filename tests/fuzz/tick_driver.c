/* Gives mutated datagrams to alula_tick, under the sanitizers that it is compiled with: a fault ends the program. Reads the
 * known messages, limits, and two datagrams with their sizes, one signed with a key of zeros; takes a seed and how many
 * datagrams to try; writes how many were answered. Every other one has a right checksum again after its mutation. */
#include <stdio.h>
#include <stdlib.h>

#include "tick.c"

static uint64_t randomness;
static uint32_t below(uint32_t n) { /* xorshift64* */
    randomness ^= randomness >> 12, randomness ^= randomness << 25, randomness ^= randomness >> 27;
    return (uint32_t)((randomness * 2685821657736338717ull) >> 32) % n;
}

static double states[2][ALULA_STATE], inputs[4] = {900, 900, 900, 900}, times[64], commands[64][4], hidden[1];
static void hold(void *solver, const double *state, const double *speeds, double seconds, double *next) {
    (void)solver, (void)speeds, (void)seconds;
    memcpy(next, state, sizeof(double) * ALULA_STATE);
}
static int solved(void *solver, const double *state) {
    (void)solver;
    for (int i = 0; i < ALULA_STATE; i++) states[0][i] = states[1][i] = state[i];
    return (int)below(3);
}

static void pull(void *to, size_t bytes) {
    if (fread(to, 1, bytes, stdin) != bytes) exit(2);
}

int main(int count, char **words) {
    static alula_context context, begun;
    static alula_result result;
    uint8_t seeds[2][400];
    int32_t sizes[2], answered = 0;
    if (count != 3) return 2;
    randomness = strtoull(words[1], 0, 10) * 2654435769u + 1;
    pull(&context.messages, sizeof context.messages), pull(&context.limits, sizeof context.limits);
    for (int i = 0; i < 2; i++) pull(&sizes[i], sizeof *sizes), pull(seeds[i], (size_t)sizes[i]);
    context.solver = (alula_solver){.propagate = hold, .feedback = solved, .states = &states[0][0], .inputs = inputs,
                                  .state_count = ALULA_STATE, .rotor_count = 4};
    context.vehicle.thrust_max = context.vehicle.thrust_limit = 9, context.vehicle.node = context.vehicle.max_step = 0.05;
    context.plan.command_times = times, context.plan.command_inputs = &commands[0][0], context.plan.hidden_states = hidden;
    context.plan.commands = 70, context.plan.history = 64, context.plan.effectiveness = 1;
    context.link.system = context.link.component = 1, context.link.socket = -1;
    for (int i = 0; i < 64; i++) times[i] = i * 0.01;
    if (alula_begin(&context, seeds[0], sizes[0], 1.0, &result)) return 3;
    context.link.latest_stamp -= 0.005, context.link.latest_time -= 0.005, context.limits.oldest = 2;
    begun = context;
    for (long n = strtol(words[2], 0, 10); n > 0; n--) {
        const int which = (int)below(2), parts = 1 + (int)below(3);
        int size = 0;
        uint8_t *datagram = malloc(1200); /* of its own size below, so that a byte too far is seen */
        for (int part = 0; part < parts; part++) memcpy(datagram + size, seeds[which], (size_t)sizes[which]), size += sizes[which];
        for (int changes = (int)below(6); changes > 0; changes--) datagram[below((uint32_t)size)] = (uint8_t)below(256);
        if (below(2) && datagram[0] == MAGIC_V2 && HEADER_V2 + datagram[1] + CHECKSUM <= size) {
            const uint32_t id = datagram[7] | (uint32_t)datagram[8] << 8 | (uint32_t)datagram[9] << 16;
            const int kind = kind_of(&context.messages, id), length = HEADER_V2 + datagram[1];
            const uint16_t crc = checksum(datagram + 1, length - 1, kind < 0 ? 0 : context.messages.extra[kind]);
            datagram[length] = (uint8_t)crc, datagram[length + 1] = (uint8_t)(crc >> 8);
        }
        if (!below(3)) size = (int)below((uint32_t)size + 1);
        datagram = realloc(datagram, (size_t)size + !size);
        context = begun, context.link.is_signed = which;
        const double received = 1.0 + 1e-3 * below(1000);
        answered += !alula_tick(&context, datagram, size, received, received + 1e-3, &result);
        free(datagram);
    }
    printf("%d\n", answered);
    return 0;
}

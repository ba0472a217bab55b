/* MAVLink 2 on the wire: frames, checksums, signatures, ODOMETRY in and SET_ATTITUDE_TARGET out. */
#ifndef ALULA_WIRE_H
#define ALULA_WIRE_H

#include <stdbool.h>

#include "sha256.h"
#include "tick.h"

#define MAGIC_V1 0xfe
#define MAGIC_V2 0xfd
#define HEADER_V1 6
#define HEADER_V2 10
#define CHECKSUM 2
#define SIGNATURE 13 /* link id, 6 bytes of timestamp, 6 of the signature */
#define SIGNED 1
#define ODOMETRY_ID 331
#define ODOMETRY_SIZE 231 /* of the part that is used; the frames and the reset counter are behind two covariances */
#define ODOMETRY_FRAMES 228
#define LOCAL_NED 1
#define BODY_FRD 12
#define SET_ATTITUDE_TARGET_ID 82
#define SET_ATTITUDE_TARGET_SIZE 39 /* without the extension, whose zeros MAVLink 2 omits */
#define SET_ATTITUDE_TARGET_EXTRA 49
#define ATTITUDE_IGNORED 128 /* body rates and thrust count */

static uint16_t checksum(const uint8_t *bytes, int size, uint8_t extra) {
    uint16_t crc = 0xffff;
    for (int i = 0; i <= size; i++) {
        uint8_t next = (i < size ? bytes[i] : extra) ^ (uint8_t)(crc & 0xff);
        next ^= (uint8_t)(next << 4);
        crc = (uint16_t)(crc >> 8 ^ (uint16_t)next << 8 ^ (uint16_t)next << 3 ^ (uint16_t)next >> 4);
    }
    return crc;
}

/* Place of a message among the known ones, -1 for none. */
static int kind_of(const alula_messages *messages, uint32_t id) {
    int low = 0, high = messages->count - 1;
    while (low <= high) {
        const int middle = (low + high) / 2;
        if (messages->id[middle] == id) return middle;
        if (messages->id[middle] < id) low = middle + 1;
        else high = middle - 1;
    }
    return -1;
}

/* Length of the whole frame that these bytes begin with, 0 where they begin with none. */
static int frame_length(const alula_messages *messages, const uint8_t *bytes, int size) {
    if (size < HEADER_V1 + CHECKSUM || (bytes[0] != MAGIC_V1 && bytes[0] != MAGIC_V2)) return 0;
    const bool second = bytes[0] == MAGIC_V2;
    const int header = second ? HEADER_V2 : HEADER_V1, payload = bytes[1];
    if (second && (size < HEADER_V2 || bytes[2] & ~SIGNED)) return 0;
    const int length = header + payload + CHECKSUM + (second && bytes[2] & SIGNED ? SIGNATURE : 0);
    if (length > size) return 0;
    const uint32_t id = second ? bytes[7] | (uint32_t)bytes[8] << 8 | (uint32_t)bytes[9] << 16 : bytes[5];
    const int kind = kind_of(messages, id);
    if (kind < 0) return length == size || bytes[length] == MAGIC_V1 || bytes[length] == MAGIC_V2 ? length : 0;
    if (!second && payload > messages->size[kind]) return 0;
    const uint8_t *end = bytes + header + payload;
    return checksum(bytes + 1, header + payload - 1, messages->extra[kind]) == (end[0] | end[1] << 8) ? length : 0;
}

/* The one ODOMETRY of the vehicle among a datagram's frames: ALULA_SENT, or why there is none. */
static int find_estimate(const alula_context *context, const uint8_t *datagram, int size, const uint8_t **frame,
                         int *length) {
    *frame = 0;
    for (int at = 0; at < size; at += *length) {
        const uint8_t *next = datagram + at;
        *length = frame_length(&context->messages, next, size - at);
        if (!*length) return ALULA_NOT_FRAMES;
        if (next[0] != MAGIC_V2 || (next[7] | next[8] << 8 | next[9] << 16) != ODOMETRY_ID) continue;
        if (next[5] != context->link.system || next[6] != context->link.component) continue;
        if (*frame) return ALULA_NOT_FRAMES;
        *frame = next;
    }
    if (!*frame) return ALULA_NO_ESTIMATE;
    *length = frame_length(&context->messages, *frame, (int)(datagram + size - *frame));
    return ALULA_SENT;
}

static int64_t timestamp_of(const uint8_t *frame, int length) {
    int64_t timestamp = 0;
    for (int i = 0; i < 6; i++) timestamp |= (int64_t)frame[length - 12 + i] << 8 * i;
    return timestamp;
}

/* Whether a frame has a signature of this key that its stream goes on with. */
static bool is_authentic(const alula_link *link, const uint8_t *frame, int length) {
    uint8_t signature[6], difference = 0;
    if (!(frame[2] & SIGNED)) return false;
    signature_of(link->key, frame, length - 6, signature);
    for (int i = 0; i < 6; i++) difference |= signature[i] ^ frame[length - 6 + i];
    const int64_t heard = link->heard[frame[length - SIGNATURE]];
    return !difference && heard >= 0 && timestamp_of(frame, length) > heard;
}

typedef struct {
    uint64_t microseconds;
    double wire[ALULA_STATE];
    uint8_t frame, child_frame, reset_counter;
} odometry;

static void read_odometry(const uint8_t *frame, odometry *read) {
    uint8_t payload[256] = {0};
    memcpy(payload, frame + HEADER_V2, frame[1]);
    read->microseconds = 0;
    for (int i = 0; i < 8; i++) read->microseconds |= (uint64_t)payload[i] << 8 * i;
    for (int i = 0; i < ALULA_STATE; i++) {
        const uint8_t *at = payload + 8 + 4 * i;
        const uint32_t bits = at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24;
        float value;
        memcpy(&value, &bits, sizeof value);
        read->wire[i] = value;
    }
    read->frame = payload[ODOMETRY_FRAMES], read->child_frame = payload[ODOMETRY_FRAMES + 1];
    read->reset_counter = payload[ODOMETRY_FRAMES + 2];
}

static uint8_t *put_word(uint8_t *at, uint32_t word) {
    for (int i = 0; i < 4; i++) at[i] = (uint8_t)(word >> 8 * i);
    return at + 4;
}

static uint8_t *put_float(uint8_t *at, double number) {
    const float value = (float)number;
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return put_word(at, bits);
}

/* SET_ATTITUDE_TARGET with body rates, FLU, rad/s, and thrust, clipped to 0..1. timestamp: of its signature, where the
 * link is signed. Returns the length of the frame. */
static int pack_setpoint(const alula_link *link, const double *rate, double thrust, double now, uint8_t sequence,
                         int64_t timestamp, uint8_t *frame) {
    uint8_t *at = frame + HEADER_V2;
    const uint8_t header[HEADER_V2] = {MAGIC_V2,
                                       SET_ATTITUDE_TARGET_SIZE,
                                       link->is_signed ? SIGNED : 0,
                                       0,
                                       sequence,
                                       (uint8_t)link->own_system,
                                       (uint8_t)link->own_component,
                                       SET_ATTITUDE_TARGET_ID};
    memcpy(frame, header, sizeof header);
    at = put_word(at, (uint32_t)(int64_t)(now * 1e3));
    at = put_float(at, 1), at = put_float(at, 0), at = put_float(at, 0), at = put_float(at, 0);
    at = put_float(at, rate[0]), at = put_float(at, -rate[1]), at = put_float(at, -rate[2]);
    at = put_float(at, thrust > 0 ? (thrust < 1 ? thrust : 1) : 0);
    *at++ = (uint8_t)link->system, *at++ = (uint8_t)link->component, *at++ = ATTITUDE_IGNORED;
    const uint16_t crc = checksum(frame + 1, (int)(at - frame) - 1, SET_ATTITUDE_TARGET_EXTRA);
    *at++ = (uint8_t)crc, *at++ = (uint8_t)(crc >> 8);
    if (link->is_signed) {
        *at++ = (uint8_t)link->link_id;
        for (int i = 0; i < 6; i++) *at++ = (uint8_t)(timestamp >> 8 * i);
        signature_of(link->key, frame, (int)(at - frame), at);
        at += 6;
    }
    return (int)(at - frame);
}

#endif

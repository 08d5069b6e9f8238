/* Little-endian numbers and text, written and read piece by piece with the bounds watched, whatever the machine's own order. */
#ifndef LOOPSHAPE_BYTES_H
#define LOOPSHAPE_BYTES_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

/* f64 and f32 of the protocol are this machine's double and float. */
typedef char double_has_8_bytes[sizeof(double) == 8 ? 1 : -1];
typedef char float_has_4_bytes[sizeof(float) == 4 ? 1 : -1];

struct writer {
    uint8_t *data;
    size_t count, room; /* what does not fit is left out: `count` stays within `room` */
};

struct reader {
    const uint8_t *data;
    size_t left;
    int short_of; /* something was read that was not there */
};

static inline void put_bits(struct writer *w, uint64_t value, size_t bytes)
{
    if (w->room - w->count < bytes)
        return;
    for (size_t k = 0; k < bytes; k++)
        w->data[w->count++] = (uint8_t)(value >> (8 * k));
}

static inline void put_u8(struct writer *w, uint8_t value)
{
    put_bits(w, value, 1);
}

static inline void put_u16(struct writer *w, uint16_t value)
{
    put_bits(w, value, 2);
}

static inline void put_u32(struct writer *w, uint32_t value)
{
    put_bits(w, value, 4);
}

static inline void put_f64(struct writer *w, double value)
{
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    put_bits(w, bits, 8);
}

static inline void put_f32(struct writer *w, float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    put_bits(w, bits, 4);
}

/* Text with its length in front; cut at 255 bytes, or to the room. */
static inline void put_text(struct writer *w, const char *text)
{
    size_t length = strlen(text);
    if (length > 255)
        length = 255;
    if (w->room - w->count < length + 1)
        return;
    put_u8(w, (uint8_t)length);
    memcpy(w->data + w->count, text, length);
    w->count += length;
}

static inline uint64_t take_bits(struct reader *r, size_t bytes)
{
    uint64_t value = 0;
    if (r->left < bytes) {
        r->short_of = 1;
        r->left = 0;
        return 0;
    }
    for (size_t k = 0; k < bytes; k++)
        value |= (uint64_t)r->data[k] << (8 * k);
    r->data += bytes;
    r->left -= bytes;
    return value;
}

static inline uint8_t take_u8(struct reader *r)
{
    return (uint8_t)take_bits(r, 1);
}

static inline uint16_t take_u16(struct reader *r)
{
    return (uint16_t)take_bits(r, 2);
}

static inline uint32_t take_u32(struct reader *r)
{
    return (uint32_t)take_bits(r, 4);
}

static inline double take_f64(struct reader *r)
{
    const uint64_t bits = take_bits(r, 8);
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static inline float take_f32(struct reader *r)
{
    const uint32_t bits = (uint32_t)take_bits(r, 4);
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* Whether a payload was just as long as what was read of it. */
static inline int read_whole(const struct reader *r)
{
    return !r->short_of && r->left == 0;
}

#endif

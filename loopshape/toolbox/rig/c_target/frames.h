/* Frames of the protocol (docs/protocol.md): COBS, CRC-32, and a decoder that no sequence of bytes can harm. */
#ifndef LOOPSHAPE_FRAMES_H
#define LOOPSHAPE_FRAMES_H

#include <stddef.h>
#include <stdint.h>

#define FRAME_PAYLOAD 1000u                              /* longest payload */
#define FRAME_HEAD 3u                                    /* type, tag */
#define FRAME_CHECK 4u                                   /* the CRC */
#define FRAME_BODY (FRAME_HEAD + FRAME_PAYLOAD + FRAME_CHECK)
#define FRAME_ENCODED 1024u                              /* bytes between two zeros; more is dropped */

/* Bytes since the last zero; `bad` counts what was dropped. All zero at first. */
struct frame_decoder {
    uint32_t bad;
    uint16_t count;
    uint8_t spoilt;
    uint8_t held[FRAME_ENCODED];
};

/* CRC-32 of Ethernet and zlib; `crc` is 0 at first, then the answer for the bytes before. */
uint32_t crc32_of(uint32_t crc, const uint8_t *data, size_t count);

/* COBS without the closing zero; `out` holds count + count/254 + 1 bytes. Gives how many it wrote. */
size_t cobs_stuff(const uint8_t *data, size_t count, uint8_t *out);

/* Undo it in place; 0 where it is none. */
size_t cobs_unstuff(uint8_t *data, size_t count);

/* Append the CRC to a body of `count` bytes (its array has FRAME_BODY), stuff it, end it with a zero. */
size_t frame_close(uint8_t *body, size_t count, uint8_t *out);

/*
 * One more byte. Gives the length of a whole and unchanged body (type, tag, payload; at the start of `held` until the
 * next call), else 0.
 */
size_t frame_receive(struct frame_decoder *decoder, uint8_t byte);

#endif

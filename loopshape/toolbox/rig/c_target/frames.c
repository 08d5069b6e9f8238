/* Frames of the protocol: see frames.h. COBS is Cheshire and Baker's (IEEE/ACM Trans. Networking 7, 1999). */
#include "frames.h"

uint32_t crc32_of(uint32_t crc, const uint8_t *data, size_t count)
{
    static const uint32_t quarter[16] = {/* of four bits at a time: 64 bytes of flash instead of a kilobyte */
        0x00000000u, 0x1db71064u, 0x3b6e20c8u, 0x26d930acu, 0x76dc4190u, 0x6b6b51f4u, 0x4db26158u, 0x5005713cu,
        0xedb88320u, 0xf00f9344u, 0xd6d6a3e8u, 0xcb61b38cu, 0x9b64c2b0u, 0x86d3d2d4u, 0xa00ae278u, 0xbdbdf21cu};

    crc = ~crc;
    for (size_t k = 0; k < count; k++) {
        crc ^= data[k];
        crc = (crc >> 4) ^ quarter[crc & 15u];
        crc = (crc >> 4) ^ quarter[crc & 15u];
    }
    return ~crc;
}

size_t cobs_stuff(const uint8_t *data, size_t count, uint8_t *out)
{
    size_t code = 0, at = 1; /* where this run's length goes, and its next byte */

    for (size_t k = 0; k < count; k++) {
        if (data[k] != 0)
            out[at++] = data[k];
        if (data[k] == 0 || at - code == 255) {
            out[code] = (uint8_t)(at - code);
            if (data[k] != 0 && k + 1 == count)
                return at; /* a full run at the very end needs no more */
            code = at++;
        }
    }
    out[code] = (uint8_t)(at - code);
    return at;
}

size_t cobs_unstuff(uint8_t *data, size_t count)
{
    size_t at = 0, made = 0;

    while (at < count) {
        const size_t length = data[at];
        if (length == 0 || length > count - at)
            return 0;
        for (size_t k = 1; k < length; k++)
            data[made++] = data[at + k]; /* made < at + k always: in place it overtakes nothing */
        at += length;
        if (length < 255 && at < count)
            data[made++] = 0;
    }
    return made;
}

size_t frame_close(uint8_t *body, size_t count, uint8_t *out)
{
    const uint32_t crc = crc32_of(0, body, count);
    for (size_t k = 0; k < FRAME_CHECK; k++)
        body[count + k] = (uint8_t)(crc >> (8 * k));
    const size_t stuffed = cobs_stuff(body, count + FRAME_CHECK, out);
    out[stuffed] = 0;
    return stuffed + 1;
}

/* The body in what was collected; 0 where there is none. */
static size_t opened(uint8_t *held, size_t count)
{
    const size_t whole = cobs_unstuff(held, count);
    if (whole < FRAME_HEAD + FRAME_CHECK || whole > FRAME_BODY)
        return 0;
    const size_t body = whole - FRAME_CHECK;
    uint32_t said = 0;
    for (size_t k = 0; k < FRAME_CHECK; k++)
        said |= (uint32_t)held[body + k] << (8 * k);
    return crc32_of(0, held, body) == said ? body : 0;
}

size_t frame_receive(struct frame_decoder *decoder, uint8_t byte)
{
    if (byte != 0) {
        if (decoder->count < FRAME_ENCODED)
            decoder->held[decoder->count++] = byte;
        else
            decoder->spoilt = 1;
        return 0;
    }
    if (decoder->count == 0)
        return 0; /* two zeros in a row are nothing */
    const size_t body = decoder->spoilt ? 0 : opened(decoder->held, decoder->count);
    decoder->count = 0;
    decoder->spoilt = 0;
    if (body == 0)
        decoder->bad++;
    return body;
}

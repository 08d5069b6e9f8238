/* What comes unasked: samples, samples again, and how a recording ended; answers go first. */
#include "state.h"

#define PARTIAL_MS 20u /* samples wait no longer for a full frame */
#define ENDED_MS 200u
#define ENDED_TIMES 25u /* then nobody listens */

struct writer body_of(uint8_t *data, uint8_t type, uint16_t tag)
{
    struct writer out = {data, 0, FRAME_HEAD + FRAME_PAYLOAD};
    put_u8(&out, type);
    put_u16(&out, tag);
    return out;
}

int send_body(uint8_t *body, size_t count)
{
    if (board_space() < FRAME_ENCODED)
        return 0;
    board_send(target.encoded, frame_close(body, count, target.encoded));
    return 1;
}

/* Ticks that a frame of samples holds. */
static uint32_t ticks_a_frame(void)
{
    return (TARGET_SAMPLE_BYTES - 9) / (target.run.width * (uint32_t)TARGET_NUMBER_BYTES);
}

/* Samples from tick `first` on, as many of `most` as a frame holds; gives how many went. */
static uint32_t send_samples(uint32_t first, uint32_t most)
{
    const struct recording *run = &target.run;
    const uint32_t fit = ticks_a_frame();
    const uint8_t count = (uint8_t)(most < fit ? most : fit < 255 ? fit : 255);
    struct writer out = body_of(target.body, 0x90, target.frames_sent);

    put_u32(&out, run->id);
    put_u32(&out, first);
    put_u8(&out, count);
    for (uint32_t tick = first; tick - first < count; tick++) {
        const number *from = target.memory + (size_t)(tick % TARGET_TICKS) * run->width;
        for (uint8_t k = 0; k < run->width; k++)
            put_number(&out, from[k]);
    }
    if (!send_body(target.body, out.count))
        return 0;
    target.frames_sent++;
    return count;
}

static int send_again(void)
{
    struct range *next = &target.again[0];

    if (target.again_count == 0)
        return 0;
    const uint32_t gone = target.run.tick - next->first > TARGET_TICKS ? next->count : 0; /* overwritten meanwhile */
    const uint32_t sent = gone ? gone : send_samples(next->first, next->count);
    next->first += sent;
    next->count -= sent;
    if (next->count == 0)
        memmove(next, next + 1, --target.again_count * sizeof *next);
    return sent > 0;
}

static int send_fresh(void)
{
    struct recording *run = &target.run;
    uint32_t waiting = run->tick - run->sent;

    if (waiting == 0)
        return 0;
    if (waiting > TARGET_TICKS) { /* a host that did not follow finds a gap */
        run->sent = run->tick - TARGET_TICKS;
        waiting = TARGET_TICKS;
    }
    if (run->going && waiting < ticks_a_frame() && target.now_ms - target.samples_ms < PARTIAL_MS && !target_waits())
        return 0;
    const uint32_t sent = send_samples(run->sent, waiting);
    run->sent += sent;
    if (sent > 0)
        target.samples_ms = target.now_ms;
    return sent > 0;
}

static int send_ended(struct ended *end)
{
    if (!end->waiting || end->said == ENDED_TIMES || (end->said && target.now_ms - end->said_ms < ENDED_MS))
        return 0;
    struct writer out = body_of(target.body, 0x91, 0);
    put_u32(&out, end->run);
    put_u32(&out, end->ticks);
    put_u8(&out, end->reason);
    put_u8(&out, end->index);
    put_u32(&out, end->tick);
    put_f64(&out, end->value);
    put_f64(&out, end->limit);
    put_text(&out, end->sentence);
    if (!send_body(target.body, out.count))
        return 0;
    end->said++;
    end->said_ms = target.now_ms;
    return 1;
}

/* One sample more than there are says that the host has ENDED too. */
void stream_acknowledge(uint32_t run, uint32_t received)
{
    struct ended *end = &target.ended[run == 0 ? 1 : 0];

    if (run != 0 && run == target.run.id && received > target.run.acknowledged)
        target.run.acknowledged = received < target.run.tick ? received : target.run.tick;
    if (end->waiting && end->said && end->run == run && received > end->ticks)
        end->waiting = 0;
}

int stream_poll(void)
{
    if (target.answer_waits) {
        if (!send_body(target.answer, target.answer_count))
            return 0;
        target.answer_waits = 0;
        return 1;
    }
    return send_again() || send_fresh() || send_ended(&target.ended[0]) || send_ended(&target.ended[1]);
}

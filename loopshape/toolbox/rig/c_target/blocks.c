/* BLOCK, OUTPUT: a diagram of controllers, sums of signals through sections, as it comes and as it runs. */
#include "state.h"

#include <math.h>

static double *weights(const struct block *b)
{
    return target.c.numbers + b->from;
}

static double *coefficients(const struct block *b)
{
    return weights(b) + b->terms;
}

/* What moves: two numbers a section, the delay line, the value. */
static double *states(const struct block *b)
{
    return coefficients(b) + 5u * b->sections;
}

static double *line(const struct block *b)
{
    return states(b) + 2u * b->sections;
}

double block_value(uint8_t block)
{
    const struct block *b = &target.c.block[block];
    return line(b)[b->delay];
}

static uint32_t size_of(const struct block *b)
{
    return b->terms + 7u * b->sections + b->delay + 1u;
}

static uint8_t head_refused(const struct block *b, const struct reader *in)
{
    if (in->short_of || in->left != 9u * b->terms + 1u + 40u * b->sections)
        return NO_MALFORMED;
    if (b->every == 0 || b->terms == 0)
        return NO_RANGE;
    if (target.c.blocks == TARGET_BLOCKS || b->terms > TARGET_TERMS || b->sections > TARGET_SECTIONS)
        return NO_ROOM;
    return size_of(b) > TARGET_POOL - target.c.used ? NO_ROOM : 0;
}

static uint8_t take_terms(struct reader *in, struct block *b)
{
    for (uint8_t k = 0; k < b->terms; k++) {
        b->signal[k] = take_u8(in);
        weights(b)[k] = take_f64(in);
        if (b->signal[k] >= 2 * target.c.loops + TARGET_BLOCKS || !isfinite(weights(b)[k]))
            return NO_RANGE;
    }
    (void)take_u8(in);
    if (!numbers_finite(*in, 5u * b->sections))
        return NO_RANGE;
    for (uint32_t k = 0; k < 5u * b->sections; k++)
        coefficients(b)[k] = take_f64(in);
    return 0;
}

/* All of a block behind its index; what is refused leaves nothing behind, as `used` stays. */
static uint8_t take_block(struct reader *in, struct block *b)
{
    b->from = target.c.used;
    b->every = take_u8(in);
    b->delay = take_u16(in);
    b->terms = take_u8(in);
    if (in->left < 9u * b->terms + 1u)
        return NO_MALFORMED;
    b->sections = in->data[9u * b->terms];
    const uint8_t refused = head_refused(b, in);
    return refused ? refused : take_terms(in, b);
}

static int controllers_begun(void)
{
    const struct configuration *c = &target.c;
    return c->limits > 0 || c->count[0] > 0 || c->schedule[0].sections > 0 || c->output[0] > 0;
}

uint8_t ask_block(struct reader *in, struct writer *out, const char **why)
{
    struct configuration *c = &target.c;
    const uint8_t *payload = in->data;
    const size_t size = in->left;
    const uint8_t index = take_u8(in);
    struct block b;

    (void)out;
    if (TARGET_POOL == 0)
        return refuse(NO_SUPPORT, why, "no blocks here");
    if (in->short_of)
        return refuse(NO_MALFORMED, why, "BLOCK has another length");
    if (c->loops == 0)
        return refuse(NO_CONFIGURED, why, "CONFIGURE comes first");
    if (index != c->blocks || controllers_begun())
        return refuse(NO_RANGE, why, "blocks come once, in order, before the loops' controllers");
    memset(&b, 0, sizeof b);
    const uint8_t refused = take_block(in, &b);
    if (refused)
        return refuse(refused, why, refused == NO_ROOM ? "more of blocks than the target holds" : "BLOCK");
    if (!sections_allowed(coefficients(&b), b.sections))
        return refuse(NO_RANGE, why, OUTSIDE_CIRCLE);
    c->block[index] = b;
    c->blocks++;
    c->used += size_of(&b);
    configuration_taken(payload, size);
    return 0;
}

uint8_t ask_output(struct reader *in, struct writer *out, const char **why)
{
    struct configuration *c = &target.c;
    const uint8_t *payload = in->data;
    const size_t size = in->left;
    const uint8_t loop = take_u8(in), block = take_u8(in);

    (void)out;
    if (TARGET_POOL == 0)
        return refuse(NO_SUPPORT, why, "no blocks here");
    if (!read_whole(in))
        return refuse(NO_MALFORMED, why, "OUTPUT has another length");
    if (c->loops == 0)
        return refuse(NO_CONFIGURED, why, "CONFIGURE comes first");
    if (block >= c->blocks || !controller_begins(loop))
        return refuse(NO_RANGE, why, "a block that is there, for the next loop");
    c->output[loop] = (uint8_t)(block + 1);
    c->sections_loop = loop;
    configuration_taken(payload, size);
    return 0;
}

int blocks_known(void)
{
    for (uint8_t k = 0; k < target.c.blocks; k++)
        for (uint8_t j = 0; j < target.c.block[k].terms; j++) {
            const int from = target.c.block[k].signal[j] - 2 * target.c.loops;
            if (from >= target.c.blocks || (from >= k && target.c.block[from].delay == 0))
                return 0;
        }
    return 1;
}

void blocks_rest(void)
{
    for (uint8_t k = 0; k < target.c.blocks; k++) {
        const struct block *b = &target.c.block[k];
        memset(states(b), 0, (2u * b->sections + b->delay + 1u) * sizeof(double));
    }
    memset(target.l.block_wait, 0, sizeof target.l.block_wait);
    memset(target.l.block_at, 0, sizeof target.l.block_at);
}

static double signal_of(uint8_t signal, int injected)
{
    const struct loops *l = &target.l;
    const uint8_t loops = target.c.loops;
    if (signal < loops)
        return l->r[signal];
    if (signal >= 2 * loops)
        return block_value((uint8_t)(signal - 2 * loops));
    return injected ? l->y[signal - loops] - l->n[signal - loops] : l->y[signal - loops];
}

static double computed(const struct block *b, int injected)
{
    double value = 0.0;
    for (uint8_t k = 0; k < b->terms; k++)
        value += weights(b)[k] * signal_of(b->signal[k], injected);
    for (uint8_t k = 0; k < b->sections; k++) {
        const double *c = coefficients(b) + 5u * k;
        double *s = states(b) + 2u * k;
        const double out = c[0] * value + s[0];
        s[0] = c[1] * value - c[3] * out + s[1];
        s[1] = c[2] * value - c[4] * out;
        value = out;
    }
    return value;
}

void blocks_step(int injected)
{
    struct loops *l = &target.l;
    for (uint8_t k = 0; k < target.c.blocks; k++) { /* what comes late is known before all else */
        const struct block *b = &target.c.block[k];
        if (b->delay > 0 && l->block_wait[k] == 0)
            line(b)[b->delay] = line(b)[l->block_at[k]];
    }
    for (uint8_t k = 0; k < target.c.blocks; k++) {
        const struct block *b = &target.c.block[k];
        if (l->block_wait[k] > 0) {
            l->block_wait[k]--;
            continue;
        }
        l->block_wait[k] = (uint8_t)(b->every - 1);
        line(b)[l->block_at[k]] = computed(b, injected); /* without a delay the line is the value itself */
        l->block_at[k] = b->delay > 0 ? (uint16_t)((l->block_at[k] + 1) % b->delay) : 0;
    }
}

/* CONFIGURE, SECTIONS, LIMIT, READY (schedule.c and blocks.c have the rest): what the target shall do, taken only whole, in order and within its sizes. */
#include "state.h"

#include <math.h>

#define POLE_ROUNDING 1e-12 /* an integrator's pole lies on the circle within rounding */

int all_finite(const double *values, size_t count)
{
    for (size_t k = 0; k < count; k++)
        if (!isfinite(values[k]))
            return 0;
    return 1;
}

static void take_table(struct reader *in, double *table, size_t count)
{
    for (size_t k = 0; k < count; k++)
        table[k] = take_f64(in);
}

int numbers_finite(struct reader in, size_t count)
{
    for (size_t k = 0; k < count; k++)
        if (!isfinite(take_f64(&in)))
            return 0;
    return 1;
}

/* Ticks of a PWM period at this frequency (0: the board's own); 0 where they are no whole number. */
static uint32_t period_of(double hz)
{
    const struct board_info *board = target.board;
    if (board->pwm_hz == 0.0)
        return 1;
    const double ticks = board->rate_hz / (hz == 0.0 ? board->pwm_hz : hz), whole = floor(ticks + 0.5);
    return fabs(ticks - whole) < 1e-9 * whole && whole >= 1.0 && whole < 1e6 ? (uint32_t)whole : 0;
}

int poles_allowed(double a1, double a2)
{
    return fabs(a2) <= 1.0 + POLE_ROUNDING && fabs(a1) <= 1.0 + a2 + POLE_ROUNDING;
}

int sections_allowed(const double *table, uint8_t count)
{
    for (uint8_t k = 0; k < count; k++)
        if (!poles_allowed(table[5u * k + 3], table[5u * k + 4]))
            return 0;
    return 1;
}

struct head {
    uint8_t loops, hold, closed;
    uint16_t watchdog_ms;
    double soft_start_s, pwm_hz, dead_zone;
};

static uint8_t head_refused(const struct head *h, const char **why)
{
    if (h->loops < 1 || h->loops > TARGET_LOOPS || h->hold > 1 || h->closed > 1)
        return refuse(NO_RANGE, why, "loops, on limit or closed");
    if (!h->closed)
        return refuse(NO_SUPPORT, why, "loops are closed between recordings");
    if (h->watchdog_ms == 0 || !(isfinite(h->soft_start_s) && h->soft_start_s >= 0.0))
        return refuse(NO_RANGE, why, "watchdog or soft start");
    if (!(h->pwm_hz >= 0.0 && h->dead_zone >= 0.0 && h->dead_zone <= 0.5))
        return refuse(NO_RANGE, why, "PWM frequency or dead zone");
    if (target.board->pwm_hz == 0.0 && (h->pwm_hz > 0.0 || h->dead_zone > 0.0))
        return refuse(NO_SUPPORT, why, "the board has no PWM");
    if (period_of(h->pwm_hz) == 0)
        return refuse(NO_RANGE, why, "a PWM period is a whole number of ticks");
    return 0;
}

static void set_head(const struct head *h)
{
    struct configuration *c = &target.c;
    memset(c, 0, sizeof *c);
    c->loops = h->loops;
    c->hold = h->hold;
    c->watchdog_ms = h->watchdog_ms;
    c->soft_start_s = h->soft_start_s;
    c->period_ticks = period_of(h->pwm_hz);
    c->period_s = (double)c->period_ticks * (1.0 / target.board->rate_hz);
    c->dead_zone = h->dead_zone == 0.0 ? target.board->dead_zone : h->dead_zone;
}

uint8_t ask_configure(struct reader *in, struct writer *out, const char **why)
{
    const struct board_info *board = target.board;
    const uint8_t *payload = in->data;
    const size_t size = in->left;
    struct head h;

    h.loops = take_u8(in);
    h.hold = take_u8(in);
    h.closed = take_u8(in);
    h.watchdog_ms = take_u16(in);
    h.soft_start_s = take_f64(in);
    h.pwm_hz = take_f64(in);
    h.dead_zone = take_f64(in);
    if (in->short_of)
        return refuse(NO_MALFORMED, why, "CONFIGURE has another length");
    const uint8_t refused = head_refused(&h, why);
    if (refused)
        return refused;
    const size_t outputs = (size_t)h.loops * board->sensors, mixing = (size_t)h.loops * board->commands;
    if (in->left != 8 * (outputs + mixing))
        return refuse(NO_MALFORMED, why, "CONFIGURE has another length");
    if (!numbers_finite(*in, outputs + mixing))
        return refuse(NO_RANGE, why, "a matrix holds what is no number");
    set_head(&h);
    take_table(in, target.c.outputs, outputs);
    take_table(in, target.c.mixing, mixing);
    target.c.digest = crc32_of(0, payload, size);
    run_forget();
    put_u32(out, target.c.digest);
    return 0;
}

/* The digest goes by what came, so it comes in one order: loops, places, limits. */
void configuration_taken(const uint8_t *payload, size_t size)
{
    target.c.digest = crc32_of(target.c.digest, payload, size);
    target.c.ready = 0;
}

static int controller_there(uint8_t loop)
{
    const struct schedule *s = &target.c.schedule[loop];
    return s->sections > 0 ? s->taken == s->rows : target.c.count[loop] > 0 || target.c.output[loop] > 0;
}

int controller_begins(uint8_t loop)
{
    const struct configuration *c = &target.c;
    const unsigned next = c->sections_loop + (controller_there(c->sections_loop) ? 1u : 0u);
    return loop < c->loops && loop == next && c->schedule[loop].sections == 0 && c->limits == 0;
}

uint8_t ask_sections(struct reader *in, struct writer *out, const char **why)
{
    struct configuration *c = &target.c;
    const uint8_t *payload = in->data;
    const size_t size = in->left;
    const uint8_t loop = take_u8(in), first = take_u8(in), count = take_u8(in);

    (void)out;
    if (in->short_of || count == 0 || in->left != (size_t)count * 40)
        return refuse(NO_MALFORMED, why, "SECTIONS has another length");
    if (c->loops == 0)
        return refuse(NO_CONFIGURED, why, "CONFIGURE comes first");
    const int goes_on = loop == c->sections_loop && c->count[loop] > 0 && c->limits == 0;
    if (!(goes_on || controller_begins(loop)) || first != c->count[loop])
        return refuse(NO_RANGE, why, "sections come once, in order of loop and place, before the limits");
    if (first + count > TARGET_SECTIONS)
        return refuse(NO_ROOM, why, "more sections than the target holds");
    if (!numbers_finite(*in, 5u * count))
        return refuse(NO_RANGE, why, "a coefficient is no number");
    take_table(in, (double *)c->sections[loop] + 5u * first, 5u * count);
    if (!sections_allowed((const double *)c->sections[loop] + 5u * first, count))
        return refuse(NO_RANGE, why, OUTSIDE_CIRCLE);
    c->sections_loop = loop;
    c->count[loop] = (uint8_t)(first + count);
    configuration_taken(payload, size);
    return 0;
}

uint8_t ask_limit(struct reader *in, struct writer *out, const char **why)
{
    struct configuration *c = &target.c;
    const uint8_t *payload = in->data;
    const size_t size = in->left;
    const uint8_t index = take_u8(in);
    const struct limit limit = {take_f64(in), take_f64(in), take_f64(in)};

    (void)out;
    if (!read_whole(in))
        return refuse(NO_MALFORMED, why, "LIMIT has another length");
    if (c->loops == 0)
        return refuse(NO_CONFIGURED, why, "CONFIGURE comes first");
    if (index != c->limits || index >= target.board->sensors + target.board->commands)
        return refuse(NO_RANGE, why, "limits come once, in order: sensors, then commands");
    if (!(isfinite(limit.low) && isfinite(limit.high) && limit.low < limit.high && limit.rate > 0.0))
        return refuse(NO_RANGE, why, "low and high are numbers, low below high, a rate above 0");
    if (!target.board->ranges)
        return refuse(NO_CONFIGURED, why, "the board declares no ranges");
    if (limit.low < target.board->ranges[index][0] || limit.high > target.board->ranges[index][1])
        return refuse(NO_RANGE, why, "a limit lies within the range that the column can have");
    c->limit[index] = limit;
    c->limits = (uint8_t)(index + 1);
    configuration_taken(payload, size);
    return 0;
}

uint8_t ask_ready(struct reader *in, struct writer *out, const char **why)
{
    struct configuration *c = &target.c;

    if (!read_whole(in))
        return refuse(NO_MALFORMED, why, "READY has no payload");
    if (c->loops == 0)
        return refuse(NO_CONFIGURED, why, "nothing is configured");
    for (uint8_t k = 0; k < c->loops; k++)
        if (!controller_there(k))
            return refuse(NO_CONFIGURED, why, "a loop has no controller");
    if (c->limits < target.board->sensors + target.board->commands)
        return refuse(NO_CONFIGURED, why, "a sensor or command has no limit");
    if (!blocks_known())
        return refuse(NO_CONFIGURED, why, "a block reads one that is not there, or not known before it");
    target.fresh = board_fresh();
    if (target.fresh == 0)
        return refuse(NO_CONFIGURED, why, "the board has no fresh number");
    c->ready = 1;
    put_u32(out, c->digest);
    put_bits(out, target.fresh, 8);
    return 0;
}

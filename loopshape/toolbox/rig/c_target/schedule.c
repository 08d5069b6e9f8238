/* SCHEDULE, NODES: a loop's controller whose coefficients follow an operating point, as they come and as they run. */
#include "state.h"

#include <math.h>

#define ROW 6u /* b0 b1 b2 a0 a1 a2 */

static double *numbers(const struct schedule *s)
{
    return target.c.numbers + s->from;
}

static uint32_t knots_of(const struct schedule *s)
{
    return (uint32_t)s->counts[0] + s->counts[1] + s->counts[2];
}

static double *row_of(const struct schedule *s, uint32_t row)
{
    return numbers(s) + knots_of(s) + ROW * row;
}

/* One variable: source, scale, knots; 0, or a NO code. */
static uint8_t take_variable(struct reader *in, struct schedule *s, uint8_t v, uint32_t at)
{
    s->source[v] = take_u8(in);
    s->scale[v] = take_f64(in);
    s->counts[v] = take_u8(in);
    if (in->short_of || in->left < 8u * s->counts[v])
        return NO_MALFORMED;
    if (s->source[v] >= 2 * target.c.loops || !isfinite(s->scale[v]) || s->scale[v] == 0.0 || s->counts[v] == 0)
        return NO_RANGE;
    if (at + s->counts[v] > TARGET_POOL)
        return NO_ROOM;
    for (uint8_t k = 0; k < s->counts[v]; k++) {
        double *knot = target.c.numbers + at + k;
        *knot = take_f64(in);
        if (!isfinite(*knot) || (k > 0 && !(*knot > knot[-1])))
            return NO_RANGE;
    }
    return 0;
}

/* All of it, into the numbers that are free; what is refused leaves nothing behind, as `used` stays. */
static uint8_t take_schedule(struct reader *in, struct schedule *s)
{
    uint32_t at = target.c.used, nodes = 1;
    s->from = at;
    s->variables = take_u8(in);
    s->sections = take_u8(in);
    s->share = take_f64(in);
    if (in->short_of)
        return NO_MALFORMED;
    if (s->variables < 1 || s->variables > VARIABLES || s->sections < 1 || !(s->share > 0.0 && s->share <= 1.0))
        return NO_RANGE;
    for (uint8_t v = 0; v < s->variables; v++) {
        const uint8_t refused = take_variable(in, s, v, at);
        if (refused)
            return refused;
        at += s->counts[v];
        nodes *= s->counts[v];
    }
    s->rows = nodes * s->sections;
    if (!read_whole(in))
        return NO_MALFORMED;
    return s->sections > TARGET_SECTIONS || s->rows > (TARGET_POOL - at) / ROW ? NO_ROOM : 0;
}

uint8_t ask_schedule(struct reader *in, struct writer *out, const char **why)
{
    struct configuration *c = &target.c;
    const uint8_t *payload = in->data;
    const size_t size = in->left;
    const uint8_t loop = take_u8(in);
    struct schedule s;

    (void)out;
    if (TARGET_POOL == 0)
        return refuse(NO_SUPPORT, why, "no schedules here");
    if (in->short_of)
        return refuse(NO_MALFORMED, why, "SCHEDULE has another length");
    if (c->loops == 0)
        return refuse(NO_CONFIGURED, why, "CONFIGURE comes first");
    if (!controller_begins(loop))
        return refuse(NO_RANGE, why, "controllers come once, in order of loop, before the limits");
    memset(&s, 0, sizeof s);
    const uint8_t refused = take_schedule(in, &s);
    if (refused)
        return refuse(refused, why, refused == NO_ROOM ? "a larger schedule than the target holds" : "SCHEDULE");
    c->schedule[loop] = s;
    c->used = s.from + knots_of(&s) + ROW * s.rows;
    c->sections_loop = loop;
    configuration_taken(payload, size);
    return 0;
}

/* Whether a row's numbers are finite and its a0 has the sign of the first node's. */
static int row_fits(const struct schedule *s, uint32_t row, const double *six)
{
    const double first = row < s->sections ? six[3] : row_of(s, row % s->sections)[3];
    return all_finite(six, ROW) && (first > 0.0 ? six[3] > 0.0 : first < 0.0 && six[3] < 0.0);
}

uint8_t ask_nodes(struct reader *in, struct writer *out, const char **why)
{
    struct configuration *c = &target.c;
    const uint8_t *payload = in->data;
    const size_t size = in->left;
    const uint8_t loop = take_u8(in);
    const uint16_t first = take_u16(in);
    const uint8_t count = take_u8(in);

    (void)out;
    if (TARGET_POOL == 0)
        return refuse(NO_SUPPORT, why, "no schedules here");
    if (in->short_of || count == 0 || in->left != 8u * ROW * count)
        return refuse(NO_MALFORMED, why, "NODES has another length");
    if (c->loops == 0)
        return refuse(NO_CONFIGURED, why, "CONFIGURE comes first");
    struct schedule *s = loop < c->loops ? &c->schedule[loop] : NULL;
    if (!s || first != s->taken || count > s->rows - s->taken || c->limits > 0)
        return refuse(NO_RANGE, why, "rows of a schedule come once, in order, before the limits");
    for (uint32_t row = first; row < first + (uint32_t)count; row++) {
        double *six = row_of(s, row);
        for (unsigned k = 0; k < ROW; k++)
            six[k] = take_f64(in);
        if (!row_fits(s, row, six))
            return refuse(NO_RANGE, why, "a coefficient is no number, or a0 is 0 or changes its sign");
        if (!poles_allowed(six[4] / six[3], six[5] / six[3]))
            return refuse(NO_RANGE, why, OUTSIDE_CIRCLE);
    }
    s->taken += count;
    configuration_taken(payload, size);
    return 0;
}

/* The knot below a place, and the share of the way to the next. */
static uint8_t interval(const double *knots, uint8_t count, double at, double *share)
{
    uint8_t k = 0;
    *share = 0.0;
    if (count == 1 || !(at > knots[0]))
        return 0;
    while (k < count - 2 && at >= knots[k + 1])
        k++;
    *share = (at - knots[k]) / (knots[k + 1] - knots[k]);
    *share = *share < 1.0 ? *share : 1.0;
    return k;
}

/* A corner of the cell around the place: its node, and its weight. */
static double corner_of(const struct schedule *s, const uint8_t *below, const double *share, uint8_t corner,
                        uint32_t *node)
{
    double weight = 1.0;
    *node = 0;
    for (uint8_t v = 0; v < s->variables; v++) {
        const uint8_t up = (corner >> v) & 1, next = (uint8_t)(below[v] + up);
        weight *= up ? share[v] : 1.0 - share[v];
        *node = *node * s->counts[v] + (next < s->counts[v] ? next : s->counts[v] - 1u);
    }
    return weight;
}

static void interpolate(const struct schedule *s, struct follower *f)
{
    double six[TARGET_SECTIONS][ROW] = {{0.0}}, share[VARIABLES];
    const double *knots = numbers(s);
    uint8_t below[VARIABLES];
    uint32_t node;

    for (uint8_t v = 0; v < s->variables; knots += s->counts[v++])
        below[v] = interval(knots, s->counts[v], f->at[v], &share[v]);
    for (uint8_t corner = 0; corner < 1u << s->variables; corner++) {
        const double weight = corner_of(s, below, share, corner, &node);
        for (uint8_t k = 0; weight > 0.0 && k < s->sections; k++)
            for (unsigned j = 0; j < ROW; j++)
                six[k][j] += weight * row_of(s, node * s->sections + k)[j];
    }
    for (uint8_t k = 0; k < s->sections; k++)
        for (unsigned j = 0; j < 5; j++)
            f->now[k][j] = six[k][j < 3 ? j : j + 1] / six[k][3];
}

/* On to the operating point that the references and outputs show. */
static void follow(const struct schedule *s, struct follower *f)
{
    const struct loops *l = &target.l;
    int moved = 0;
    for (uint8_t v = 0; v < s->variables; v++) {
        const uint8_t source = s->source[v];
        const double signal = source < target.c.loops ? l->r[source] : l->y[source - target.c.loops];
        const double value = s->scale[v] * signal, step = value - f->at[v];
        const int begins = !f->begun || isnan(step);
        moved = moved || begins || step != 0.0;
        f->at[v] = begins ? value : f->at[v] + s->share * step;
    }
    f->begun = 1;
    if (moved)
        interpolate(s, f);
}

double schedule_step(uint8_t loop, double value)
{
    const struct schedule *s = &target.c.schedule[loop];
    struct follower *f = &target.l.follower[loop];

    follow(s, f);
    for (uint8_t k = 0; k < s->sections; k++) {
        const double *c = f->now[k], *in = f->past[k], *after = f->past[k + 1];
        double out = c[0] * value + c[1] * in[0] + c[2] * in[1];
        out -= c[3] * after[0] + c[4] * after[1];
        f->past[k][1] = f->past[k][0];
        f->past[k][0] = value;
        value = out;
    }
    f->past[s->sections][1] = f->past[s->sections][0];
    f->past[s->sections][0] = value;
    return value;
}

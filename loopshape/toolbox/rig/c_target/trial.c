/* TRIAL, BLEND, PROGRESS: a second controller beside a loop's own, crossed over to step by step, and the way back by itself. */
#include "state.h"

#include <math.h>

#define RISING 3 /* windows in a row that each grow: an excitation that begins makes two grow at most */

enum { NOTHING, ERROR_PEAK, CONTROL_RANGE, ERROR_RMS, GROWTH, LEASE, HOST, FAULTED };

uint8_t ask_trial(struct reader *in, struct writer *out, const char **why)
{
    struct trial_setup *t = &target.c.trial;
    const uint8_t *payload = in->data;
    const size_t size = in->left;
    const uint8_t loop = take_u8(in), first = take_u8(in), count = take_u8(in);
    const double track = take_f64(in);

    (void)out;
    if (in->short_of || count == 0 || in->left != (size_t)count * 40)
        return refuse(NO_MALFORMED, why, "TRIAL has another length");
    if (target.c.loops == 0)
        return refuse(NO_CONFIGURED, why, "CONFIGURE comes first");
    if (target.c.limits < target.board->sensors + target.board->commands || loop >= target.c.loops)
        return refuse(NO_RANGE, why, "a trial is of one loop, and comes after the limits");
    if (first != t->count || (first > 0 && (loop != t->loop || track != t->track)) || !(track >= 0.0 && track <= 1.0))
        return refuse(NO_RANGE, why, "sections of a trial come once, in order, of one loop, with one share of 0 to 1");
    if (first + count > TARGET_SECTIONS)
        return refuse(NO_ROOM, why, "more sections than the target holds");
    if (!numbers_finite(*in, 5u * count))
        return refuse(NO_RANGE, why, "a coefficient is no number");
    for (size_t k = 0; k < 5u * count; k++)
        ((double *)t->sections[first])[k] = take_f64(in);
    if (!sections_allowed((const double *)t->sections[first], count))
        return refuse(NO_RANGE, why, OUTSIDE_CIRCLE);
    t->loop = loop;
    t->track = track;
    t->count = (uint8_t)(first + count);
    configuration_taken(payload, size);
    return 0;
}

static int watch_allowed(const struct watch *w, const char **why)
{
    if (!(w->share >= 0.0 && w->share <= 1.0) || w->window == 0)
        *why = "a share lies between 0 and 1, a window has ticks";
    else if (w->lease == 0 && w->share < 1.0)
        *why = "only the whole new controller stays without end";
    else if (!(w->error_peak > 0.0 && w->error_rms > 0.0 && w->growth > 1.0 && w->control_low < w->control_high))
        *why = "what is watched is above 0, a growth above 1, the control from low to high";
    else
        return 1;
    return 0;
}

uint8_t ask_blend(struct reader *in, struct writer *out, const char **why)
{
    struct trial *t = &target.l.trial;
    struct watch w;

    (void)out;
    w.share = take_f64(in);
    w.ramp = take_u32(in);
    w.lease = take_u32(in);
    w.window = take_u32(in);
    w.error_peak = take_f64(in);
    w.control_low = take_f64(in);
    w.control_high = take_f64(in);
    w.error_rms = take_f64(in);
    w.growth = take_f64(in);
    if (!read_whole(in))
        return refuse(NO_MALFORMED, why, "BLEND has another length");
    if (target.c.trial.count == 0)
        return refuse(NO_CONFIGURED, why, "no trial is configured");
    if (t->phase > ON_TRIAL)
        return refuse(NO_STATE, why, t->phase == WENT_BACK ? "it went back: configure anew" : "it is kept already");
    if (!watch_allowed(&w, why))
        return NO_RANGE;
    t->watch = w;
    t->from = t->share;
    t->began_ms = target.now_ms;
    t->ticks = t->seen = 0;
    t->sum = 0.0;
    t->before = -1.0;
    t->rising = 0;
    t->phase = w.lease == 0 ? KEPT : ON_TRIAL;
    if (w.share == 0.0)
        trial_back(HOST, 0.0, 0.0);
    return 0;
}

uint8_t ask_progress(struct reader *in, struct writer *out, const char **why)
{
    const struct trial *t = &target.l.trial;

    if (!read_whole(in))
        return refuse(NO_MALFORMED, why, "PROGRESS has no payload");
    put_u8(out, target.c.trial.count == 0 ? 0 : (uint8_t)(t->phase + 1));
    put_u8(out, t->why);
    put_u32(out, t->ticks);
    put_f64(out, t->share);
    put_f64(out, t->value);
    put_f64(out, t->limit);
    return 0;
}

/* Filters at rest. */
void trial_rest(void)
{
    memset(target.l.trial.state, 0, sizeof target.l.trial.state);
    target.l.trial.offset = 0.0;
}

/* The loop's own controller alone, for good. */
void trial_back(uint8_t why, double value, double limit)
{
    struct trial *t = &target.l.trial;
    t->phase = WENT_BACK;
    t->share = 0.0;
    t->why = why;
    t->value = value;
    t->limit = limit;
    t->fresh = why != HOST && why != FAULTED;
}

void trial_fault(void)
{
    if (target.l.trial.phase == ON_TRIAL || target.l.trial.phase == KEPT)
        trial_back(FAULTED, 0.0, 0.0);
}

/* Where it went back in this tick, the recording ends and says so, once. */
void trial_ended(void)
{
    static const char *const words[] = {"", "error beyond its prediction", "control beyond its prediction",
                                        "error rms beyond its prediction", "error grows", "the host did not go on"};
    struct trial *t = &target.l.trial;
    if (!t->fresh)
        return;
    t->fresh = 0;
    run_end(TRIAL, NOBODY, t->value, t->limit, words[t->why]);
}

/* The mean square over a window, and from one window to the next. */
static uint8_t watch_square(double error, double *value, double *limit)
{
    struct trial *t = &target.l.trial;
    const struct watch *w = &t->watch;
    const double allowed = w->error_rms * w->error_rms;

    t->sum += error * error;
    t->seen++;
    if (!(t->sum <= allowed * (double)w->window)) {
        *value = t->sum / (double)w->window;
        *limit = allowed;
        return ERROR_RMS;
    }
    if (t->seen < w->window)
        return NOTHING;
    const double now = t->sum / (double)w->window, before = t->before;
    t->before = now;
    t->sum = 0.0;
    t->seen = 0;
    t->rising = before >= 0.0 && now > w->growth * before ? (uint8_t)(t->rising + 1) : 0;
    if (t->rising < RISING)
        return NOTHING;
    *value = now / before;
    *limit = w->growth;
    return GROWTH;
}

/* Since BLEND; a board that runs as fast as it can goes by the clock, as a host does. */
static double age_ticks(void)
{
    const struct trial *t = &target.l.trial;
    if (target.board->flags & BOARD_FAST)
        return 1e-3 * (double)(target.now_ms - t->began_ms) * target.board->rate_hz;
    return (double)t->ticks;
}

static uint8_t watched(double error, double control, double *value, double *limit)
{
    const struct watch *w = &target.l.trial.watch;

    *value = error;
    *limit = w->error_peak;
    if (!(fabs(error) <= w->error_peak))
        return ERROR_PEAK;
    *value = control;
    *limit = control < w->control_low ? w->control_low : w->control_high;
    if (!(control >= w->control_low && control <= w->control_high))
        return CONTROL_RANGE;
    const uint8_t found = watch_square(error, value, limit);
    const double age = age_ticks();
    if (found != NOTHING || w->lease == 0 || age < (double)w->lease)
        return found;
    *value = age;
    *limit = (double)w->lease;
    return LEASE;
}

double trial_step(double error, double input, double own)
{
    const struct trial_setup *c = &target.c.trial;
    struct trial *t = &target.l.trial;
    double value = 0.0, limit = 0.0, other = input;

    for (uint8_t k = 0; k < c->count; k++)
        other = biquad(c->sections[k], t->state[k], other);
    if (t->phase == OWN)
        t->offset += c->track * (other - own - t->offset);
    if (t->phase == OWN || t->phase == WENT_BACK)
        return own;
    t->ticks++;
    t->share = t->ticks < t->watch.ramp ? t->from + (t->watch.share - t->from) * t->ticks / t->watch.ramp : t->watch.share;
    const double control = own + t->share * (other - t->offset - own);
    const uint8_t why = watched(error, control, &value, &limit);
    if (why == NOTHING)
        return control;
    trial_back(why, value, limit);
    return own;
}

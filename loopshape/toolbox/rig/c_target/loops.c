/* A tick of the loops: the order, the sums and the limits of docs/protocol.md. */
#include "state.h"

#include <math.h>

/* One sample through a section, direct form II transposed. */
double biquad(const double *c, double *s, double value)
{
    const double out = c[0] * value + s[0];
    s[0] = c[1] * value - c[3] * out + s[1];
    s[1] = c[2] * value - c[4] * out;
    return out;
}

static double cascade(uint8_t loop, double value)
{
    for (uint8_t k = 0; k < target.c.count[loop]; k++)
        value = biquad(target.c.sections[loop][k], target.l.state[loop][k], value);
    return value;
}

static double controller(uint8_t loop, double value)
{
    if (target.c.output[loop] > 0)
        return block_value((uint8_t)(target.c.output[loop] - 1));
    return target.c.schedule[loop].sections > 0 ? schedule_step(loop, value) : cascade(loop, value);
}

/* Signed length of a pulse in s: |u| of the period, none up to the dead zone, all of it within the dead zone of 1. */
static double pulse_s(double u)
{
    const double size = fabs(u), zone = target.c.dead_zone, period_s = target.c.period_s;
    const double length = !(size > zone) ? 0.0 : size > 1.0 - zone ? period_s : size * period_s;
    return u < 0.0 && length > 0.0 ? -length : length;
}

void loops_rest(void)
{
    memset(target.l.state, 0, sizeof target.l.state);
    memset(target.l.follower, 0, sizeof target.l.follower);
    blocks_rest();
    trial_rest();
    target.l.fresh = 1;
}

static void outputs(void)
{
    const uint8_t sensors = target.board->sensors;
    for (uint8_t k = 0; k < target.c.loops; k++) {
        double sum = 0.0;
        for (uint8_t j = 0; j < sensors; j++)
            sum += target.c.outputs[k * sensors + j] * target.l.measured[j];
        target.l.y[k] = sum;
    }
}

/* Straight on from the references as they are; 0, or NO_RANGE. */
uint8_t loops_move(double ramp_s, const double *to)
{
    struct loops *l = &target.l;
    const double longest_s = ramp_s > target.c.soft_start_s ? ramp_s : target.c.soft_start_s;
    const double ticks = ceil(longest_s * target.board->rate_hz);

    if (!(ramp_s >= 0.0 && ticks < 4e9) || !all_finite(to, target.c.loops))
        return NO_RANGE;
    for (uint8_t k = 0; k < target.c.loops; k++) {
        l->from[k] = l->r[k];
        l->to[k] = to[k];
    }
    l->way = 0;
    l->ways = (uint32_t)ticks;
    return 0;
}

/* References at the outputs, controllers at rest. */
static void begin_here(void)
{
    outputs();
    memcpy(target.l.r, target.l.y, sizeof target.l.r);
    memcpy(target.l.from, target.l.y, sizeof target.l.from);
    target.l.way = target.l.ways = 0;
    loops_rest();
}

void loops_arm(void)
{
    begin_here();
    memset(&target.l.trial, 0, sizeof target.l.trial);
    memcpy(target.l.to, target.l.y, sizeof target.l.to);
    memset(target.l.n, 0, sizeof target.l.n);
    memset(target.l.z, 0, sizeof target.l.z);
    board_enable();
}

/* After open loops: from where the machine is, controllers at rest, softly to the setpoint. */
void loops_start_here(double ramp_s)
{
    double to[TARGET_LOOPS];
    memcpy(to, target.l.to, sizeof to);
    begin_here();
    (void)loops_move(ramp_s, to);
}

void loops_vent(uint8_t state)
{
    const uint8_t sensors = target.board->sensors;
    board_safe();
    for (uint8_t k = 0; k < target.board->commands; k++)
        target.l.measured[sensors + k] = 0.0;
    memset(target.l.n, 0, sizeof target.l.n);
    memset(target.l.z, 0, sizeof target.l.z);
    target.l.closed = 0;
    target.state = state;
}

/* The excitation stops, the machine is held where it is or vented, and whoever listens is told why. */
void loops_fault(uint8_t reason, uint8_t index, double value, double limit, const char *sentence)
{
    run_end(reason, index, value, limit, sentence);
    trial_fault();
    target.fault = reason;
    if (!target.c.hold || reason == WATCHDOG) {
        loops_vent(FAULT);
        return;
    }
    memcpy(target.l.r, target.l.y, sizeof target.l.r);
    memcpy(target.l.to, target.l.y, sizeof target.l.to);
    memset(target.l.n, 0, sizeof target.l.n);
    target.l.way = target.l.ways = 0;
    target.l.closed = 1;
    target.state = FAULT;
}

int loops_watched(void)
{
    return target.state == ARMED || target.state == RUNNING || target.l.closed;
}

/* The host has vanished: loops are closed no longer, those that a fault holds among them. */
void loops_unheard(double passed_ms)
{
    if (target.l.closed)
        loops_vent(FAULT);
    else
        loops_fault(WATCHDOG, NOBODY, passed_ms, (double)target.c.watchdog_ms, "nothing came from the host");
}

/* What a limit says of a value of now: a reason with what was found and set, or COMPLETE. */
static uint8_t judged(uint8_t index, double *value, double *limit)
{
    const struct limit *set = &target.c.limit[index];
    double *old = &target.l.before[index][target.l.before_at], found = *value;

    if (target.l.fresh)
        for (uint32_t k = 0; k < RATE_TICKS; k++)
            target.l.before[index][k] = found;
    const double rate = fabs(found - *old) * target.board->rate_hz / RATE_TICKS;
    *old = found;
    *limit = found < set->low ? set->low : set->high;
    if (!(found >= set->low && found <= set->high))
        return LIMIT;
    if (!(rate <= set->rate)) {
        *value = rate;
        *limit = set->rate;
        return RATE_LIMIT;
    }
    return COMPLETE;
}

/* Whether a value lies beyond its limit by more than a tenth of the limits' span: a fault no longer holds then. */
static int far_outside(uint8_t index)
{
    const struct limit *set = &target.c.limit[index];
    const double room = 0.1 * (set->high - set->low), value = target.l.measured[index];
    return !(value >= set->low - room && value <= set->high + room);
}

uint8_t sensor_outside(void)
{
    for (uint8_t k = 0; k < target.board->sensors; k++)
        if (!(target.l.measured[k] >= target.c.limit[k].low && target.l.measured[k] <= target.c.limit[k].high))
            return k;
    return NOBODY;
}

struct found {
    uint8_t reason, index;
    double value, limit;
};

/* The first of these sensors or commands that passes a limit; all of them are looked at, for their rates. */
static struct found check(uint8_t first, uint8_t count)
{
    struct found out = {COMPLETE, NOBODY, 0.0, 0.0};
    for (uint8_t k = first; k < first + count; k++) {
        double value = target.l.measured[k], limit = 0.0;
        const uint8_t reason = judged(k, &value, &limit);
        if (reason != COMPLETE && out.reason == COMPLETE)
            out = (struct found){reason, k, value, limit};
    }
    return out;
}

static void fault_found(struct found f)
{
    char text[64];
    const char *passed = f.reason == LIMIT ? " passed its limit" : " changed faster than its limit";
    const size_t room = sizeof text - 1 - strlen(passed);
    text[0] = '\0';
    strncat(text, target.board->columns[f.index], room);
    strcat(text, passed);
    loops_fault(f.reason, f.index, f.value, f.limit, text);
}

/* While a fault holds, and where it begins: vents where a value goes far, or is no number. */
static void watch_held(void)
{
    const uint8_t all = (uint8_t)(target.board->sensors + target.board->commands);
    for (uint8_t k = 0; k < all; k++)
        if (target.l.closed && far_outside(k))
            loops_vent(FAULT);
}

/* r on its way, or there. */
static void references(void)
{
    struct loops *l = &target.l;
    if (l->way < l->ways)
        l->way++;
    for (uint8_t k = 0; k < target.c.loops; k++) {
        const double share = l->way < l->ways ? (double)l->way / (double)l->ways : 1.0;
        l->r[k] = share < 1.0 ? l->from[k] + share * (l->to[k] - l->from[k]) : l->to[k];
        l->n[k] = 0.0;
    }
}

/* z = C e, or n itself where the loops are open; u = U (z + n). */
static void control(void)
{
    struct loops *l = &target.l;
    const uint8_t recording = target.state == RUNNING && target.run.going;
    const uint8_t injection = recording ? target.run.injection : CONTROLLER_INPUT;
    const uint8_t loops = target.c.loops;

    if (injection != CONTROL)
        blocks_step(injection == CONTROLLER_INPUT);
    for (uint8_t k = 0; k < loops; k++) {
        const double error = l->r[k] - l->y[k];
        const double input = injection == CONTROLLER_INPUT ? error + l->n[k] : error;
        l->z[k] = injection == CONTROL ? l->n[k] : controller(k, input);
        if (injection != CONTROL && target.c.trial.count > 0 && target.c.trial.loop == k)
            l->z[k] = trial_step(error, input, l->z[k]);
    }
    for (uint8_t j = 0; j < target.board->commands; j++) {
        double sum = 0.0;
        for (uint8_t k = 0; k < loops; k++)
            sum += target.c.mixing[j * loops + k] * (l->z[k] + (injection == PLANT_INPUT ? l->n[k] : 0.0));
        l->measured[target.board->sensors + j] = sum;
    }
}

static void give(void)
{
    double commands[TARGET_COMMANDS];
    const uint8_t sensors = target.board->sensors;

    if (target.l.phase != 0)
        return;
    for (uint8_t j = 0; j < target.board->commands; j++) {
        const struct limit *set = &target.c.limit[sensors + j];
        double u = target.l.measured[sensors + j];
        u = u < set->low ? set->low : u > set->high ? set->high : u;
        commands[j] = target.board->pwm_hz > 0.0 ? pulse_s(u) : u;
    }
    board_give(commands);
}

/* The tick of a recording: its row, its sample, its end. */
static int recorded_row(void)
{
    if (run_row())
        return 1;
    run_end(UNDERRUN, NOBODY, 0.0, 0.0, "a row was missing");
    references();
    return 0;
}

static void closed_tick(void)
{
    const uint8_t sensors = target.board->sensors, held = target.l.closed;
    int recording = target.state == RUNNING && target.run.going;
    const char *trouble = board_trouble(recording);

    outputs();
    if (trouble && !held)
        loops_fault(MACHINE, NOBODY, 0.0, 0.0, trouble);
    recording = recording && target.state == RUNNING;
    const struct found sensed = check(0, sensors);
    const int stopped = sensed.reason != COMPLETE && target.state != FAULT;
    if (!stopped && recording)
        recording = recorded_row();
    else if (target.state != FAULT)
        references();
    if (stopped && target.c.hold) /* the sample of this tick still belongs to the recording, without its excitation */
        memcpy(target.l.r, target.l.y, sizeof target.l.r);
    control();
    const struct found given = check(sensors, target.board->commands);
    if (recording)
        run_sample();
    target.l.fresh = 0;
    target.l.before_at = (target.l.before_at + 1) % RATE_TICKS;
    if (stopped)
        fault_found(sensed);
    else if (given.reason != COMPLETE && target.state != FAULT)
        fault_found(given);
    else if (target.l.trial.fresh)
        trial_ended();
    else if (recording && target.run.tick == target.run.rows)
        run_end(COMPLETE, NOBODY, 0.0, 0.0, "");
    if (target.l.closed)
        watch_held();
    if (target.state != FAULT || target.l.closed)
        give();
}

/* A target in real time counts ticks without a request; the host may have vanished. */
static void watch_host(void)
{
    const double passed_ms = 1e3 * (double)target.quiet_ticks / target.board->rate_hz;
    if (!loops_watched())
        return;
    target.quiet_ticks++;
    if (!(target.board->flags & BOARD_FAST) && passed_ms >= (double)target.c.watchdog_ms)
        loops_unheard(passed_ms);
}

void target_tick(void)
{
    struct loops *l = &target.l;

    const int begins = target.state == RUNNING && !target.run.going && l->phase == 0;
    if (begins && (target.run.place || l->way == l->ways))
        run_start();
    board_read(l->measured);
    watch_host();
    if (loops_watched())
        closed_tick();
    l->phase = target.c.loops ? (l->phase + 1) % target.c.period_ticks : 0;
}

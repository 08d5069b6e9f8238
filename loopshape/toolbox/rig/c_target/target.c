/* The target's state machine: requests in, answers out, each request done once. Specification: docs/protocol.md. */
#include "state.h"

#define PROTOCOL 1
#define ARM 0x06
#define VENT 0x0C
#define TAKES_SCHEDULES 4 /* of IDENTIFY's flags */
#define TAKES_BLOCKS 8
#define TAKES_TRIALS 32
#define GUARDED 16 /* READY gives ARM's number, poles outside the unit circle are refused */
#define TAGS_AHEAD 256u /* of a request that feeds the watchdog, beyond the one before it */
#define IDLE_MS 1000u /* a host that is silent for so long may be replaced */

struct target target;

uint8_t refuse(uint8_t code, const char **why, const char *sentence)
{
    *why = sentence;
    return code;
}

static uint8_t no_payload(const struct reader *in, const char **why)
{
    return read_whole(in) ? 0 : refuse(NO_MALFORMED, why, "this request has no payload");
}

static uint8_t ask_identify(struct reader *in, struct writer *out, const char **why)
{
    const struct board_info *b = target.board;

    (void)take_u16(in);
    if (!read_whole(in))
        return refuse(NO_MALFORMED, why, "IDENTIFY has another length");
    put_u16(out, PROTOCOL);
    put_u8(out, TARGET_NUMBER_BYTES);
    put_u8(out, b->sensors);
    put_u8(out, b->commands);
    put_u8(out, TARGET_LOOPS);
    put_u8(out, TARGET_SECTIONS);
    put_u32(out, TARGET_ROWS);
    put_u32(out, TARGET_TICKS);
    put_f64(out, b->rate_hz);
    put_f64(out, b->pwm_hz);
    put_u8(out, (uint8_t)(b->flags | GUARDED | TAKES_TRIALS | (TARGET_POOL > 0 ? TAKES_SCHEDULES | TAKES_BLOCKS : 0)));
    put_text(out, b->name);
    put_text(out, b->version);
    for (uint8_t k = 0; k < b->sensors + b->commands; k++)
        put_text(out, b->columns[k]);
    for (uint8_t k = 0; b->ranges && k < b->sensors + b->commands; k++) {
        put_f64(out, b->ranges[k][0]);
        put_f64(out, b->ranges[k][1]);
    }
    return 0;
}

static uint8_t ask_arm(struct reader *in, struct writer *out, const char **why)
{
    const uint32_t digest = take_u32(in);
    const int older = in->left == 0;
    const uint64_t number = take_bits(in, 8);

    (void)out;
    if (!read_whole(in))
        return refuse(NO_MALFORMED, why, older ? "without READY's number: update the host" : "ARM has another length");
    if (!target.c.ready)
        return refuse(NO_CONFIGURED, why, "READY comes first");
    if (digest != target.c.digest)
        return refuse(NO_DIGEST, why, "another configuration than the one that is here");
    if (target.fresh == 0 || number != target.fresh)
        return refuse(NO_FRESH, why, "another number than READY gave last");
    if (sensor_outside() != NOBODY)
        return refuse(NO_RANGE, why, "a sensor is outside its limits");
    target.fresh = 0;
    target.armed_here = 1;
    run_forget();
    target.ended[1].waiting = 0;
    target.fault = 0;
    target.state = ARMED;
    loops_arm();
    return 0;
}

static uint8_t ask_setpoint(struct reader *in, struct writer *out, const char **why)
{
    const double ramp_s = take_f64(in);
    double to[TARGET_LOOPS] = {0.0};

    (void)out;
    for (uint8_t k = 0; k < target.c.loops; k++)
        to[k] = take_f64(in);
    if (!read_whole(in))
        return refuse(NO_MALFORMED, why, "SETPOINT has another length");
    return loops_move(ramp_s, to) ? refuse(NO_RANGE, why, "the ramp or a reference") : 0;
}

static uint8_t ask_stop(struct reader *in, struct writer *out, const char **why)
{
    (void)out;
    const uint8_t refused = no_payload(in, why);
    if (!refused && target.state == RUNNING)
        run_end(STOPPED, NOBODY, 0.0, 0.0, "stopped by the host");
    return refused;
}

/* The emergency stop; a fault that is there keeps its reason. */
static void emergency_stop(void)
{
    if (target.state != FAULT) {
        run_end(EMERGENCY_STOP, NOBODY, 0.0, 0.0, "emergency stop by the host");
        target.fault = EMERGENCY_STOP;
    }
    loops_vent(FAULT);
}

/* Whatever else is wrong with the request. */
static uint8_t ask_vent(struct reader *in, struct writer *out, const char **why)
{
    (void)out, (void)in, (void)why;
    emergency_stop();
    return 0;
}

static uint8_t ask_disarm(struct reader *in, struct writer *out, const char **why)
{
    (void)out;
    const uint8_t refused = no_payload(in, why);
    if (refused)
        return refused;
    if (target.state == RUNNING)
        run_end(STOPPED, NOBODY, 0.0, 0.0, "disarmed by the host");
    loops_vent(target.state == FAULT ? FAULT : IDLE);
    return 0;
}

static uint8_t ask_clear(struct reader *in, struct writer *out, const char **why)
{
    (void)out;
    const uint8_t refused = no_payload(in, why);
    if (refused)
        return refused;
    target.fault = 0;
    loops_vent(IDLE);
    return 0;
}

static uint8_t ask_alive(struct reader *in, struct writer *out, const char **why)
{
    const uint32_t run = take_u32(in), received = take_u32(in);

    if (!read_whole(in))
        return refuse(NO_MALFORMED, why, "ALIVE has another length");
    stream_acknowledge(run, received);
    put_u8(out, target.state);
    put_u32(out, target.run.id);
    put_u32(out, target.run.tick);
    put_u32(out, target.run.taken);
    put_u32(out, target.decoder.bad);
    put_u8(out, target.fault);
    for (uint8_t k = 0; k < target.board->sensors; k++)
        put_number(out, (number)target.l.measured[k]);
    return 0;
}

#define IN(state) (1u << (state))
#define ANY (IN(IDLE) | IN(ARMED) | IN(RUNNING) | IN(FAULT))

/* Requests by their type, from 1 on, and the states that allow them. */
static const struct {
    request ask;
    uint8_t states;
} REQUESTS[] = {
    {ask_identify, ANY},      {ask_configure, IN(IDLE)}, {ask_sections, IN(IDLE)},
    {ask_limit, IN(IDLE)},    {ask_ready, IN(IDLE)},     {ask_arm, IN(IDLE)},
    {ask_setpoint, IN(ARMED)}, {ask_begin, IN(ARMED)},   {ask_rows, ANY},
    {ask_go, IN(ARMED)},      {ask_stop, ANY},           {ask_vent, ANY},
    {ask_disarm, ANY},        {ask_alive, ANY},          {ask_again, ANY},
    {ask_clear, IN(FAULT)},   {ask_schedule, IN(IDLE)},  {ask_nodes, IN(IDLE)},
    {ask_block, IN(IDLE)},    {ask_output, IN(IDLE)},    {ask_trial, IN(IDLE)},
    {ask_blend, IN(ARMED)},   {ask_progress, ANY},
};

static uint8_t done(uint8_t type, uint16_t tag, struct reader *in, struct writer *out, const char **why)
{
    if (tag == 0 && type != VENT)
        return refuse(NO_MALFORMED, why, "a request's tag is 1 or more");
    if (type == 0 || type > sizeof REQUESTS / sizeof REQUESTS[0])
        return refuse(NO_SUPPORT, why, "no such request");
    if (!(REQUESTS[type - 1].states & IN(target.state)))
        return refuse(NO_STATE, why, "not in this state");
    if (REQUESTS[type - 1].states == IN(ARMED) && !target.armed_here)
        return refuse(NO_PLACE, why, "another connection armed it");
    return REQUESTS[type - 1].ask(in, out, why);
}

/* A request was done: the watchdog is fed by those of the host that armed, each of them once, in the order of their tags. */
static void feed(uint8_t type, uint16_t tag)
{
    const uint16_t ahead = type == ARM ? 1 : (uint16_t)(tag - target.fed_tag);

    if (!target.armed_here || ahead == 0 || ahead > TAGS_AHEAD)
        return;
    target.fed_tag = tag;
    target.quiet_ticks = 0;
    target.fed = 1;
}

static void answer(const uint8_t *body, size_t count)
{
    struct reader in = {body + FRAME_HEAD, count - FRAME_HEAD, 0};
    const uint16_t tag = (uint16_t)(body[1] | body[2] << 8);
    struct writer out = body_of(target.answer, 0x81, tag);
    const char *why = "";
    const uint8_t code = done(body[0], tag, &in, &out, &why);

    if (code) {
        out = body_of(target.answer, 0x82, tag);
        put_u16(&out, code);
        put_text(&out, why);
    } else {
        feed(body[0], tag);
    }
    target.answer_count = out.count;
    memcpy(target.request, body, count);
    target.request_count = count;
}

/* Whether this is the request that was answered last, once more. An emergency stop never is: it is done each time. */
static int known(const uint8_t *body, size_t count)
{
    return body[0] != VENT && count == target.request_count && memcmp(body, target.request, count) == 0;
}

/* A whole frame has come. */
static void handle(const uint8_t *body, size_t count)
{
    if (body[0] >= 0x80)
        return; /* an answer, perhaps our own by an echo: nothing is answered to it, and it is no sign of a host */
    target.heard = 1;
    if (!known(body, count))
        answer(body, count);
    target.answer_waits = 1;
    (void)stream_poll();
}

void target_init(void)
{
    memset(&target, 0, sizeof target);
    target.board = board_info();
    loops_vent(IDLE);
    board_read(target.l.measured);
}

void target_receive(uint8_t byte)
{
    const size_t count = frame_receive(&target.decoder, byte);
    if (count > 0)
        handle(target.decoder.held, count);
}

void target_new_line(void)
{
    target.decoder.count = 0;
    target.decoder.spoilt = 0;
    target.request_count = 0;
    target.answer_waits = 0;
    target.armed_here = 0;
    target.fresh = 0;
    target.heard = 1;
}

int target_host_idle(void)
{
    return !loops_watched() && !target.heard && target.now_ms - target.heard_ms >= IDLE_MS;
}

size_t target_overhear(struct frame_decoder *decoder, uint8_t byte, int late, uint8_t *out)
{
    uint8_t body[64];
    struct writer said = {body, 0, sizeof body - FRAME_CHECK};
    const size_t count = frame_receive(decoder, byte);
    const uint8_t *held = decoder->held;
    const int vent = count > 0 && held[0] == VENT;

    if (vent)
        emergency_stop();
    else if (count == 0 || held[0] >= 0x80 || !late)
        return 0;
    put_u8(&said, vent ? 0x81 : 0x82);
    put_bits(&said, held[1] | (uint64_t)held[2] << 8, 2);
    if (!vent) {
        put_u16(&said, NO_PLACE);
        put_text(&said, "it is connected to another host");
    }
    return frame_close(body, said.count, out);
}

int target_waits(void)
{
    const struct recording *run = &target.run;
    if (!(target.board->flags & BOARD_FAST) || target.state != RUNNING)
        return 0;
    return run->tick - run->acknowledged >= TARGET_TICKS || (run->going && run->tick >= run->taken);
}

/* A host that vanished is told by the clock too: ticks may come late, or as fast as they can. */
static void watch_host_by_clock(void)
{
    if (target.heard)
        target.heard_ms = target.now_ms;
    target.heard = 0;
    if (target.fed)
        target.fed_ms = target.now_ms;
    target.fed = 0;
    if (loops_watched() && target.now_ms - target.fed_ms >= target.c.watchdog_ms)
        loops_unheard(target.now_ms - target.fed_ms);
}

int target_poll(uint32_t now_ms)
{
    target.now_ms = now_ms;
    watch_host_by_clock();
    return stream_poll();
}

int target_state(void)
{
    return target.state;
}

/*
 * Hostile executions of the target: each is drawn from its number, begins at power-up (or armed, with a recording), and gets
 * frames that are whole, changed, cut, doubled or made up, bytes of no frame, ticks, sensors of any value, and time.
 *
 *     fuzzed_target FIRST COUNT      prints how many executions, frames, arms, vents there were
 *
 * It aborts where: the machine is given a command while it is safe; the loops are enabled by anything but an ARM with the right
 * digest; a VENT leaves it anything but safe and in fault; a silence of the watchdog's time leaves the loops closed.
 */
#include "board.h"
#include "bytes.h"
#include "frames.h"
#include "target.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

enum { IDLE, ARMED, RUNNING, FAULT };
#define WATCHDOG_MS 50u

static const char *const COLUMNS[] = {"a_rad", "b_bar", "u_v"};
static const double RANGES[][2] = {{-4.0, 4.0}, {-10.0, 10.0}, {-10.0, 10.0}};
static const struct board_info info = {"fuzzed", TARGET_VERSION, 2, 1, COLUMNS, RANGES, 1000.0, 50.0, 0.01, 0};
static uint64_t state;
static double sensors[2];
static int safe, may_enable;
static uint32_t now_ms, digest;
static uint64_t fresh = UINT64_C(1) << 40; /* changed frames draw none of these */
static unsigned long frames, arms, vents;

static void hold(int fine, const char *what)
{
    if (fine)
        return;
    fprintf(stderr, "broken: %s\n", what);
    abort();
}

static uint32_t drawn(uint32_t below)
{
    state ^= state << 13;
    state ^= state >> 7;
    state ^= state << 17;
    return (uint32_t)((state >> 33) % below);
}

const struct board_info *board_info(void)
{
    return &info;
}

void board_read(double *out)
{
    memcpy(out, sensors, sizeof sensors);
}

void board_give(const double *commands)
{
    hold(!safe, "a command while it is safe");
    hold(fabs(commands[0]) <= 0.02, "a pulse longer than its period");
}

void board_enable(void)
{
    hold(may_enable, "enabled without an ARM");
    safe = 0;
    arms++;
}

void board_safe(void)
{
    safe = 1;
}

size_t board_space(void)
{
    return drawn(8) ? FRAME_ENCODED : 0;
}

void board_send(const uint8_t *bytes, size_t count)
{
    hold(count <= FRAME_ENCODED + 1 && bytes[count - 1] == 0, "a frame that is too long or has no end");
}

const char *board_trouble(int recording)
{
    return recording && drawn(2000) == 0 ? "too hot" : NULL;
}

int board_place(const double *outputs, uint8_t loops, const double *references, int now)
{
    (void)outputs, (void)loops, (void)references, (void)now;
    return 0;
}

uint64_t board_fresh(void)
{
    return ++fresh;
}

void board_noise(uint64_t noise)
{
    (void)noise;
}

static void receive(const uint8_t *bytes, size_t count)
{
    for (size_t k = 0; k < count; k++)
        target_receive(bytes[k]);
}

/* A whole frame of this request. */
static void ask(uint8_t type, const struct writer *payload)
{
    static uint16_t tag;
    uint8_t body[FRAME_BODY], encoded[FRAME_ENCODED + 1];
    struct writer out = {body, 0, FRAME_HEAD + FRAME_PAYLOAD};

    put_u8(&out, type);
    tag = (uint16_t)(tag % 65535u + 1u);
    put_u16(&out, tag);
    memcpy(body + out.count, payload->data, payload->count);
    const size_t count = frame_close(body, out.count + payload->count, encoded);
    may_enable = type == 0x06;
    receive(encoded, count);
    may_enable = 0;
    frames++;
}

static double any_number(void)
{
    static const double known[] = {0.0, -0.0, 1.0, -1.0, 0.5, 1e308, -1e308, 1e-308, INFINITY, -INFINITY, NAN};
    return drawn(3) ? ((double)drawn(2000) - 1000.0) / 500.0 : known[drawn(sizeof known / sizeof known[0])];
}

/* The payload of a request: fitting, with numbers of any kind, or of any bytes. */
static void fill(uint8_t type, struct writer *p)
{
    static const char *const form[0x18] = {"",    "h",        "bbbhdddddd", "bbbddddd", "bddd", "", "iq",  "dd", "iibhqb",
                                           "iibd", "i", "",  "",     "",    "ii",  "iih",  "", "bbbdbdbdd", "bhbdddddd", "bbhbbdbddddd", "bb",
                                           "bbbdddddd", "diiiddddd", ""};
    const char *text = type <= 0x17 ? form[type] : "qqq";
    if (drawn(8) == 0) {
        for (uint32_t n = drawn(60); n > 0; n--)
            put_u8(p, (uint8_t)drawn(256));
        return;
    }
    for (; *text; text++)
        if (*text == 'd')
            put_f64(p, any_number());
        else
            put_bits(p, drawn(3) ? drawn(3) : (uint64_t)drawn(UINT32_MAX) << 8 | drawn(256),
                     *text == 'b' ? 1 : *text == 'h' ? 2 : *text == 'i' ? 4 : 8);
}

/* A part of the configuration, into the digest and on its way. */
static void part(uint8_t type, struct writer *p)
{
    digest = crc32_of(digest, p->data, p->count);
    ask(type, p);
    p->count = 0;
}

/* A block every other tick that comes late, and one that reads it, itself late and the loop's error. */
static void diagram(struct writer *p)
{
    const double section[] = {0.5, 0.2, 0.0, -0.4, 0.1};
    for (uint8_t k = 0; k < 2; k++) {
        put_u8(p, k), put_u8(p, (uint8_t)(2 - k)), put_u16(p, (uint16_t)(1 + drawn(3))), put_u8(p, 3);
        for (uint8_t j = 0; j < 3; j++)
            put_u8(p, j == 2 ? (uint8_t)(3 - k) : j), put_f64(p, j == 1 ? -1.0 : 0.5);
        put_u8(p, 1);
        for (int j = 0; j < 5; j++)
            put_f64(p, section[j]);
        part(0x13, p);
    }
    put_u8(p, 0), put_u8(p, (uint8_t)drawn(2));
    part(0x14, p);
}

/* A gain, a gain of a diagram, or one that follows the reference or the output over two nodes. */
static void controller(struct writer *p)
{
    const double gain[] = {2.0, 0.0, 0.0, 0.0, 0.0}, node[] = {2.0, 0.1, 0.0, 1.0, 0.0, 0.0};
    const uint32_t kind = drawn(3);
    if (kind == 0) {
        diagram(p);
        return;
    }
    if (kind == 1) {
        put_u8(p, 0), put_u8(p, 0), put_u8(p, 1);
        for (int k = 0; k < 5; k++)
            put_f64(p, gain[k]);
        part(0x03, p);
        return;
    }
    put_u8(p, 0), put_u8(p, 1), put_u8(p, 1), put_f64(p, 0.5);
    put_u8(p, (uint8_t)drawn(2)), put_f64(p, 1.0), put_u8(p, 2), put_f64(p, 0.0), put_f64(p, 0.5);
    part(0x11, p);
    for (uint8_t row = 0; row < 2; row++) {
        put_u8(p, 0), put_u16(p, row), put_u8(p, 1);
        for (int k = 0; k < 6; k++)
            put_f64(p, (row + 1.0) * node[k]);
        part(0x12, p);
    }
}

/* Half of another gain, watched for this and that. */
static void blend(struct writer *p)
{
    p->count = 0;
    put_f64(p, 0.5), put_u32(p, drawn(10)), put_u32(p, 1 + drawn(60)), put_u32(p, 1 + drawn(10));
    put_f64(p, 1.0 + drawn(2)), put_f64(p, -3.0), put_f64(p, 3.0), put_f64(p, 1.0 + drawn(2)), put_f64(p, 2.0);
    ask(0x16, p);
}

static void configure(uint8_t hold_on_limit)
{
    uint8_t data[256];
    struct writer p = {data, 0, sizeof data};
    const double other[] = {0.5, 3.0, 0.2, 0.0, -0.4, 0.1}; /* track, then a section */
    const int tried = drawn(2) == 0;
    const double head[] = {0.0, 0.0, 0.0, 1.0, 0.0, 1.0};

    put_u8(&p, 1), put_u8(&p, hold_on_limit), put_u8(&p, 1), put_u16(&p, WATCHDOG_MS);
    for (int k = 0; k < 6; k++)
        put_f64(&p, head[k]);
    digest = 0;
    part(0x02, &p);
    controller(&p);
    for (uint8_t k = 0; k < 3; k++) {
        put_u8(&p, k), put_f64(&p, -1.0), put_f64(&p, 1.0), put_f64(&p, drawn(2) ? INFINITY : 50.0);
        part(0x04, &p);
    }
    if (tried) {
        put_u8(&p, 0), put_u8(&p, 0), put_u8(&p, 1);
        for (int k = 0; k < 6; k++)
            put_f64(&p, other[k]);
        part(0x15, &p);
    }
    ask(0x05, &p);
    put_u32(&p, digest), put_bits(&p, fresh, 8);
    ask(0x06, &p);
    if (tried && drawn(4))
        blend(&p);
}

static void record(void)
{
    uint8_t data[600];
    struct writer p = {data, 0, sizeof data};

    put_u32(&p, 7), put_u32(&p, 30), put_u8(&p, (uint8_t)drawn(3)), put_u16(&p, 2), put_bits(&p, 0, 8), put_u8(&p, 0);
    ask(0x08, &p);
    p.count = 0;
    put_u32(&p, 7), put_u32(&p, 0), put_u8(&p, 30);
    for (int k = 0; k < 30; k++)
        put_f64(&p, 1e-3 * k);
    ask(0x09, &p);
    p.count = 0;
    put_u32(&p, 7);
    ask(0x0A, &p);
}

/* A frame as a bad line or a mad program sends it; it may be whole still, and may then be no ARM. */
static void send_changed(void)
{
    uint8_t data[FRAME_PAYLOAD], body[FRAME_BODY], encoded[2 * FRAME_ENCODED + 4];
    struct writer p = {data, 0, sizeof data}, out = {body, 0, FRAME_HEAD + FRAME_PAYLOAD};
    const uint8_t type = (uint8_t)drawn(0x1A);

    fill(type, &p);
    put_u8(&out, type), put_u16(&out, (uint16_t)drawn(4));
    memcpy(body + out.count, data, p.count);
    size_t count = frame_close(body, out.count + p.count, encoded);
    const size_t at = drawn((uint32_t)count);
    switch (drawn(6)) {
    case 0: encoded[at] ^= (uint8_t)(1u << drawn(8)); break;
    case 1: encoded[at] = 0; break;
    case 2: count = at; break;
    case 3: memcpy(encoded + count, encoded, count); count *= 2; break;
    case 4: encoded[0] = (uint8_t)drawn(256); break;
    default: break;
    }
    frames++;
    receive(encoded, count); /* an ARM's digest is drawn, and right once in 4 thousand million */
}

static void send_noise(void)
{
    uint8_t bytes[64];
    const size_t count = drawn(sizeof bytes);
    for (size_t k = 0; k < count; k++)
        bytes[k] = (uint8_t)drawn(256);
    receive(bytes, count);
}

static void pass(uint32_t ticks)
{
    for (uint32_t k = 0; k < ticks; k++) {
        target_tick();
        now_ms++;
        if (drawn(4) == 0)
            (void)target_poll(now_ms);
    }
}

static void vent(void)
{
    uint8_t data[32];
    struct writer p = {data, 0, sizeof data};
    const uint8_t zero = 0;
    receive(&zero, 1); /* what is half there is ended first, as a host does */
    fill(0x11, &p);
    p.count = drawn((uint32_t)p.count + 1);
    ask(0x0C, &p);
    vents++;
    hold(safe && target_state() == FAULT, "a VENT left it moving");
}

static void silence(void)
{
    pass(WATCHDOG_MS + 2);
    hold(safe && target_state() != ARMED && target_state() != RUNNING, "a silent host left the loops closed");
}

static void execute(uint64_t number)
{
    state = number * UINT64_C(0x9e3779b97f4a7c15) + 1;
    sensors[0] = sensors[1] = 0.0;
    safe = 0;
    target_init();
    hold(safe, "not safe at power-up");
    const int start = (int)drawn(4);
    if (start > 0)
        configure((uint8_t)drawn(2));
    hold(start == 0 || target_state() == ARMED, "not armed by a right digest");
    if (start > 1)
        record();
    for (uint32_t n = 3 + drawn(10); n > 0; n--)
        switch (drawn(10)) {
        case 0: send_noise(); break;
        case 1: sensors[drawn(2)] = any_number(); break;
        case 2: case 3: pass(1 + drawn(12)); break;
        case 4: if (drawn(4) == 0) target_new_line(); break;
        default: send_changed();
        }
    if (drawn(2))
        vent();
    else
        silence();
}

int main(int count, char **words)
{
    if (count != 3)
        return 2;
    const uint64_t first = strtoull(words[1], NULL, 10), executions = strtoull(words[2], NULL, 10);
    for (uint64_t k = 0; k < executions; k++)
        execute(first + k);
    printf("%lu %lu %lu %lu\n", (unsigned long)executions, frames, arms, vents);
    return 0;
}

/*
 * The target with a simulated 1-DoF arm behind a pseudo-terminal or a TCP socket on this machine.
 *
 *     arm_emulator --plant FILE|- [--tcp PORT] [--real-time] [--until-eof] [--drop P] [--corrupt P] [--duplicate P] [--seed N]
 *                  [--die-after N] [--mute-after N]
 *
 * Prints the port to connect to. A plant's file (- is standard input) ends with the line `end`. Vented, the arm falls until
 * it leaves the model's range; then, or once the target is idle, it stands again at rest where the plant's file says, as if
 * somebody had put it back.
 */
#define _POSIX_C_SOURCE 200809L
#include "../board.h"
#include "../frames.h"
#include "../target.h"
#include "arm_options.h"

#include <errno.h>
#include <stdio.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#define BURST 100        /* ticks between two looks at the line, as fast as it can */
#define READS 4          /* of the line between two looks at the clock, 2 kB each */
#define LATE_MS 900      /* a host that has waited for so long is told why */
#define STOP_SHARE 1.2   /* end stops, over the range's angle */

static const char *const COLUMNS[] = {"theta2_rad", "p_a_bar", "p_b_bar", "u_a_v", "u_b_v"};
static const double RANGES[][2] = {{-3.2, 3.2}, {-10.0, 10.0}, {-10.0, 10.0}, {-100.0, 100.0}, {-100.0, 100.0}};
static struct board_info info = {"arm-1dof emulator", TARGET_VERSION, 3, 2, COLUMNS, RANGES, 0.0, 0.0, 0.0, BOARD_EMULATED};
static struct options options;
static struct arm arm;
static double tick_s;
static uint64_t phase, recorded;
static int safe, parked;
static const char *left;

/* ---- the board ---- */

const struct board_info *board_info(void)
{
    return &info;
}

void board_read(double *sensors)
{
    arm_sense(&arm, sensors);
}

static void valves_shut(void)
{
    arm.close_a = arm.close_b = 0.0;
    arm.fills_a = arm.fills_b = 0;
}

void board_give(const double *pulses)
{
    arm.close_a = fabs(pulses[0]);
    arm.close_b = fabs(pulses[1]);
    arm.fills_a = pulses[0] > 0.0 ? 1 : pulses[0] < 0.0 ? -1 : 0;
    arm.fills_b = pulses[1] > 0.0 ? 1 : pulses[1] < 0.0 ? -1 : 0;
    phase = 0;
}

void board_enable(void)
{
    safe = parked = 0;
    valves_shut();
}

void board_safe(void)
{
    safe = 1;
}

size_t board_space(void)
{
    return line_space();
}

void board_send(const uint8_t *bytes, size_t count)
{
    line_send(bytes, count);
}

const char *board_trouble(int recording)
{
    if (!recording)
        return NULL;
    if (options.die_after && recorded == options.die_after)
        _exit(1);
    if (options.mute_after && recorded == options.mute_after)
        line_mute();
    recorded++;
    return left;
}

static int rest_at(double angle, double p_ab_bar, int now)
{
    const double p_a = arm_balance(&arm, angle, p_ab_bar), p_b = p_ab_bar - p_a;
    struct arm there = arm;
    const double x[5] = {arm.c[P_IN], 1e5 * p_a, 1e5 * p_b, angle, 0.0};

    memcpy(there.x, x, sizeof x);
    if (arm_left(&there))
        return 0;
    if (now) {
        arm = there;
        valves_shut();
        left = NULL;
    }
    return 1;
}

/* Outputs that this machine can be placed at: theta2, and p_A + p_B. */
int board_place(const double *outputs, uint8_t loops, const double *references, int now)
{
    static const double known[6] = {1.0, 0.0, 0.0, 0.0, 1.0, 1.0};
    return loops == 2 && memcmp(outputs, known, sizeof known) == 0 && rest_at(references[0], references[1], now);
}

/* The system's randomness, 0 where it gives none. */
uint64_t board_fresh(void)
{
    uint64_t number = 0;
    FILE *source = fopen("/dev/urandom", "rb");

    if (source) {
        if (fread(&number, sizeof number, 1, source) != 1)
            number = 0;
        fclose(source);
    }
    return number;
}

void board_noise(uint64_t state)
{
    arm.noise = state;
    arm.has_spare = 0;
}

/* ---- the machine's tick ---- */

static void put_back(void)
{
    (void)rest_at(options.start_rad, options.start_bar, 1);
    parked = safe;
}

/* Outside of the range there are end stops and nothing below no pressure. */
static void stay_possible(void)
{
    const double stop = STOP_SHARE * arm.sensor[WIDEST];
    if (!isfinite(arm.x[0] + arm.x[1] + arm.x[2] + arm.x[3] + arm.x[4])) {
        const char *why = left;
        put_back();
        left = why;
        return;
    }
    if (fabs(arm.x[3]) > stop) {
        arm.x[3] = copysign(stop, arm.x[3]);
        arm.x[4] = 0.0;
    }
    arm.x[1] = fmax(arm.x[1], 0.0);
    arm.x[2] = fmax(arm.x[2], 0.0);
}

static void machine_tick(void)
{
    if (safe && !parked && target_state() == 0)
        put_back(); /* idle: whoever cleared the fault has looked after the machine */
    if (parked)
        return;
    if (safe) {
        arm.fills_a = arm.fills_b = -1;
        arm.close_a = arm.close_b = (double)INFINITY;
    }
    arm_move(&arm, (double)phase * tick_s, (double)(phase + 1) * tick_s);
    phase++;
    left = arm_left(&arm);
    if (left && safe)
        put_back();
    else if (left)
        stay_possible();
}

/* ---- the program ---- */

static int64_t clock_us(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000000 + now.tv_nsec / 1000;
}

/* A host that waits: its emergency stop is heard all the same. */
static void overhear(int k)
{
    static struct frame_decoder decoders[LINE_WAITING];
    uint8_t bytes[1024], answer[FRAME_ENCODED];
    int fresh = 0;
    const size_t count = line_overhear(k, bytes, sizeof bytes, &fresh);

    if (fresh)
        memset(&decoders[k], 0, sizeof decoders[k]);
    for (size_t at = 0; at < count; at++) {
        const size_t said = target_overhear(&decoders[k], bytes[at], line_waited_ms(k) >= LATE_MS, answer);
        if (said > 0)
            line_answer(k, answer, said);
    }
}

static void receive(void)
{
    uint8_t bytes[8192];
    int fresh = 0;
    size_t count = 1;
    for (int reads = 0; reads < READS && count > 0; reads++) {
        count = line_receive(bytes, sizeof bytes, &fresh);
        if (fresh)
            target_new_line();
        for (size_t k = 0; k < count; k++)
            target_receive(bytes[k]);
    }
    line_give_place(target_host_idle());
    for (int k = 0; k < LINE_WAITING; k++)
        overhear(k);
}

static void send(void)
{
    while (target_poll((uint32_t)(clock_us() / 1000)))
        ;
    line_flush();
}

static void tick(void)
{
    target_tick();
    machine_tick();
}

static void run_fast(void)
{
    for (;;) {
        const int waits = target_waits(), state = target_state();
        const int pause_ms = state == 2 && !waits ? 0 : state == 1 || waits ? 1 : 10;
        if (!line_wait(pause_ms, options.until_eof))
            return;
        receive();
        for (int k = 0; k < BURST && !target_waits(); k++)
            tick();
        send();
    }
}

static void run_in_real_time(void)
{
    const double tick_us = 1e6 / info.rate_hz;
    int64_t begun = clock_us(), done = 0;

    while (line_wait(1, options.until_eof)) {
        int64_t due = (int64_t)((double)(clock_us() - begun) / tick_us) - done;
        receive();
        if (due > (int64_t)info.rate_hz) { /* this process was put to sleep: a real machine would have gone on */
            begun = clock_us();
            done = due = 0;
        }
        for (; due > 0; due--, done++)
            tick();
        send();
    }
}

static void open_line(void)
{
    char name[256];
    if ((options.tcp ? line_open_tcp(options.port, name, sizeof name) : line_open_terminal(name, sizeof name)) != 0)
        stop_with("no port could be opened", strerror(errno));
    printf("%s\n", name);
    fflush(stdout);
}

int main(int count, char **words)
{
    options = read_options(count, words);
    arm = options.arm;
    info.rate_hz = options.rate_hz;
    info.pwm_hz = options.pwm_hz;
    info.dead_zone = options.dead_zone;
    info.flags = options.real_time ? BOARD_EMULATED : BOARD_EMULATED | BOARD_FAST;
    tick_s = 1.0 / info.rate_hz;
    line_set_faults(options.faults);
    if (!rest_at(options.start_rad, options.start_bar, 1))
        stop_with("the arm has no rest where it shall start", options.plant);
    parked = 1;
    target_init();
    open_line();
    if (options.real_time)
        run_in_real_time();
    else
        run_fast();
    return 0;
}

/*
 * What a board has to write so that the target runs on it. How to port:
 *
 * 1. Write the functions below for the board: read the sensors in their units, give pulses to the valves, make the machine
 *    safe, send bytes. boards/cortex_m is a whole one, for an STM32F4 (docs/board.md); scripted.c, a board of the tests, has the functions and
 *    nothing around them. "Vent" is the board's safe state: for a motor, the drive disabled or braked. Compile with
 *    blocks.c, configure.c, frames.c, loops.c, run.c, schedule.c, stream.c, target.c and trial.c alone; boards/line.c is the emulator's.
 * 2. Choose the sizes (target.h: TARGET_LOOPS, TARGET_ROWS, TARGET_TICKS, TARGET_NUMBER_BYTES, ...). RAM is 8 kB (two loops,
 *    five columns) to 11 kB (as target.h has them), + 8 TARGET_POOL bytes and 0.5 kB a loop for schedules and blocks (none
 *    where it is 0), + TARGET_ROWS x 2 TARGET_LOOPS numbers + TARGET_TICKS x
 *    (3 TARGET_LOOPS + TARGET_SENSORS + TARGET_COMMANDS) numbers: 545 kB as target.h has them, which is a PC's; 35 kB for one
 *    axis with one loop, sensor and command, 1024 rows, 1024 ticks, 4 bytes. The program is about 23 kB, 20 kB
 *    without schedules and blocks (x86-64, -Os). The line
 *    carries rate x (3 loops + sensors + commands) x bytes x 11 bit/s: an axis at 2 kHz with 4 bytes 440 kbaud.
 * 3. At power-up: hardware first (valves in the safe state), then target_init().
 * 4. A timer calls target_tick() at the board's rate. It reads the sensors, closes the loops, checks limits, and hands over
 *    pulses when a PWM period begins.
 * 5. The main loop hands the bytes that arrive to target_receive() and calls target_poll(ms) again and again, at least every
 *    10 ms; it sends what is due, one frame a call. Between two looks at the timer it serves TARGET_BYTES at most: a line that
 *    never falls silent must not keep it from its ticks. The timer's interrupt counts `due` up and does nothing else, so that
 *    no tick is lost. The whole program (a test floods it as it stands here):
 *
 *        hardware_init();
 *        target_init();
 *        for (;;) {
 *            for (; done != due; done++)
 *                target_tick();
 *            for (int n = 0, c; n < TARGET_BYTES && (c = uart_get()) >= 0; n++)
 *                target_receive((uint8_t)c);
 *            target_poll(ms());
 *        }
 *
 *    `loopshape measure STUDY --port PORT --show` talks to it without moving anything.
 * 6. tick on one side and receive and poll on the other share everything. Call all from one loop (the timer counts), or
 *    keep the tick's interrupt shut out while receive and poll run; a frame takes them some 10 000 instructions.
 * 7. Leave a hardware watchdog and an emergency stop that need no program where they are: this program replaces neither.
 *
 * The watchdog of the protocol counts ticks, so that it acts even if the main loop hangs, and the milliseconds of target_poll,
 * so that it acts in time where ticks come late; a board that runs as fast as it can goes by the milliseconds alone. Numbers: f64 arithmetic, by software where the machine has none (a
 * tick of two loops with eight sections is about 300 operations). No heap, no files, no operating system; <math.h> for
 * fabs, ceil and isfinite alone.
 */
#ifndef LOOPSHAPE_BOARD_H
#define LOOPSHAPE_BOARD_H

#include <stddef.h>
#include <stdint.h>

#define BOARD_EMULATED 1u /* no machine behind it */
#define BOARD_FAST 2u     /* ticks come as fast as they can: wait where target_waits() says so */

struct board_info {
    const char *name, *version;   /* up to 60 bytes each */
    uint8_t sensors, commands;    /* up to TARGET_SENSORS, TARGET_COMMANDS */
    const char *const *columns;   /* names of the sensors, then of the commands, with their unit: `x_mm`, `u_v` */
    const double (*ranges)[2];    /* lowest and highest value of each, in the same order: no limit lies beyond */
    double rate_hz;               /* ticks a second */
    double pwm_hz, dead_zone;     /* the board's own; 0 Hz: no PWM */
    uint8_t flags;
};

const struct board_info *board_info(void);

/* The sensors, in their columns' units. */
void board_read(double *sensors);

/* With PWM: signed length in s of each command's pulse, at the period's start. Without: each tick, the commands. */
void board_give(const double *commands);

/* From now on board_give comes: make the outputs ready. */
void board_enable(void);

/* The safe state, at once and until board_enable: a pneumatic machine's out valves open. */
void board_safe(void);

/* Bytes that board_send takes now; a board needs a queue of FRAME_ENCODED bytes or more. */
size_t board_space(void);

/* Send a whole frame; it was asked for its space before. */
void board_send(const uint8_t *bytes, size_t count);

/* What is wrong with the machine by its own judgement, or NULL; asked each tick while the loops are closed. */
const char *board_trouble(int recording);

/*
 * Emulated machines: can it stand at rest where the outputs Y s are `references` (Y: loops x sensors, row by row)? `now`: put it
 * there. Gives 0 where it cannot. A real machine gives 0.
 */
int board_place(const double *outputs, uint8_t loops, const double *references, int now);

/*
 * A number that was never given before, cannot be foreseen, and is not 0: what a host repeats to arm, so that recorded bytes
 * arm nothing. From a generator of random numbers; without one, from what differs at each start (a counter kept in flash or
 * EEPROM, raised at power-up) mixed with a fast timer's count. 0 says that there is none, and nothing can be armed then.
 */
uint64_t board_fresh(void);

/* Emulated machines: the state of the noise generator from the next sample on. A real machine does nothing. */
void board_noise(uint64_t state);

#endif

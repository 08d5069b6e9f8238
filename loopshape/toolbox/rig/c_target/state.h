/* Inside the target: its one state, and what its parts ask of each other. Not for a port. */
#ifndef LOOPSHAPE_STATE_H
#define LOOPSHAPE_STATE_H

#include "board.h"
#include "bytes.h"
#include "frames.h"
#include "target.h"

#if TARGET_NUMBER_BYTES == 8
typedef double number;
#define put_number put_f64
#define take_number take_f64
#elif TARGET_NUMBER_BYTES == 4
typedef float number;
#define put_number put_f32
#define take_number take_f32
#else
#error "TARGET_NUMBER_BYTES is 4 or 8"
#endif

#define LIMITED (TARGET_SENSORS + TARGET_COMMANDS)
#define WIDTH (3 * TARGET_LOOPS + LIMITED) /* numbers a tick, at most */
#if TARGET_SAMPLE_BYTES > 1000 || TARGET_SAMPLE_BYTES < 9 + (3 * TARGET_LOOPS + TARGET_SENSORS + TARGET_COMMANDS) * TARGET_NUMBER_BYTES
#error "TARGET_SAMPLE_BYTES holds a tick, and no more than a frame"
#endif
#define RATE_TICKS 10u                     /* a rate is averaged over so many */
#define AGAIN_MOST 8u                      /* ranges that wait to be sent again */
#define VARIABLES 3u                       /* of a schedule, at most */
#define FOLLOWERS (TARGET_POOL > 0 ? TARGET_LOOPS : 1)
#define NOBODY 255u                        /* no limit's index */

enum { IDLE, ARMED, RUNNING, FAULT };
enum { NO_STATE = 1, NO_MALFORMED, NO_RANGE, NO_CONFIGURED, NO_DIGEST, NO_ROOM, NO_RUN, NO_SUPPORT, NO_PLACE, NO_FRESH };
enum { COMPLETE, STOPPED, LIMIT, RATE_LIMIT, WATCHDOG, UNDERRUN, EMERGENCY_STOP, MACHINE, TRIAL };
enum { CONTROLLER_INPUT, PLANT_INPUT, CONTROL };
enum { OWN, ON_TRIAL, WENT_BACK, KEPT }; /* of a trial */

struct limit {
    double low, high, rate;
};

/* A controller whose coefficients follow an operating point; without sections it is none. Its numbers lie in one piece. */
struct schedule {
    uint8_t variables, sections, source[VARIABLES], counts[VARIABLES];
    uint32_t from, rows, taken; /* where its knots begin, rows behind them: in all, and here */
    double share, scale[VARIABLES];
};

/* Where such a controller stands. */
struct follower {
    uint8_t begun;
    double at[VARIABLES], now[TARGET_SECTIONS][5];
    double past[TARGET_SECTIONS + 1][2]; /* the last two signals in front of and behind each section */
};

/* A sum of signals through sections. Its numbers: weights, coefficients; then what moves: states, delay line, value. */
struct block {
    uint8_t every, terms, sections, signal[TARGET_TERMS];
    uint16_t delay;
    uint32_t from;
};

/* A controller that may take a loop's place; without sections there is none. */
struct trial_setup {
    uint8_t loop, count;
    double track, sections[TARGET_SECTIONS][5];
};

/* What a trial's step is watched for; ticks. */
struct watch {
    uint32_t ramp, lease, window;
    double share, error_peak, control_low, control_high, error_rms, growth;
};

/* How far a trial is, and why it went back. */
struct trial {
    uint8_t phase, why, fresh, rising;
    uint32_t ticks, seen, began_ms; /* since BLEND, of this window, and when that was */
    double state[TARGET_SECTIONS][2], offset, share, from, sum, before, value, limit;
    struct watch watch;
};

/* What CONFIGURE, BLOCK, SECTIONS, SCHEDULE, NODES, OUTPUT, LIMIT and TRIAL said, and how far they came. */
struct configuration {
    uint8_t loops, hold, sections_loop, limits, ready;
    uint16_t watchdog_ms;
    uint32_t period_ticks, digest;
    double soft_start_s, period_s, dead_zone;
    double outputs[TARGET_LOOPS * TARGET_SENSORS], mixing[TARGET_COMMANDS * TARGET_LOOPS];
    uint8_t count[TARGET_LOOPS];
    double sections[TARGET_LOOPS][TARGET_SECTIONS][5];
    struct schedule schedule[TARGET_LOOPS];
    struct block block[TARGET_BLOCKS];
    uint8_t blocks, output[TARGET_LOOPS]; /* the block that gives z, from 1 on; 0: none */
    uint32_t used;                        /* of the numbers */
    double numbers[TARGET_POOL > 0 ? TARGET_POOL : 1];
    struct limit limit[LIMITED];
    struct trial_setup trial;
};

/* The loops: sensors and commands in one row, as LIMIT counts them. */
struct loops {
    double measured[LIMITED]; /* sensors, then commands */
    double y[TARGET_LOOPS], r[TARGET_LOOPS], n[TARGET_LOOPS], z[TARGET_LOOPS];
    double state[TARGET_LOOPS][TARGET_SECTIONS][2];
    struct follower follower[FOLLOWERS];
    struct trial trial;
    uint8_t block_wait[TARGET_BLOCKS]; /* ticks until its turn */
    uint16_t block_at[TARGET_BLOCKS];  /* place in its delay line */
    double from[TARGET_LOOPS], to[TARGET_LOOPS]; /* the references' way to the setpoint */
    uint32_t way, ways;                          /* ticks of it, done and in all */
    double before[LIMITED][RATE_TICKS];          /* the last values, for the rates */
    uint32_t before_at;
    uint32_t phase; /* ticks since the PWM period began */
    uint8_t fresh;  /* the next values are the first */
    uint8_t closed; /* a fault that holds */
};

/* The last recording that BEGIN announced. */
struct recording {
    uint32_t id, rows, taken, tick;
    uint32_t sent, acknowledged; /* next tick to send the first time; ticks that the host has */
    uint64_t noise;
    uint16_t columns;
    uint8_t injection, place, numbers, width, announced, going;
};

struct ended {
    uint32_t run, ticks, tick, said_ms;
    double value, limit;
    uint8_t reason, index, waiting, said;
    char sentence[64];
};

struct range {
    uint32_t first, count;
};

struct target {
    const struct board_info *board;
    uint8_t state, fault;
    struct configuration c;
    struct loops l;
    struct recording run;
    struct ended ended[2]; /* of the recording, and of a fault outside one */
    struct range again[AGAIN_MOST];
    uint8_t again_count;
    uint16_t frames_sent;
    uint32_t quiet_ticks, fed_ms; /* since and when the watchdog was fed */
    uint32_t heard_ms, now_ms, samples_ms; /* when a request came; when samples went */
    uint64_t fresh;       /* the number that ARM repeats, 0: none is given */
    uint16_t fed_tag;     /* of the request that fed the watchdog last */
    uint8_t armed_here;   /* this connection armed it last */
    uint8_t fed, heard;   /* the watchdog was fed, a request came, since target_poll was told the time */
    uint8_t answer_waits;
    size_t answer_count, request_count; /* request_count 0: none is remembered */
    uint8_t request[FRAME_BODY];        /* what was answered last, its CRC left out */
    uint8_t answer[FRAME_BODY], body[FRAME_BODY], encoded[FRAME_ENCODED];
    struct frame_decoder decoder;
    number excitation[TARGET_ROWS * 2 * TARGET_LOOPS]; /* a ring of rows */
    number memory[TARGET_TICKS * WIDTH];               /* a ring of ticks */
};

extern struct target target;

/* Answers of a request: 0, or a NO code with `*why` said. */
typedef uint8_t (*request)(struct reader *in, struct writer *out, const char **why);

uint8_t refuse(uint8_t code, const char **why, const char *sentence);

/* configure.c */
uint8_t ask_configure(struct reader *in, struct writer *out, const char **why);
uint8_t ask_sections(struct reader *in, struct writer *out, const char **why);
uint8_t ask_limit(struct reader *in, struct writer *out, const char **why);
uint8_t ask_ready(struct reader *in, struct writer *out, const char **why);
int numbers_finite(struct reader in, size_t count);
int poles_allowed(double a1, double a2); /* of a section */
int sections_allowed(const double *table, uint8_t count);
#define OUTSIDE_CIRCLE "a pole lies outside the unit circle"
int controller_begins(uint8_t loop); /* whether this loop's controller comes next */
void configuration_taken(const uint8_t *payload, size_t size);

/* schedule.c */
uint8_t ask_schedule(struct reader *in, struct writer *out, const char **why);
uint8_t ask_nodes(struct reader *in, struct writer *out, const char **why);
double schedule_step(uint8_t loop, double value);

/* blocks.c */
uint8_t ask_block(struct reader *in, struct writer *out, const char **why);
uint8_t ask_output(struct reader *in, struct writer *out, const char **why);
int blocks_known(void); /* whether each reads what is there by then */
void blocks_rest(void);
void blocks_step(int injected); /* n is taken off y */
double block_value(uint8_t block);

/* trial.c */
uint8_t ask_trial(struct reader *in, struct writer *out, const char **why);
uint8_t ask_blend(struct reader *in, struct writer *out, const char **why);
uint8_t ask_progress(struct reader *in, struct writer *out, const char **why);
void trial_rest(void);
void trial_back(uint8_t why, double value, double limit);
void trial_fault(void);
void trial_ended(void);
double trial_step(double error, double input, double own); /* the loop's z from that of its own controller */

/* run.c */
uint8_t ask_begin(struct reader *in, struct writer *out, const char **why);
uint8_t ask_rows(struct reader *in, struct writer *out, const char **why);
uint8_t ask_go(struct reader *in, struct writer *out, const char **why);
uint8_t ask_again(struct reader *in, struct writer *out, const char **why);
void run_forget(void);
void run_start(void);
int run_row(void);    /* this tick's row into r and n; 0 where it is missing */
void run_sample(void);
void run_end(uint8_t reason, uint8_t index, double value, double limit, const char *sentence);

/* stream.c: what comes unasked */
void stream_acknowledge(uint32_t run, uint32_t received);
int stream_poll(void);
int send_body(uint8_t *body, size_t count);
struct writer body_of(uint8_t *data, uint8_t type, uint16_t tag);

/* loops.c */
double biquad(const double *c, double *s, double value);
void loops_arm(void);
void loops_rest(void);
void loops_start_here(double ramp_s);
uint8_t loops_move(double ramp_s, const double *to);
void loops_fault(uint8_t reason, uint8_t index, double value, double limit, const char *sentence);
void loops_vent(uint8_t state);
int loops_watched(void); /* whether the watchdog waits for a request */
void loops_unheard(double passed_ms);

/* The limit that a sensor or command passes now, or NOBODY. */
uint8_t sensor_outside(void);
int all_finite(const double *values, size_t count);

#endif

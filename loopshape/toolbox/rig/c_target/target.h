/* The reference target of the protocol (docs/protocol.md) in portable C99: sizes and entry points. */
#ifndef LOOPSHAPE_TARGET_H
#define LOOPSHAPE_TARGET_H

#include <stddef.h>
#include <stdint.h>

struct frame_decoder;

/* ---- sizes: a port sets its own on the compiler's command line ---- */
#ifndef TARGET_LOOPS
#define TARGET_LOOPS 4
#endif
#ifndef TARGET_SENSORS
#define TARGET_SENSORS 8
#endif
#ifndef TARGET_COMMANDS
#define TARGET_COMMANDS 8
#endif
#ifndef TARGET_SECTIONS
#define TARGET_SECTIONS 12 /* biquads a loop */
#endif
#ifndef TARGET_POOL
#define TARGET_POOL 1024 /* numbers that schedules and blocks hold, 0: neither. Knots, and six a section and node; of a block: */
#endif                   /* its terms and delay, 7 a section, and 1 */
#ifndef TARGET_BLOCKS
#define TARGET_BLOCKS 16
#endif
#ifndef TARGET_TERMS
#define TARGET_TERMS 12 /* of a block */
#endif
#ifndef TARGET_ROWS
#define TARGET_ROWS 1024 /* rows of excitation that wait */
#endif
#ifndef TARGET_TICKS
#define TARGET_TICKS 2048 /* ticks of samples that are kept */
#endif
#ifndef TARGET_NUMBER_BYTES
#define TARGET_NUMBER_BYTES 8 /* numbers on the line: 4 or 8 bytes */
#endif
#ifndef TARGET_BYTES
#define TARGET_BYTES 256 /* bytes served between two looks at the timer */
#endif
#ifndef TARGET_SAMPLE_BYTES
#define TARGET_SAMPLE_BYTES 1000 /* payload of a frame of samples, at most: while one is made no tick begins */
#endif
#define TARGET_VERSION "1.3"

/* At power-up: idle, the machine safe, nothing configured. */
void target_init(void);

/* A byte from the host. */
void target_receive(uint8_t byte);

/* A tick of the board's rate. */
void target_tick(void);

/* Whether a board that runs as fast as it can has to wait with the next tick: for rows, or until the host has followed. */
int target_waits(void);

/* Now and then: sends what is due. Gives whether a frame was sent (then call again). `now_ms` may wrap. */
int target_poll(uint32_t now_ms);

/* Idle, armed, running, fault (0 to 3). */
int target_state(void);

/* The host went and another came (a new TCP connection): forgets half a frame and the last answer, nothing else. */
void target_new_line(void);

/* Whether the host has said nothing for so long that another one may take its place. */
int target_host_idle(void);

/*
 * A byte of a host that waits for its place (a further TCP connection; `late`: for long). Its VENT is done. Gives the length of
 * what it is answered, in `out` (a frame's room), or 0.
 */
size_t target_overhear(struct frame_decoder *decoder, uint8_t byte, int late, uint8_t *out);

#endif

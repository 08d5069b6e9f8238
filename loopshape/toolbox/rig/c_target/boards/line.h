/* A line for emulated boards: a pseudo-terminal or a TCP socket on 127.0.0.1, and a bad line on purpose. POSIX. */
#ifndef LOOPSHAPE_LINE_H
#define LOOPSHAPE_LINE_H

#include <stddef.h>
#include <stdint.h>

struct line_faults {
    double drop, corrupt, duplicate; /* probability a frame, in each direction */
    uint64_t seed;
};

/* Give the name to connect to; -1 with errno set where it cannot be. */
int line_open_terminal(char *name, size_t room);
int line_open_tcp(uint16_t port, char *name, size_t room);

void line_set_faults(struct line_faults faults);
void line_mute(void);

/* Wait up to `ms` for bytes or a host; watches standard input too if asked. Gives 0 once that has ended. */
int line_wait(int ms, int until_eof);

/* Bytes that came, bad frames among them; `fresh` says that they are the first of a new connection. */
size_t line_receive(uint8_t *bytes, size_t room, int *fresh);

/* Hosts that wait for their place: up to so many; a further one replaces the one that has waited longest. */
#define LINE_WAITING 4

/* The place goes to the host that has waited longest where it is free, or given up (`idle`); others do not wait for ever. */
void line_give_place(int idle);

/* Bytes of the k-th host that waits; `fresh` says that they are its first. */
size_t line_overhear(int k, uint8_t *bytes, size_t room, int *fresh);
int line_waited_ms(int k);
void line_answer(int k, const uint8_t *frame, size_t count);

size_t line_space(void);
void line_send(const uint8_t *frame, size_t count);
void line_flush(void);

#endif

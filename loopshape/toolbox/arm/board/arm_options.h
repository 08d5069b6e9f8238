/* What the emulated arm is told: its command line, and the plant's file that Python wrote (plants/arm/emulated.py). */
#ifndef LOOPSHAPE_ARM_OPTIONS_H
#define LOOPSHAPE_ARM_OPTIONS_H

#include "arm1_model.h"
#include "line.h"

struct options {
    const char *plant;
    int tcp, real_time, until_eof;
    uint16_t port;
    uint64_t die_after, mute_after; /* ticks of recordings; 0: never */
    struct line_faults faults;
    double rate_hz, pwm_hz, dead_zone, start_rad, start_bar;
    struct arm arm; /* its constants */
};

/* Everything that was said, or the process ends with a sentence. */
struct options read_options(int count, char **words);

void stop_with(const char *what, const char *received);

#endif

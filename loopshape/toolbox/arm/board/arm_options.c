/* Command line and plant's file of the emulated arm: see arm_options.h. */
#include "arm_options.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

void stop_with(const char *what, const char *received)
{
    fprintf(stderr, "arm_emulator: %s: %s\n", what, received);
    exit(2);
}

static void read_numbers(char *text, double *out, int count, const char *key)
{
    char *end = text;
    for (int k = 0; k < count; k++) {
        out[k] = strtod(text, &end);
        if (end == text)
            stop_with("a number is missing in the plant's file", key);
        text = end;
    }
    if (end[strspn(end, " \r\n")] != '\0')
        stop_with("too many numbers in the plant's file", key);
}

/* A line's key and its numbers; gives the key's place. */
static unsigned read_line(struct options *o, char *text, double *start)
{
    const struct {
        const char *key;
        double *out;
        int count;
    } known[] = {
        {"rate_hz", &o->rate_hz, 1}, {"pwm_hz", &o->pwm_hz, 1}, {"dead_zone", &o->dead_zone, 1},
        {"start", start, 2}, {"constants", o->arm.c, CONSTANTS}, {"sensors", o->arm.sensor, SENSOR_CONSTANTS},
    };
    const size_t length = strcspn(text, " ");

    for (unsigned k = 0; k < sizeof known / sizeof known[0]; k++)
        if (strlen(known[k].key) == length && strncmp(text, known[k].key, length) == 0) {
            read_numbers(text + length, known[k].out, known[k].count, known[k].key);
            return k;
        }
    stop_with("an unknown word in the plant's file", text);
    return 0;
}

static void read_plant(struct options *o)
{
    double start[2] = {0.0, 0.0};
    unsigned seen = 0;
    char text[8192];
    FILE *file = strcmp(o->plant, "-") ? fopen(o->plant, "r") : stdin;

    if (!file || !fgets(text, sizeof text, file) || strcmp(text, "loopshape-plant 1\n") != 0)
        stop_with("no plant's file", o->plant);
    while (fgets(text, sizeof text, file) && strcmp(text, "end\n") != 0)
        seen |= 1u << read_line(o, text, start);
    if (file != stdin)
        fclose(file);
    if (seen != 63)
        stop_with("a word is missing in the plant's file", o->plant);
    o->start_rad = start[0];
    o->start_bar = start[1];
    o->arm.noise = UINT64_C(1) << 32 | 1; /* until a recording says another */
}

static double number_of(const char *option, const char *text, double high)
{
    char *end = NULL;
    const double value = text ? strtod(text, &end) : 0.0;
    if (!text || end == text || *end != '\0' || !(value >= 0.0 && value <= high))
        stop_with("a number in its range comes after", option);
    return value;
}

/* PORT or 127.0.0.1:PORT; any other address is refused. */
static uint16_t port_of(const char *text)
{
    const char *colon = text ? strrchr(text, ':') : NULL;
    if (colon && strncmp(text, "127.0.0.1:", 10) != 0)
        stop_with("the emulator listens on 127.0.0.1 alone, not on", text);
    return (uint16_t)number_of("--tcp", colon ? colon + 1 : text, 65535.0);
}

/* One option that has a value; 0 where it is none of them. */
static int read_value(struct options *o, const char *word, const char *value)
{
    const struct {
        const char *word;
        double *share;
        uint64_t *count;
    } numbers[] = {
        {"--drop", &o->faults.drop, NULL}, {"--corrupt", &o->faults.corrupt, NULL},
        {"--duplicate", &o->faults.duplicate, NULL}, {"--seed", NULL, &o->faults.seed},
        {"--die-after", NULL, &o->die_after}, {"--mute-after", NULL, &o->mute_after},
    };

    for (size_t k = 0; k < sizeof numbers / sizeof numbers[0]; k++)
        if (strcmp(word, numbers[k].word) == 0) {
            if (numbers[k].share)
                *numbers[k].share = number_of(word, value, 1.0);
            else
                *numbers[k].count = (uint64_t)number_of(word, value, 4294967295.0);
            return 1;
        }
    if (strcmp(word, "--plant") == 0) {
        o->plant = value;
        return 1;
    }
    if (strcmp(word, "--tcp") == 0) {
        o->tcp = 1;
        o->port = port_of(value);
        return 1;
    }
    return 0;
}

struct options read_options(int count, char **words)
{
    struct options o;

    memset(&o, 0, sizeof o);
    for (int k = 1; k < count; k++) {
        if (strcmp(words[k], "--real-time") == 0)
            o.real_time = 1;
        else if (strcmp(words[k], "--until-eof") == 0)
            o.until_eof = 1;
        else if (read_value(&o, words[k], k + 1 < count ? words[k + 1] : NULL))
            k++;
        else
            stop_with("an unknown option", words[k]);
    }
    if (!o.plant)
        stop_with("a plant's file is needed", "--plant FILE");
    read_plant(&o);
    return o;
}

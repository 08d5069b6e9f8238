/*
 * The smallest board: its sensors and its ticks come as lines of text, what it is told goes out as lines. It serves the tests,
 * and shows what a port has to write. No clock: the same lines give the same answers.
 *
 *     scripted [real|fast] PWM_HZ DEAD_ZONE     lines in: s NUMBERS (sensors), b HEX (bytes), t N (ticks), p MS (poll),
 *                                               x SENTENCE (the machine's trouble; - is none), n (another host came), . (answers with .)
 *                                               lines out: f HEX (a frame), g NUMBERS (pulses), safe, enable, noise N
 *     scripted decode                           bytes in; lines out: type, tag, length and CRC of each frame; bad N
 */
#include "board.h"
#include "frames.h"
#include "target.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char *const COLUMNS[] = {"theta2_rad", "p_a_bar", "p_b_bar", "u_a_v", "u_b_v"};
static const double RANGES[][2] = {{-1e6, 1e6}, {-1e6, 1e6}, {-1e6, 1e6}, {-1e6, 1e6}, {-1e6, 1e6}};
static struct board_info info = {"scripted", TARGET_VERSION, 3, 2, COLUMNS, RANGES, 1000.0, 50.0, 0.01, 0};
static double sensors[3];
static char trouble[64];

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
    printf("g %.17g %.17g\n", commands[0], commands[1]);
}

void board_enable(void)
{
    puts("enable");
}

void board_safe(void)
{
    puts("safe");
}

size_t board_space(void)
{
    return FRAME_ENCODED;
}

void board_send(const uint8_t *bytes, size_t count)
{
    fputs("f ", stdout);
    for (size_t k = 0; k < count; k++)
        printf("%02x", bytes[k]);
    putchar('\n');
}

const char *board_trouble(int recording)
{
    (void)recording;
    return trouble[0] ? trouble : NULL;
}

int board_place(const double *outputs, uint8_t loops, const double *references, int now)
{
    (void)outputs, (void)loops, (void)references, (void)now;
    return 0;
}

/* Not to be foreseen is what a script has to do without. */
uint64_t board_fresh(void)
{
    static uint64_t given;
    return ++given * UINT64_C(0x9e3779b97f4a7c15);
}

void board_noise(uint64_t state)
{
    printf("noise %llu\n", (unsigned long long)state);
}

static void decode(void)
{
    static struct frame_decoder decoder;
    for (int byte; (byte = getchar()) != EOF;) {
        const size_t count = frame_receive(&decoder, (uint8_t)byte);
        const uint8_t *held = decoder.held;
        if (count > 0)
            printf("%u %u %u %lu\n", held[0], held[1] | (unsigned)held[2] << 8, (unsigned)(count - FRAME_HEAD),
                   (unsigned long)crc32_of(0, held, count));
    }
    printf("bad %lu\n", (unsigned long)decoder.bad);
}

static void bytes(const char *text)
{
    unsigned byte;
    for (; sscanf(text, "%2x", &byte) == 1; text += 2)
        target_receive((uint8_t)byte);
}

static void follow(char *line)
{
    char *text = line + 2;
    line[strcspn(line, "\n")] = '\0';
    if (line[0] == 's')
        for (int k = 0; k < 3; k++)
            sensors[k] = strtod(text, &text);
    else if (line[0] == 'b')
        bytes(text);
    else if (line[0] == 't')
        for (long n = strtol(text, NULL, 10); n > 0; n--)
            target_tick();
    else if (line[0] == 'p')
        while (target_poll((uint32_t)strtoul(text, NULL, 10)))
            ;
    else if (line[0] == 'x')
        strncpy(trouble, strcmp(text, "-") ? text : "", sizeof trouble - 1);
    else if (line[0] == 'n')
        target_new_line();
    else
        puts(".");
}

int main(int count, char **words)
{
    static char line[8192];

    if (count == 2 && strcmp(words[1], "decode") == 0) {
        decode();
        return 0;
    }
    if (count == 4) {
        info.flags = strcmp(words[1], "fast") ? 0 : BOARD_FAST;
        info.pwm_hz = strtod(words[2], NULL);
        info.dead_zone = strtod(words[3], NULL);
    }
    target_init();
    while (fgets(line, sizeof line, stdin)) {
        follow(line);
        if (line[0] == '.')
            fflush(stdout);
    }
    return 0;
}

/*
 * The main loop that board.h advises, taken from its text (MAIN_LOOP), on a machine of virtual time: the timer ticks each ms, a
 * byte takes 10 us, and the line never falls silent. Prints after how many ms without a request the machine was safe.
 */
#include "board.h"
#include "frames.h"
#include "target.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define BYTE_US 10u
#define GIVEN_UP_US 20000000u

static const char *const COLUMNS[] = {"angle_rad", "drive_v"};
static const double RANGES[][2] = {{-4.0, 4.0}, {-10.0, 10.0}};
static const struct board_info info = {"flooded", TARGET_VERSION, 1, 1, COLUMNS, RANGES, 1000.0, 0.0, 0.0, 0};
static uint8_t script[4096];
static size_t length, at;
static uint32_t now_us, armed_us, due, done;
static int enabled, kind;

const struct board_info *board_info(void)
{
    return &info;
}

void board_read(double *sensors)
{
    sensors[0] = 0.0;
}

void board_give(const double *commands)
{
    (void)commands;
}

void board_enable(void)
{
    enabled = 1;
    armed_us = now_us;
}

void board_safe(void)
{
    if (!enabled)
        return;
    printf("%.3f\n", 1e-3 * (double)(now_us - armed_us));
    exit(0);
}

size_t board_space(void)
{
    return FRAME_ENCODED;
}

void board_send(const uint8_t *bytes, size_t count)
{
    (void)bytes, (void)count;
}

const char *board_trouble(int recording)
{
    (void)recording;
    return NULL;
}

int board_place(const double *outputs, uint8_t loops, const double *references, int now)
{
    (void)outputs, (void)loops, (void)references, (void)now;
    return 0;
}

uint64_t board_fresh(void)
{
    return 1; /* what the script repeats */
}

void board_noise(uint64_t state)
{
    (void)state;
}

static void hardware_init(void)
{
    length = fread(script, 1, sizeof script, stdin);
}

static uint32_t ms(void)
{
    return now_us / 1000u;
}

/* The script, then garbage without an end: without zeros, of zeros, or of short bad frames. */
static int uart_get(void)
{
    now_us += BYTE_US;
    due = now_us / 1000u;
    if (now_us > GIVEN_UP_US) {
        puts("never");
        exit(0);
    }
    if (at < length)
        return script[at++];
    return kind == 0 ? 7 : kind == 1 ? 0 : (int)(now_us / BYTE_US % 2u);
}

int main(int count, char **words)
{
    kind = count > 1 ? atoi(words[1]) : 0;
    MAIN_LOOP
}

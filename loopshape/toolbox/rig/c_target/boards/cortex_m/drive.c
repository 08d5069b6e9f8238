/*
 * A motor axis on the chip's own pins, to be changed for the machine at hand: an encoder on PB4 and PB5 (TIM3), a current asked
 * from the drive as a voltage on PA4 (DAC, its middle is 0 A), and PB0 that enables the drive, with a resistor to ground.
 *
 * Compiled by a test, run on no machine.
 */
#include "chip.h"
#include "../../board.h"
#include "../../target.h"

#define COUNTS 8192.0 /* of a turn, all edges */
#define CURRENT 10.0  /* A at either end of the DAC */
#define ANGLE 25.0    /* rad: 32768 counts either way, which the counter holds */
#define PI 3.14159265358979323846

#define TIM3_CR1 REG(0x40000400)
#define TIM3_SMCR REG(0x40000408)
#define TIM3_CCMR1 REG(0x40000418)
#define TIM3_CNT REG(0x40000424)
#define TIM3_ARR REG(0x4000042C)
#define DAC_CR REG(0x40007400)
#define DAC_DHR12R1 REG(0x40007408)

static const char *const COLUMNS[] = {"theta_m_rad", "u_current_a"};
static const double RANGES[][2] = {{-ANGLE, ANGLE}, {-CURRENT, CURRENT}};
static const struct board_info INFO = {"STM32F4, drive", TARGET_VERSION, 1, 1, COLUMNS, RANGES, RATE_HZ, 0.0, 0.0, 0};

const struct board_info *board_info(void)
{
    return &INFO;
}

/* 0 rad is where it stood at power-up. */
void board_read(double *sensors)
{
    sensors[0] = (double)(int16_t)TIM3_CNT * (2.0 * PI / COUNTS);
}

void board_give(const double *commands)
{
    const double code = 2048.0 + commands[0] * (2047.0 / CURRENT);
    DAC_DHR12R1 = code < 0.0 ? 0u : code > 4095.0 ? 4095u : (uint32_t)(code + 0.5);
}

void board_enable(void)
{
    DAC_DHR12R1 = 2048;
    BSRR(GPIOB) = 1u << 0;
    watched.latest = 0;
}

void board_safe(void)
{
    BSRR(GPIOB) = 1u << 16;
    DAC_DHR12R1 = 2048;
}

int board_place(const double *outputs, uint8_t loops, const double *references, int now)
{
    (void)outputs, (void)loops, (void)references, (void)now;
    return 0;
}

void board_noise(uint64_t state)
{
    (void)state;
}

void machine_init(void)
{
    RCC_AHB1ENR |= 3u;
    RCC_APB1ENR |= 1u << 1 | 1u << 29;
    board_safe();
    DAC_CR = 1;
    MODER(GPIOA) |= 3u << 8;                                   /* PA4 analogue */
    AFRL(GPIOB) = (AFRL(GPIOB) & ~0xFF0000u) | 0x220000u;      /* PB4, PB5: TIM3 */
    PUPDR(GPIOB) = (PUPDR(GPIOB) & ~0xF00u) | 0x500u;          /* pulled up: encoders with open collectors */
    MODER(GPIOB) = (MODER(GPIOB) & ~0xF03u) | 0xA01u;          /* and PB0 an output */
    TIM3_CCMR1 = 1u | 1u << 8 | 3u << 4 | 3u << 12;            /* both inputs, filtered over 8 samples */
    TIM3_SMCR = 3;                                             /* count every edge */
    TIM3_ARR = 0xFFFF;
    TIM3_CR1 = 1;
}

void machine_tick(void)
{
}

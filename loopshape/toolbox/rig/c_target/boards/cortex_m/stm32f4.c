/*
 * The target on an STM32F405, F407 or F446: 168 MHz, USART2 on PA2 (out) and PA3 (in), SysTick as the ticks' timer, the
 * independent watchdog, and the main loop of board.h. The machine is axis.c or drive.c.
 */
#include "chip.h"
#include "../../board.h"
#include "../../frames.h"
#include "../../target.h"

#define TICK_CYCLES (HCLK_HZ / RATE_HZ)
#define LATE_TICKS (RATE_HZ / 50u) /* 20 ms behind the timer */
#define RECEIVED 4096u             /* powers of two */
#define SENT 4096u
#define LONGEST (FRAME_ENCODED + 1u)

#if RATE_HZ < 1000 || RATE_HZ > 5000 || HCLK_HZ % RATE_HZ != 0
#error "RATE_HZ lies between 1000 and 5000 and divides 168 MHz"
#endif

#define BIT_CYCLES ((APB1_HZ + BAUD / 2u) / BAUD)
#if BIT_CYCLES < 16 || BIT_CYCLES * BAUD > APB1_HZ / 200u * 203u || BIT_CYCLES * BAUD < APB1_HZ / 200u * 197u
#error "42 MHz divided by a whole number comes no nearer to BAUD than 1.5 %, or BAUD lies beyond 2.6 MHz"
#endif

static volatile uint8_t received[RECEIVED], to_send[SENT];
static volatile uint32_t received_in, received_out, sent_in, sent_out; /* counted up; places modulo the size */
static volatile uint32_t due, now_ms;
static uint32_t done;
static volatile uint64_t unforeseen; /* stirred by when each byte came */

struct watched watched;

/* ---- power-up ---- */

static int ready(uint32_t bit)
{
    for (uint32_t tries = 0; tries < 1000000u; tries++)
        if (RCC_CR & bit)
            return 1;
    return 0;
}

/* 168 MHz from 8 MHz: a crystal, or another chip's clock (`BYPASS`). An emulator has no clocks: HSIRDY is 0 nowhere else. */
static void clock_init(void)
{
    const uint32_t hsi_ready = 1u << 1, hse = 1u << 16, hse_ready = 1u << 17, bypass = 1u << 18;
    const uint32_t pll = 1u << 24, pll_ready = 1u << 25;

    if (!(RCC_CR & hsi_ready))
        return;
    RCC_CR |= BYPASS ? bypass : 0u;
    RCC_CR |= hse;
    if (!ready(hse_ready))
        for (;;)
            ; /* without its clock no tick has its length: better no target */
    FLASH_ACR = 5u | 7u << 8;                         /* wait states at 168 MHz; prefetch and caches */
    RCC_CFGR = 5u << 10 | 4u << 13;                   /* APB1 42 MHz, APB2 84 MHz */
    RCC_PLLCFGR = 8u | 336u << 6 | 1u << 22 | 7u << 24 | 2u << 28; /* 8 MHz / 8 * 336 / 2 */
    RCC_CR |= pll;
    if (!ready(pll_ready))
        for (;;)
            ;
    RCC_CFGR |= 2u;
    while ((RCC_CFGR >> 2 & 3u) != 2u)
        ;
}

static void usart_init(void)
{
    RCC_AHB1ENR |= 1u << 0;
    RCC_APB1ENR |= 1u << 17;
    AFRL(GPIOA) = (AFRL(GPIOA) & ~0xFF00u) | 0x7700u;
    MODER(GPIOA) = (MODER(GPIOA) & ~0xF0u) | 0xA0u;
    PUPDR(GPIOA) = (PUPDR(GPIOA) & ~0xC0u) | 0x40u; /* without a cable the line rests */
    USART2_BRR = BIT_CYCLES;
    USART2_CR1 = 1u << 13 | 1u << 5 | 1u << 3 | 1u << 2; /* on, interrupts where a byte has come, both ways */
    NVIC_IPR(USART2_IRQ) = 0x10; /* behind the timer */
    NVIC_ISER(USART2_IRQ / 32u) = 1u << USART2_IRQ % 32u;
}

static void timer_init(void)
{
    SYST_RVR = TICK_CYCLES - 1u;
    SYST_CVR = 0;
    SYST_CSR = 7; /* the core's clock, interrupt, on */
}

/* Resets the chip where no tick is served for 100 ms (LSI at 32 kHz, by 8). */
static void watchdog_init(void)
{
    IWDG_KR = 0xCCCC;
    IWDG_KR = 0x5555;
    IWDG_PR = 1;
    IWDG_RLR = 400;
}

static void hardware_init(void)
{
    machine_init();
    clock_init();
    usart_init();
    timer_init();
    watchdog_init();
}

/* ---- interrupts ---- */

void tick_handler(void)
{
    static uint32_t thousands;

    due++;
    for (thousands += 1000u; thousands >= RATE_HZ; thousands -= RATE_HZ)
        now_ms++;
}

void usart2_handler(void)
{
    const uint32_t overrun = 1u << 3, full = 1u << 5, empty = 1u << 7;

    for (uint32_t status; (status = USART2_SR) & (full | overrun);) {
        const uint8_t byte = (uint8_t)USART2_DR; /* which ends an overrun too */
        unforeseen = (unforeseen ^ SYST_CVR) * UINT64_C(0x9e3779b97f4a7c15) + byte;
        if (status & full && received_in - received_out < RECEIVED) /* a byte that is lost shows in its frame's CRC */
            received[received_in++ % RECEIVED] = byte;
    }
    while (sent_out != sent_in && USART2_SR & empty)
        USART2_DR = to_send[sent_out++ % SENT];
    if (sent_out == sent_in)
        USART2_CR1 &= ~(1u << 7);
}

/* ---- the board ---- */

size_t board_space(void)
{
    return SENT - (sent_in - sent_out) > LONGEST ? SENT - (sent_in - sent_out) - 1u : 0u;
}

void board_send(const uint8_t *bytes, size_t count)
{
    for (size_t k = 0; k < count; k++)
        to_send[(sent_in + k) % SENT] = bytes[k];
    sent_in += count;
    USART2_CR1 |= 1u << 7; /* an interrupt for each byte that may go, */
    NVIC_ISPR(USART2_IRQ / 32u) = 1u << USART2_IRQ % 32u; /* the first at once */
}

const char *board_trouble(int recording)
{
    (void)recording;
    return due - done > LATE_TICKS ? "ticks take longer than their time: a lower rate or fewer sections" : NULL;
}

/* From what power-up left in memory, and when each byte came, to 6 ns. A chip with a generator of random numbers adds it. */
uint64_t board_fresh(void)
{
    static uint64_t state, number;

    state = mixed(mixed(state ^ power_up, unforeseen), ++number);
    return state ? state : 1u;
}

/* ---- the program ---- */

static int uart_get(void)
{
    if (received_out == received_in)
        return -1;
    return received[received_out++ % RECEIVED];
}

/* Cycles since power-up, modulo 2^32. */
static uint32_t cycles(void)
{
    uint32_t ticks, within;
    do {
        ticks = due;
        within = TICK_CYCLES - 1u - SYST_CVR;
    } while (ticks != due);
    return ticks * TICK_CYCLES + within;
}

static void tick(void)
{
    const uint32_t begun = cycles(), late = begun - (done + 1u) * TICK_CYCLES;

    target_tick();
    const uint32_t took = cycles() - begun;
    watched.longest = took > watched.longest ? took : watched.longest;
    watched.latest = late > watched.latest ? late : watched.latest;
    watched.ticks++;
    machine_tick();
    IWDG_KR = 0xAAAA;
}

/* Until an interrupt, where there is nothing to do: one that comes between looking and sleeping wakes it too. */
static void rest(void)
{
    __asm volatile("cpsid i" ::: "memory");
    if (done == due && received_out == received_in)
        __asm volatile("wfi");
    __asm volatile("cpsie i" ::: "memory");
}

int main(void)
{
    hardware_init();
    target_init();
    for (done = due;;) {
        for (; done != due; done++)
            tick();
        for (int n = 0, c; n < TARGET_BYTES && (c = uart_get()) >= 0; n++)
            target_receive((uint8_t)c);
        if (!target_poll(now_ms))
            rest();
    }
}

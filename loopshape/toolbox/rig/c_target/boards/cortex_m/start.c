/* Power-up of a Cortex-M4F: vectors, memory, FPU; and what a fault does. */
#include "chip.h"
#include "../../board.h"

#include <string.h>

extern uint32_t stack_begin[], stack_end[], data_load[], data_begin[], data_end[], bss_begin[], bss_end[];
uint64_t power_up;
void reset(void);

/* One round of SplitMix64 (Steele, Lea and Flood 2014). */
uint64_t mixed(uint64_t state, uint64_t value)
{
    uint64_t z = (state ^ value) + UINT64_C(0x9e3779b97f4a7c15);
    z = (z ^ z >> 30) * UINT64_C(0xbf58476d1ce4e5b9);
    z = (z ^ z >> 27) * UINT64_C(0x94d049bb133111eb);
    return z ^ z >> 31;
}

void reset(void)
{
    uint64_t found = 0;

    SCB_CPACR |= 0xFu << 20; /* the FPU, before anything may use it */
    __asm volatile("dsb\n isb");
    for (const uint32_t *word = stack_begin; word < stack_end; word += 2)
        found = mixed(found, (uint64_t)word[0] << 32 | word[1]);
    memcpy(data_begin, data_load, (size_t)((char *)data_end - (char *)data_begin));
    memset(bss_begin, 0, (size_t)((char *)bss_end - (char *)bss_begin));
    power_up = found;
    (void)main();
}

/* A fault, or an interrupt that nobody asked for: the machine safe, then a start from the beginning. */
static void fault(void)
{
    board_safe();
    SCB_AIRCR = 0x05FA0004u;
    for (;;)
        ;
}

typedef void (*handler)(void);

__attribute__((section(".vectors"), used)) static const handler VECTORS[16 + USART2_IRQ + 1] = {
    (handler)(uintptr_t)stack_end, reset, fault, fault, fault, fault, fault, 0, 0, 0, 0, fault, fault, 0, fault,
    tick_handler,
    [16 ... 15 + USART2_IRQ] = fault,
    [16 + USART2_IRQ] = usart2_handler,
};

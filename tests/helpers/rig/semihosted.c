/* Start of a test's program on an emulated Cortex-M4: FPU, memory, semihosting for its words (WORDS) and what it prints. */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

extern char stack_top[], data_load[], data_begin[], data_end[], bss_begin[], bss_end[];
extern void initialise_monitor_handles(void);
extern int main(int count, char **words);
void reset(void);
void _fini(void);

void _fini(void)
{
}

void reset(void)
{
    static char *words[] = {WORDS, NULL};

    *(volatile uint32_t *)0xE000ED88 |= 0xFu << 20;
    __asm volatile("dsb\n isb");
    memcpy(data_begin, data_load, (size_t)(data_end - data_begin));
    memset(bss_begin, 0, (size_t)(bss_end - bss_begin));
    initialise_monitor_handles();
    exit(main((int)(sizeof words / sizeof words[0]) - 1, words));
}

static void fault(void)
{
    abort();
}

__attribute__((section(".vectors"), used)) static void (*const VECTORS[16])(void) = {
    (void (*)(void))(uintptr_t)stack_top, reset, fault, fault, fault, fault, fault, fault,
    fault, fault, fault, fault, fault, fault, fault, fault,
};

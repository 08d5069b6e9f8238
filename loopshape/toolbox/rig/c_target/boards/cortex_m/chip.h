/* Registers of the STM32F405, F407 and F446 that this port uses (reference manuals RM0090 and RM0390), and its parts. */
#ifndef LOOPSHAPE_CHIP_H
#define LOOPSHAPE_CHIP_H

#include <stdint.h>

#define REG(address) (*(volatile uint32_t *)(address))

#define RCC_CR REG(0x40023800)
#define RCC_PLLCFGR REG(0x40023804)
#define RCC_CFGR REG(0x40023808)
#define RCC_AHB1ENR REG(0x40023830) /* GPIOA 0, GPIOB 1 */
#define RCC_APB1ENR REG(0x40023840) /* TIM3 1, USART2 17, DAC 29 */
#define FLASH_ACR REG(0x40023C00)
#define IWDG_KR REG(0x40003000)
#define IWDG_PR REG(0x40003004)
#define IWDG_RLR REG(0x40003008)

#define GPIOA 0x40020000u
#define GPIOB 0x40020400u
#define MODER(port) REG((port) + 0x00u)
#define PUPDR(port) REG((port) + 0x0Cu)
#define BSRR(port) REG((port) + 0x18u)
#define AFRL(port) REG((port) + 0x20u)

#define USART2_SR REG(0x40004400)
#define USART2_DR REG(0x40004404)
#define USART2_BRR REG(0x40004408)
#define USART2_CR1 REG(0x4000440C)
#define USART2_IRQ 38u

#define SYST_CSR REG(0xE000E010)
#define SYST_RVR REG(0xE000E014)
#define SYST_CVR REG(0xE000E018)
#define NVIC_ISER(k) REG(0xE000E100u + 4u * (k))
#define NVIC_ISPR(k) REG(0xE000E200u + 4u * (k))
#define NVIC_IPR(k) (*(volatile uint8_t *)(0xE000E400u + (k)))
#define SCB_AIRCR REG(0xE000ED0C)
#define SCB_CPACR REG(0xE000ED88)

#define HCLK_HZ 168000000u
#define APB1_HZ (HCLK_HZ / 4u)

/* start.c: what the power-up left in the stack's memory, mixed; no two starts leave the same. */
extern uint64_t power_up;
uint64_t mixed(uint64_t state, uint64_t value);

/*
 * stm32f4.c. For a debugger, or a test: ticks done; of a simulated machine, when it was made safe last; cycles of the longest
 * tick, and of the longest way from the timer to its tick since the machine was armed.
 */
extern struct watched {
    uint32_t ticks, safe_at, longest, latest;
} watched;
void tick_handler(void);
void usart2_handler(void);
int main(void);

/* The machine: axis.c or drive.c, with the functions of board.h that read sensors and give commands. */
void machine_init(void); /* safe before all else */
void machine_tick(void); /* behind each tick: a simulated machine moves */

#endif

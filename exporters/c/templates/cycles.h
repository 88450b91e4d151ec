/* {{ mark }}
 *
 * The cycle counter of a core: DWT of ARMv7-M and ARMv8-M Mainline, SysTick of ARMv6-M and ARMv8-M
 * Baseline (24 bits: up to 16.7 million cycles; it takes SysTick from an operating system), mcycle of
 * RISC-V in machine mode. Registers as the architecture manuals of ARM and RISC-V have them.
 */
#ifndef {{ PREFIX }}_CYCLES_H
#define {{ PREFIX }}_CYCLES_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#if defined(__ARM_ARCH_7M__) || defined(__ARM_ARCH_7EM__) || defined(__ARM_ARCH_8M_MAIN__) || \
    defined(__ARM_ARCH_8_1M_MAIN__)
#define CYCLES_DEMCR (*(volatile uint32_t *)0xE000EDFCu)  /* bit 24: trace on */
#define CYCLES_CTRL (*(volatile uint32_t *)0xE0001000u)   /* bit 0: count; bit 25: no counter */
#define CYCLES_CYCCNT (*(volatile uint32_t *)0xE0001004u) /* DWT->CYCCNT */
#define CYCLES_MASK 0xFFFFFFFFu
/* 0, or 1 where the core was made without the counter */
static inline int cycles_start(void)
{
    CYCLES_DEMCR |= 1u << 24;
    if ((CYCLES_CTRL & (1u << 25)) != 0u) {
        return 1;
    }
    CYCLES_CYCCNT = 0u;
    CYCLES_CTRL |= 1u;
    return 0;
}
static inline uint32_t cycles_now(void)
{
    return CYCLES_CYCCNT;
}
#elif defined(__ARM_ARCH_6M__) || defined(__ARM_ARCH_8M_BASE__)
#define CYCLES_SYST ((volatile uint32_t *)0xE000E010u) /* control, reload, current value */
#define CYCLES_MASK 0x00FFFFFFu
static inline int cycles_start(void)
{
    CYCLES_SYST[1] = CYCLES_MASK;
    CYCLES_SYST[2] = 0u;
    CYCLES_SYST[0] = 5u; /* the core's clock, no interrupt */
    return 0;
}
static inline uint32_t cycles_now(void)
{
    return CYCLES_MASK - CYCLES_SYST[2]; /* it counts down */
}
#elif defined(__riscv)
#define CYCLES_MASK 0xFFFFFFFFu
static inline int cycles_start(void)
{
    return 0;
}
static inline uint32_t cycles_now(void)
{
    uint32_t count;
    __asm__ volatile(".option push\n.option arch, +zicsr\ncsrr %0, mcycle\n.option pop" : "=r"(count));
    return count;
}
#else
#error "no cycle counter is known for this core"
#endif

/* Cycles from one moment to a later one, less than a turn of the counter apart. */
static inline uint32_t cycles_between(uint32_t before, uint32_t after)
{
    return (after - before) & CYCLES_MASK;
}

#ifdef __cplusplus
}
#endif

#endif

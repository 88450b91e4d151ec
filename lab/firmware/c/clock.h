/* The clock of a core under qemu's -icount shift=0, where an instruction takes a nanosecond. */
#include <stdint.h>
#include <stdio.h>

#if defined(__arm__)
/* SysTick of the MPS2 board: 25 MHz, and qemu takes an instruction for a nanosecond */
#define SYST ((volatile uint32_t *)0xE000E010u)
#define UNIT 40u
#define MASK 0xFFFFFFu
static void start(void)
{
    SYST[1] = MASK;
    SYST[2] = 0u;
    SYST[0] = 5u;
}
static uint32_t now(void)
{
    return MASK - SYST[2];
}
#else
#define UNIT 1u
#define MASK 0xFFFFFFFFu
static void start(void)
{
}
static uint32_t now(void)
{
    uint32_t count;
    __asm__ volatile(".option push\n.option arch, +zicsr\nrdinstret %0\n.option pop" : "=r"(count));
    return count;
}
#endif

/* Instructions of policy_step on the recorded observations, counted by qemu's -icount shift=0. */
#include "policy.h"
#include "vectors.h"

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

int main(void)
{
    policy_action_t action[POLICY_ACTIONS];
    uint32_t i;
    unsigned long long total = 0u;
    unsigned long worst = 0u;
    start();
    policy_reset();
    for (i = 0u; i < VECTOR_INFERENCES; i++) {
        const uint32_t before = now();
        unsigned long spent;
        (void)policy_step(&vector_observation[i * POLICY_OBSERVATIONS], action);
        spent = (unsigned long)((now() - before) & MASK) * UNIT;
        total += spent;
        worst = (spent > worst) ? spent : worst;
    }
    printf("%lu %lu\n", (unsigned long)(total / VECTOR_INFERENCES), worst);
    return 0;
}

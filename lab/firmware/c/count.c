/* Instructions of policy_step on the recorded observations, counted by qemu's -icount shift=0. */
#include "policy.h"
#include "vectors.h"

#include "clock.h"

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

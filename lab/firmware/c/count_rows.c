/* Instructions of a control step of policy_act_i16 (with FLOATS: of policy_step) on recorded
 * observations, counted by qemu's -icount shift=0: mean, most, and of the network alone.
 *
 * SPIKING: linked with --wrap=policy_net_step, where the network is between encoder and decoder.
 * DENSE: the network is called once more by itself. */
#ifdef FLOATS
#include "policy.h"
#ifndef OBSERVATION
#define OBSERVATION double
#endif
#else
#include "policy_i16.h"
#endif
#include "count_rows.h"

#include "clock.h"

static unsigned long long network;

#ifdef SPIKING
void __real_policy_net_step(uint32_t count);
void __wrap_policy_net_step(uint32_t count);
void __wrap_policy_net_step(uint32_t count)
{
    const uint32_t before = now();
    __real_policy_net_step(count);
    network += (unsigned long)((now() - before) & MASK) * UNIT;
}
#endif

int main(void)
{
#ifdef FLOATS
    policy_action_t action[POLICY_ACTIONS];
    const OBSERVATION *rows = count_observation;
#else
    int16_t action[POLICY_ACTIONS];
    const int16_t *rows = count_observation;
#endif
    uint32_t i;
    unsigned long long total = 0u;
    unsigned long worst = 0u;
    start();
#ifdef FLOATS
    policy_reset();
#else
    policy_reset_i16();
#endif
    for (i = 0u; i < COUNT_ROWS; i++) {
        const uint32_t before = now();
        unsigned long spent;
#ifdef FLOATS
        (void)policy_step(&rows[i * POLICY_OBSERVATIONS], action);
#else
        policy_act_i16(&rows[i * POLICY_OBSERVATIONS], action);
#endif
        spent = (unsigned long)((now() - before) & MASK) * UNIT;
        total += spent;
        worst = (spent > worst) ? spent : worst;
    }
#ifdef DENSE
    for (i = 0u; i < COUNT_ROWS; i++) {
        int32_t score[COUNT_SCORES];
        const uint32_t before = now();
        policy_net_i16(&rows[i * POLICY_OBSERVATIONS], score);
        network += (unsigned long)((now() - before) & MASK) * UNIT;
    }
#endif
    printf("%lu %lu %lu\n", (unsigned long)(total / COUNT_ROWS), worst,
           (unsigned long)(network / COUNT_ROWS));
    return 0;
}

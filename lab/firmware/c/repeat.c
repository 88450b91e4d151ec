/* Control steps one after another, as a loop in C takes them. */
#include "policy.h"

#ifndef OBSERVATION
#define OBSERVATION double
#endif

void repeat(const OBSERVATION *rows, uint32_t count, policy_action_t *action);

void repeat(const OBSERVATION *rows, uint32_t count, policy_action_t *action)
{
    uint32_t i;
    policy_reset();
    for (i = 0u; i < count; i++) {
        (void)policy_step(rows + i * POLICY_OBSERVATIONS, action);
    }
}

/* The least program that has all of the policy: its size is what the policy takes. */
#include "policy.h"

#ifndef OBSERVATION
#define OBSERVATION double
#endif

OBSERVATION least_observation[POLICY_OBSERVATIONS];
policy_action_t least_action[POLICY_ACTIONS];

int main(void)
{
    policy_reset();
    return policy_step(least_observation, least_action);
}

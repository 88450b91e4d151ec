/* The least program that has all of a policy with the 16-bit interface. */
#include "policy_i16.h"

int16_t least_observation[POLICY_OBSERVATIONS];
int16_t least_action[POLICY_ACTIONS];

int main(void)
{
    policy_reset_i16();
    policy_act_i16(least_observation, least_action);
    return least_action[0];
}

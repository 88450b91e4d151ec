/* {{ mark }}
 *
 * Runs recorded observations through the 16-bit interface, and compares every action with what the
 * integer specification in Python computed.
 */
#include "{{ prefix }}_i16.h"
#include "vectors_i16.h"

#include <stdio.h>
#include <stdlib.h>

int main(void)
{
    int16_t action[{{ PREFIX }}_ACTIONS];
    unsigned long differing = 0u;
    uint32_t i;
    uint32_t a;
    {{ prefix }}_reset_i16();
    for (i = 0u; i < VECTOR_STEPS; i++) {
        {{ prefix }}_act_i16(&vector_observation_i16[i * {{ PREFIX }}_OBSERVATIONS], action);
        for (a = 0u; a < {{ PREFIX }}_ACTIONS; a++) {
            const int16_t wanted = vector_action_i16[i * {{ PREFIX }}_ACTIONS + a];
            if ((action[a] != wanted) && (differing++ == 0u)) {
                (void)printf("step %lu: action %lu is %d, and not %d\n", (unsigned long)i,
                             (unsigned long)a, action[a], wanted);
            }
        }
    }
    (void)printf("%lu numbers compared, %lu differ\n",
                 (unsigned long)(VECTOR_STEPS * {{ PREFIX }}_ACTIONS), differing);
    return (differing == 0u) ? EXIT_SUCCESS : EXIT_FAILURE;
}

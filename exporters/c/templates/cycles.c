{% set steps = "VECTOR_STEPS" if int16 else "VECTOR_INFERENCES" %}
/* {{ mark }}
 *
 * An example: cycles of a control step on recorded observations. Build it with the sources of the
 * policy and the start-up code of the board; stop in `done` with a debugger and read `cycles`.
 */
#include "{{ prefix }}{{ "_i16" if int16 }}.h"
#include "cycles.h"
#include "vectors{{ "_i16" if int16 }}.h"

volatile struct {
    uint32_t least;
    uint32_t mean;
    uint32_t most;
    uint32_t steps; /* 0: the core has no counter */
} cycles;

static void done(void)
{
    for (;;) {
        __asm__ volatile("nop");
    }
}

int main(void)
{
    {{ "int16_t" if int16 else prefix ~ "_action_t" }} action[{{ PREFIX }}_ACTIONS];
    uint32_t least = 0xFFFFFFFFu;
    uint32_t most = 0u;
    uint32_t i;
    uint64_t total = 0u;
    if (cycles_start() != 0) {
        done();
    }
    {{ prefix }}_reset{{ "_i16" if int16 }}();
    for (i = 0u; i < {{ steps }}; i++) {
        const uint32_t before = cycles_now();
        uint32_t spent;
{% if int16 %}
        {{ prefix }}_act_i16(&vector_observation_i16[i * {{ PREFIX }}_OBSERVATIONS], action);
{% else %}
        (void){{ prefix }}_step(&vector_observation[i * {{ PREFIX }}_OBSERVATIONS], action);
{% endif %}
        spent = cycles_between(before, cycles_now());
        least = (spent < least) ? spent : least;
        most = (spent > most) ? spent : most;
        total += spent;
    }
    cycles.least = least;
    cycles.mean = (uint32_t)(total / {{ steps }});
    cycles.most = most;
    cycles.steps = {{ steps }};
    done();
    return 0;
}

{% from encoder ~ ".c" import encoder_functions, encoder_reset, seed_function with context %}
{% from "decode.c" import decoder_functions, decoder_reset with context %}
{% set functions = encoder_functions() ~ decoder_functions() %}
{% set late = decoder_reset() | trim("\n") %}
/* {{ mark }}
 * {{ origin }}
 *
 * Observations to input spikes, and what leaves the chip to actions.
 */
#include "{{ prefix }}.h"

#include <float.h>
#include <math.h>
#include <string.h>

#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#endif
#if (FLT_RADIX != 2) || (DBL_MANT_DIG != 53) || (FLT_EVAL_METHOD != 0)
#error "double has to be IEEE 754 binary64, and to be computed as such (on x86: -mfpmath=sse)"
#endif

{{ out.text }}

/* Whether a number is neither infinite nor no number. */
static int is_finite(const double *x)
{
    uint64_t bits;
    (void)memcpy(&bits, x, sizeof bits);
    return ((uint32_t)(bits >> 32) & 0x7FF00000u) != 0x7FF00000u;
}

const uint32_t {{ prefix }}_interface[4] = {1u, {{ PREFIX }}_OBSERVATIONS, {{ PREFIX }}_ACTIONS, {{ choices }}u};

{{ functions }}
void {{ prefix }}_reset(void)
{
    {{ prefix }}_net_reset();
{{ encoder_reset() | trim("\n") }}
{{ late }}
}
{{ seed_function() }}
int {{ prefix }}_step(const double observation[{{ PREFIX }}_OBSERVATIONS],
                {{ prefix }}_action_t action[{{ PREFIX }}_ACTIONS])
{
    uint32_t timestep;
    uint32_t i;
    for (i = 0u; i < {{ PREFIX }}_OBSERVATIONS; i++) {
        if (is_finite(&observation[i]) == 0) {
            return {{ PREFIX }}_NOT_FINITE;
        }
    }
{% if plan.program.convention.state == "kept" %}

{% else %}
    {{ prefix }}_net_reset();
{{ late }}
{% endif %}
    encode_begin(observation);
{% if codec.score == "mean" %}
    decode_begin();
{% endif %}
    for (timestep = 0u; timestep < {{ PREFIX }}_TIMESTEPS; timestep++) {
        uint8_t *times;
        {{ id_t }} *id = {{ prefix }}_net_begin(&times);
        const uint32_t count = encode(timestep, id);
        (void)times;
        {{ prefix }}_net_step(count);
{% if codec.score == "last" %}
        decode_begin();
{% endif %}
        decode_add();
#ifdef {{ PREFIX }}_PROBE
        {{ prefix }}_probe(timestep, id, count);
#endif
    }
    decode_end(action);
    return {{ PREFIX }}_OK;
}

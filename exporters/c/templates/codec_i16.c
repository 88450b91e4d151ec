{% from "squash_i16.c" import squash_function with context %}
{% from "decode_i16.c" import decoder_function, decoder_reset with context %}
{% from "encode_i16.c" import encoder_functions with context %}
{% set decoder, encoder = decoder_function(), encoder_functions() %}
{% set squash = squash_function(code.squash, code.fraction) %}
{% set late = decoder_reset() | trim("\n") %}
/* {{ mark }}
 * {{ origin }}
 *
 * Observations and actions as 16-bit integers: no floating point, no 64-bit number. Needs
 * {{ prefix }}.c, and not codec.c; use one of the two interfaces, as both run the same network.
 */
#include "{{ prefix }}_i16.h"

#include "{{ prefix }}.h"

/* shifts of negative numbers to the right have to keep the sign, as all compilers of note do */
typedef char {{ prefix }}_keeps_sign_in_shifts[((-1) >> 1) == -1 ? 1 : -1];

{{ out.text }}

{{ encoder }}
{{ squash ~ decoder }}
void {{ prefix }}_reset_i16(void)
{
    uint32_t k;
    {{ prefix }}_net_reset();
    for (k = 0u; k < {{ code.delta.observed | length }}u; k++) {
        level[k] = 0;
        centre[k] = centre_at_rest[k];
    }
{{ late }}
}

void {{ prefix }}_act_i16(const int16_t observation[{{ PREFIX }}_OBSERVATIONS],
                    int16_t action[{{ PREFIX }}_ACTIONS])
{
{% if codec.timesteps == 1 %}
    uint8_t *times;
    {{ id_t }} *id = {{ prefix }}_net_begin(&times);
    (void)times;
    {{ prefix }}_net_step(encode(observation, id));
    decode(action);
{% else %}
    uint32_t timestep;
    for (timestep = 0u; timestep < {{ PREFIX }}_TIMESTEPS; timestep++) {
        uint8_t *times;
        {{ id_t }} *id = {{ prefix }}_net_begin(&times);
        (void)times;
        {{ prefix }}_net_step(encode(observation, id));
{% if late %}
        decode(action);
    }
{% else %}
    }
    decode(action);
{% endif %}
{% endif %}
}

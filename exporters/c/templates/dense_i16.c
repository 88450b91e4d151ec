{% from "squash_i16.c" import squash_function, squashed with context %}
{% from "dense_layers.c" import lists, pairs, rows, statements with context %}
{% set final = network.layers[-1] %}
{% set squash = "argmax" if choices else final.activation %}
{% set layers %}
{% for fraction in network.hidden_tanh %}
{% print squash_function("tanh", fraction, "hidden_tanh" ~ fraction) %}
{% endfor %}
{% for layer in network.layers %}
static void layer{{ loop.index0 }}(const int16_t *x, {{ "int32_t" if loop.last else "int16_t" }} *y)
{
{% if layer.is_dense %}
{% if layer.pairs is not none %}
#ifdef {{ PREFIX }}_PAIRS
{% print pairs(layer) %}
#else
{% print rows(layer) %}
#endif
{% else %}
{% print rows(layer) %}
{% endif %}
{% else %}
{# a pruned layer #}
{% print statements(layer) if network.weights <= 4096 else lists(loop.index0, layer) %}
{% endif %}
}

{% endfor %}
{% endset %}
{% set tanh = squash_function(squash, final.fraction) %}
/* {{ mark }}
 * {{ origin }}
 *
 * A network of 8-bit weights, 16-bit inputs and 32-bit sums, {{ network.weights }} weights that are not 0. Each
 * constant is a weight times the power of two of its input; the normaliser is in the first layer.
 */
#include "{{ prefix }}_i16.h"

/* two products of 16 bits in one instruction: Cortex-M4, M7, M33 and later */
#if defined(__ARM_FEATURE_SIMD32) && defined(__GNUC__)
#include <arm_acle.h>
#define {{ PREFIX }}_PAIRS 1
static int32_t pair_at(const int16_t *x)
{
    int32_t both;
    __builtin_memcpy(&both, x, sizeof both);
    return both;
}
#endif

/* shifts of negative numbers to the right have to keep the sign, as all compilers of note do */
typedef char {{ prefix }}_shifts_keep_the_sign[((-1) >> 1) == -1 ? 1 : -1];

{{ out.text }}

{{ layers }}
{{ tanh }}
void {{ prefix }}_reset_i16(void)
{
    /* nothing is remembered */
}

void {{ prefix }}_net_i16(const int16_t observation[{{ PREFIX }}_OBSERVATIONS], int32_t score[{{ scores }}])
{
{% for layer in network.layers[:-1] %}
    int16_t hidden{{ loop.index0 }}[{{ layer.bias | length }}];
{% endfor %}
{% for layer in network.layers %}
    layer{{ loop.index0 }}({{ "observation" if loop.first else "hidden" ~ (loop.index0 - 1) }}, {{ "score" if loop.last else "hidden" ~ loop.index0 }});
{% endfor %}
}

void {{ prefix }}_act_i16(const int16_t observation[{{ PREFIX }}_OBSERVATIONS],
                    int16_t action[{{ PREFIX }}_ACTIONS])
{
    int32_t score[{{ scores }}];
    uint32_t a;
{% if choices %}
    uint32_t chosen = 0u;
{% else %}

{% endif %}
    {{ prefix }}_net_i16(observation, score);
    for (a = 0u; a < {{ scores }}u; a++) {
{% if choices %}
        chosen = (score[a] > score[chosen]) ? a : chosen;
    }
    action[0] = (int16_t)chosen;
{% else %}
        action[a] = {{ squashed(squash, "score[a]") }};
    }
{% endif %}
}

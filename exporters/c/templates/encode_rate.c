{% from "normalise.c" import normalise with context %}
{% set encoder, regular = codec.encoder, codec.encoder.mode == "regular" %}
{% macro encoder_functions() %}
{% do out.variable("rate", "uint16_t", encoder.width) %}
{% do out.variable("carry" if regular else "drawn", "uint16_t" if regular else "uint32_t", encoder.width) %}
/* Rate code in 8 bits: a number between low and high becomes 0 to 256 spikes in 256 timesteps. */
{% include "nearest.c" %}
static void encode_begin(const double *observation)
{
    uint32_t k;
    for (k = 0u; k < {{ encoder.width }}u; k++) {
        const double observed = observation[k];
{% print normalise(live) | indent(4, true) %}
        x = (x - {{ out.each("low", encoder.low, "k") }}) / {{ out.each("range", encoder.high - encoder.low, "k") }};
        if (x < 0.0) {
            x = 0.0;
        } else if (x > 1.0) {
            x = 1.0;
        }
        rate[k] = (uint16_t)nearest(x * 256.0);
{% if regular %}
        carry[k] = 128u;
{% else %}

{% endif %}
    }
}

static uint32_t encode(uint32_t timestep, {{ id_t }} *id)
{
    uint32_t count = 0u;
    uint32_t k;
    (void)timestep;
    for (k = 0u; k < {{ encoder.width }}u; k++) {
{% if regular %}
        carry[k] = (uint16_t)(carry[k] + rate[k]);
        if (carry[k] >= 256u) {
            carry[k] = (uint16_t)(carry[k] - 256u);
            id[count] = ({{ id_t }})k;
            count++;
        }
{% else %}
        uint32_t x = drawn[k];
        x ^= x << 13;
        x ^= x >> 17;
        x ^= x << 5;
        drawn[k] = x;
        if ((x >> 24) < rate[k]) {
            id[count] = ({{ id_t }})k;
            count++;
        }
{% endif %}
    }
    return count;
}

{% endmacro %}
{% macro encoder_reset() %}
{% if not regular %}
    {{ prefix }}_seed(0u);
{% endif %}
{% endmacro %}
{% macro seed_function() %}
{% if not regular %}

static uint32_t mixed(uint32_t x)
{
    x = (x ^ (x >> 16)) * 0x85EBCA6Bu;
    x = (x ^ (x >> 13)) * 0xC2B2AE35u;
    return x ^ (x >> 16);
}

void {{ prefix }}_seed(uint64_t seed)
{
    const uint32_t lower = (uint32_t)(seed & 0xFFFFFFFFu);
    const uint32_t begun = mixed(mixed(lower + 0x9E3779B9u) + (uint32_t)(seed >> 32));
    uint32_t k;
    for (k = 0u; k < {{ encoder.width }}u; k++) {
        const uint32_t first = mixed(begun + k);
        drawn[k] = (first == 0u) ? 1u : first;
    }
}
{% endif %}
{% endmacro %}

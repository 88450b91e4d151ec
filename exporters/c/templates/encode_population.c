{% from "normalise.c" import normalise with context %}
{% set encoder = codec.encoder %}
{% set shown_kind = narrowest(0, above | length) %}
{% macro encoder_functions() %}
{% do out.constant("pattern_above", above) %}
{% do out.constant("pattern_spikes", masks) %}
{% do out.variable("channel", id_t, encoder.width) %}
{% do out.variable("shown", shown_kind, encoder.width) %}
{% do out.variable("active", "uint32_t") %}
{% set normalised = normalise(live) | indent(4, true) %}
/* Population code: each channel has a receptive field, A = exp(u) with u = -1/2 ((x - m) / s)**2,
 * and integrates it. Few patterns of spikes are possible; u, of which A never falls, is looked up
 * among the bounds between them, so that no exponential is computed. */
static void encode_begin(const double *observation)
{
    uint32_t i;
    uint32_t p;
    active = 0u;
    for (i = 0u; i < {{ PREFIX }}_OBSERVATIONS; i++) {
        const uint32_t k = i;
        const double observed = observation[i];
{% print normalised %}
        for (p = 0u; p < {{ encoder.mean.shape[1] }}u; p++) {
            const uint32_t n = (i * {{ encoder.mean.shape[1] }}u) + p;
            double u = (x - {{ out.each("centre", encoder.mean, "n") }}) / {{ out.each("width", encoder.std, "n") }};
            uint32_t pattern = 0u;
            u *= u;
            u *= -0.5;
            while ((pattern < {{ above | length }}u) && (u > pattern_above[pattern])) {
                pattern++;
            }
            if (pattern_spikes[pattern] != 0u) {
                channel[active] = ({{ id_t }})n;
                shown[active] = ({{ shown_kind }})pattern;
                active++;
            }
        }
    }
}

static uint32_t encode(uint32_t timestep, {{ id_t }} *id)
{
    uint32_t count = 0u;
    uint32_t j;
    for (j = 0u; j < active; j++) {
        id[count] = channel[j];
        count += (uint32_t)((pattern_spikes[shown[j]] >> timestep) & 1u);
    }
    return count;
}

{% endmacro %}
{% macro encoder_reset() %}
    active = 0u;
{% endmacro %}
{% macro seed_function() %}{% endmacro %}

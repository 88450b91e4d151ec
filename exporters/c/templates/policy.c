{% from plan.family ~ ".c" import layer_functions, shared_functions, timestep with context %}
{% macro declare_spikes(spikes) %}
{% do out.variable(spikes.name ~ "_id", id_t, spikes.slots, spikes.capacity) %}
{% do out.variable(spikes.name ~ "_count", spikes.count_kind, spikes.slots) %}
{% if spikes.several %}
{% do out.variable(spikes.name ~ "_times", "uint8_t", spikes.slots, spikes.capacity) %}
{% endif %}
{% if spikes.slots > 1 %}
{% do out.variable(spikes.name ~ "_head", "uint32_t") %}
{% endif %}
{% endmacro %}
{% do out.variable("sums", int_t, plan.layers | map(attribute="size") | max) %}
{% do declare_spikes(plan.input) %}
{% for layer in plan.layers %}
{% for state, kind in layer.states.items() %}
{% do out.variable(layer.name ~ "_" ~ state, kind or int_t, layer.size) %}
{% endfor %}
{% if layer.spikes %}
{% do declare_spikes(layer.spikes) %}
{% endif %}
{% endfor %}
{% set functions %}
{% for layer in plan.layers %}
{% print layer_functions(layer) %}
/* layer {{ layer.layer.name | plain }} */
static void {{ layer.name }}_step(void)
{
    uint32_t n;
{% if layer.spikes %}
    uint32_t fired = 0u;
{% endif %}
{% print timestep(layer) %}
{% if layer.spikes %}
    {{ layer.name }}_count[{{ layer.spikes.slot() }}] = ({{ layer.spikes.count_kind }})fired;
{% endif %}
}

{% endfor %}
{% endset %}
/* {{ mark }}
 * {{ origin }}
 *
 * The chip's integers. Spikes are lists of the neurons that spike, and only their synapses are
 * added up. Layers are named l0, l1, ... in the order in which they are computed.
 */
#include "{{ prefix }}.h"

/* shifts of negative numbers to the right have to keep the sign, as all compilers of note do */
typedef char {{ prefix }}_shifts_keep_the_sign[((-1) >> 1) == -1 ? 1 : -1];

{{ out.text }}

{% print shared_functions() %}
{% print functions %}
void {{ prefix }}_net_reset(void)
{
    uint32_t n;
{% for layer in plan.layers %}
    for (n = 0u; n < {{ layer.size }}u; n++) {
{% for state, kind in layer.states.items() %}
        {{ layer.name }}_{{ state }}[n] = 0{{ "u" if kind }};
{% endfor %}
    }
{% endfor %}
{% for spikes in plan.spikes.values() %}
    for (n = 0u; n < {{ spikes.slots }}u; n++) {
        {{ spikes.name }}_count[n] = 0u;
    }
{% if spikes.slots > 1 %}
    {{ spikes.name }}_head = 0u;
{% endif %}
{% endfor %}
}

{{ id_t }} *{{ prefix }}_net_begin(uint8_t **times)
{
{% for spikes in plan.spikes.values() if spikes.slots > 1 %}
    {{ spikes.name }}_head = ({{ spikes.name }}_head + 1u) % {{ spikes.slots }}u;
{% else %}

{% endfor %}
    *times = {{ "in_times[" ~ plan.input.slot() ~ "]" if plan.input.several else "0" }};
    return in_id[{{ plan.input.slot() }}];
}

void {{ prefix }}_net_step(uint32_t count)
{
    in_count[{{ plan.input.slot() }}] = ({{ plan.input.count_kind }})count;
{% for layer in plan.layers %}
    {{ layer.name }}_step();
{% endfor %}
}

void {{ prefix }}_net_layer(uint32_t index, uint32_t late, {{ prefix }}_layer_t *view)
{
    (void)late;
    view->id = 0;
    view->times = 0;
    view->count = 0u;
    switch (index) {
{% for layer in plan.layers %}
        case {{ loop.index0 }}u:
            view->size = {{ layer.size }}u;
            view->current = {{ layer.name ~ "_current" if "current" in layer.states else "0" }};
            view->membrane = {{ layer.name }}_membrane;
{% if layer.spikes %}
{% set slots = layer.spikes.slots %}
{% set slot = "(" ~ layer.name ~ "_head + " ~ slots ~ "u - late) % " ~ slots ~ "u" if slots > 1 else "0" %}
            view->id = {{ layer.name }}_id[{{ slot }}];
            view->count = {{ layer.name }}_count[{{ slot }}];
{% if layer.spikes.several %}
            view->times = {{ layer.name }}_times[{{ slot }}];
{% endif %}
{% endif %}
            break;
{% endfor %}
    default:
        view->size = 0u;
        view->current = 0;
        view->membrane = 0;
        break;
    }
}

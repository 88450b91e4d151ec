{# Functions that add the synapses of a projection to `sums`. #}

{# The rows of a list of events, eight at a time: eight numbers of 8 bits fit in 16. #}
{% macro rows_of_events(each, size) %}
{% set table = out.constant(each.name ~ "_weight", each.weight) %}
static void {{ each.name }}(const {{ plan.id_kind }} *id, uint32_t count)
{
    uint32_t i = 0u;
    uint32_t n;
    for (; (i + 8u) <= count; i += 8u) {
        const {{ each.stored }} *row[8];
        for (n = 0u; n < 8u; n++) {
            row[n] = &{{ table }}[id[i + n] * {{ size }}u];
        }
        for (n = 0u; n < {{ size }}u; n++) {
            sums[n] += ({{ "int16_t" if each.stored in ("int8_t", "uint8_t") else "int32_t" }})({% for k in range(8) %}row[{{ k }}][n]{{ " + " if not loop.last }}{% endfor %});
        }
    }
    for (; i < count; i++) {
        const {{ each.stored }} *row = &{{ table }}[id[i] * {{ size }}u];
        for (n = 0u; n < {{ size }}u; n++) {
            sums[n] += row[n];
        }
    }
}

{% endmacro %}

{# The row of one event; where a neuron can spike several times, so many times. #}
{% macro row_of_event(each, size) %}
{% set several = each.spikes.several %}
{% set times = "(" ~ plan.kind ~ ")times * " if several else "" %}
static void {{ each.name }}(uint32_t axon{{ ", uint32_t times" if several }})
{
{% if each.layout == "rows" %}
    const {{ each.stored }} *row = &{{ out.constant(each.name ~ "_weight", each.weight) }}[axon * {{ size }}u];
    uint32_t n;
    for (n = 0u; n < {{ size }}u; n++) {
        sums[n] += {{ times }}row[n];
    }
{% elif each.layout == "nothing" %}
    (void)axon;
{% if several %}
    (void)times;
{% endif %}
{% elif each.layout == "statements" %}
    switch (axon) {
{% set first, neuron, weight = each.lists %}
{% for axon in range(each.weight.shape[0]) if first[axon] < first[axon + 1] %}
    case {{ axon }}u:
{% for k in range(first[axon], first[axon + 1]) %}
        sums[{{ neuron[k] }}] += {{ weight[k] }};
{% endfor %}
        break;
{% endfor %}
    default:
        break;
    }
{% else %}
{% set first, neuron, weight = each.lists %}
    const uint32_t end = {{ out.constant(each.name ~ "_first", first) }}[axon + 1u];
    uint32_t k;
    for (k = {{ each.name }}_first[axon]; k < end; k++) {
        sums[{{ out.constant(each.name ~ "_neuron", neuron) }}[k]] += {{ times }}{{ out.constant(each.name ~ "_weight", weight) }}[k];
    }
{% endif %}
}

{% endmacro %}

{% macro set_sums(layer, bias) %}
    for (n = 0u; n < {{ layer.size }}u; n++) {
        sums[n] = {{ out.each(layer.name ~ "_bias", bias, "n", plan.kind) }};
    }
{% endmacro %}

{% macro for_each_event(spikes, slot) %}
    {
        uint32_t i;
        for (i = 0u; i < {{ spikes.name }}_count[{{ slot }}]; i++) {
{% print caller() %}
        }
    }
{% endmacro %}

{% macro add_rows(layer) %}
{% for each in layer.inputs %}
{% set of = each.spikes.name %}
{% if each.layout == "rows" and not each.spikes.several %}
    {{ each.name }}({{ of }}_id[{{ each.slot }}], {{ of }}_count[{{ each.slot }}]);
{% else %}
{% call for_each_event(each.spikes, each.slot) %}
            {{ each.name }}({{ of }}_id[{{ each.slot }}][i]{% if each.spikes.several %}, {{ of }}_times[{{ each.slot }}][i]{% endif %});
{% endcall %}
{% endif %}
{% endfor %}
{% endmacro %}

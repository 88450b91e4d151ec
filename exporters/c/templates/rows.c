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
{% if each.window %}
{% print kernel_of_event(each) %}
{% else %}
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

{% endif %}
{% endmacro %}

{# The kernel of one event: at each position that sees it, one weight of every channel. Where events
   are taken in one by one, those neurons take this one. #}
{% macro kernel_of_event(each, hears="") %}
{% set window, several = each.window, each.spikes.several %}
{% set (channels, rows, columns), (features, height, width) = window.source, window.target %}
{% set _, pooled_rows, pooled_columns = window.pooled %}
{% set of_group = features // window.groups %}
{% set kernel = window.by_source(each.weight).transpose(0, 2, 3, 1) %}
/* {{ channels }} x {{ rows }} x {{ columns }} to {{ features }} x {{ height }} x {{ width }}, kernel {{ window.kernel | join(" x ") }} */
static void {{ each.name }}(uint32_t axon{{ ", uint32_t times" if several }})
{
    const uint32_t channel = axon / {{ rows * columns }}u;
{% set y, x = "(axon / %du) %% %du" % (columns, rows), "axon %% %du" % columns %}
    const uint32_t y = {{ place(y, window.pool[0], window.padding[0]) }};
    const uint32_t x = {{ place(x, window.pool[1], window.padding[1]) }};
    uint32_t row;
    uint32_t column;
    uint32_t o;
{% if pooled_rows * window.pool[0] < rows or pooled_columns * window.pool[1] < columns %}
    if ((y >= {{ pooled_rows + window.padding[0] }}u) || (x >= {{ pooled_columns + window.padding[1] }}u)) {
        return;
    }
{% endif %}
{% call for_each_position(window, 0, "y", "row", "ky") %}
{% call for_each_position(window, 1, "x", "column", "kx") %}
    const {{ each.stored }} *weight = &{{ out.constant(each.name ~ "_weight", kernel) }}[((((channel * {{ window.kernel[0] }}u) + ky) * {{ window.kernel[1] }}u) + kx) * {{ of_group }}u];
{% set group = "(channel / %du) * %du" % (channels // window.groups, of_group * height * width) %}
    uint32_t n = {{ "(%s) + " % group if window.groups > 1 }}{{ "(row * %du) + " % width if height > 1 }}column;
    for (o = 0u; o < {{ of_group }}u; o++) {
        sums[n] {{ "=" if hears else "+=" }} {{ "(" ~ plan.kind ~ ")times * " if several }}weight[o];
{% if hears %}
        {{ hears }}(n);
{% endif %}
        n += {{ height * width }}u;
    }
{% endcall %}
{% endcall %}
}

{% endmacro %}

{# A coordinate of the source behind the pool and the padding. #}
{% macro place(coordinate, pool, padding) -%}
{% set divided = "(%s) / %du" % (coordinate, pool) if pool > 1 else coordinate %}
{{ "(%s) + %du" % (divided, padding) if padding else divided }}
{%- endmacro %}

{# Positions of an axis whose windows hold a place of the source, and which element it has there. #}
{% macro for_each_position(window, axis, at, position, element) %}
{% set size, step, dilation = window.target[1 + axis], window.stride[axis], window.dilation[axis] %}
{% set span = dilation * (window.kernel[axis] - 1) + 1 %}
{% set least = "((%s - %du) / %du) + 1u" % (at, span, step) if step > 1 else "%s - %du" % (at, span - 1) %}
{% set start = "(%s * %du)" % (position, step) if step > 1 else position %}
    for ({{ position }} = ({{ at }} < {{ span }}u) ? 0u : ({{ least }}); ({{ position }} < {{ size }}u) && ({{ start }} <= {{ at }}); {{ position }}++) {
        const uint32_t {{ element }} = {{ "(%s - %s) / %du" % (at, start, dilation) if dilation > 1 else "%s - %s" % (at, start) }};
{% if dilation > 1 %}
        if ((({{ at }} - {{ start }}) % {{ dilation }}u) != 0u) {
            continue;
        }
{% endif %}
{% print caller() | indent(4, true) %}
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

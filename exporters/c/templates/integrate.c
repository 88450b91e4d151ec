{# Integrate-and-fire neurons, as runtime.families.integrate_and_fire.neurons has them. #}
{% from "registers.c" import hold, hold_function with context %}
{% from "rows.c" import add_rows, for_each_event, kernel_of_event, row_of_event, rows_of_events, set_sums with context %}
{% set kind, rules = plan.kind, plan.rules %}
{% set subtracts = plan.program.convention.reset == "subtract" %}
{% set by_event = rules.adds == "event" %}

{% macro shared_functions() %}
{% if "membrane" in plan.held %}
{% print hold_function("membrane", rules.membrane) %}
{% endif %}
{% endmacro %}

{% macro layer_functions(layer) %}
{% if by_event %}
static void {{ layer.name }}_hear(uint32_t n)
{
{% print receive(layer) %}
}

{% endif %}
{% for each in layer.inputs %}
{% if by_event and each.window %}
{% print kernel_of_event(each, layer.name ~ "_hear") %}
{% else %}
{% print (row_of_event if each.spikes.several or each.layout != "rows" or by_event else rows_of_events)(each, layer.size) %}
{% endif %}
{% endfor %}
{% if by_event and (layer.bias.any() or layer.inputs | rejectattr("window") | list) %}
static void {{ layer.name }}_take(void)
{
    uint32_t n;
    for (n = 0u; n < {{ layer.size }}u; n++) {
        {{ layer.name }}_hear(n);
    }
}

{% endif %}
{% endmacro %}

{% macro for_each_neuron(layer) %}
{% set body = caller() %}
{% if body %}
    for (n = 0u; n < {{ layer.size }}u; n++) {
{% print body %}
    }
{% endif %}
{% endmacro %}

{# Before spikes arrive. #}
{% macro begin(layer) %}
{% call for_each_neuron(layer) %}
{% if layer.spikes %}
        {{ layer.name }}_spikes[n] = 0u;
{% endif %}
{% if rules.leak_order == "first" %}
{# a neuron that fired in the timestep before is reset in the place of its leak #}
{% if rules.reset_at != "spike" and layer.spikes %}
{% set lost = leak(layer) | indent(4, true) %}
        if ({{ above(layer) }}) {
            {{ reset(layer) }}
        } else {
{% print lost %}
        }
{% else %}
{% print leak(layer) %}
{% endif %}
{% if rules.checks == "event" and rules.leak != "none" %}
{% print fire(layer) %}
{% endif %}
{% endif %}
{% endcall %}
{% endmacro %}

{# The sum of a neuron, in a step or for one event. #}
{% macro receive(layer) %}
{% set v = layer.name ~ "_membrane[n]" %}
        {{ v }} = {{ hold(layer, "membrane", v ~ " + sums[n]" ~ (" * " ~ layer.unit | c(kind) if layer.unit > 1 else "")) }};
{% set floor = plan.floor(layer.layer) %}
{% if floor is not none %}
{% set least = out.each(layer.name ~ "_floor", floor, "n", kind) %}
        if ({{ v }} < {{ least }}) {
            {{ v }} = {{ least }};
        }
{% endif %}
{% if rules.checks == "event" %}
{% print fire(layer) %}
{% endif %}
{% endmacro %}

{# After spikes have arrived. #}
{% macro end(layer) %}
{% set name = layer.name %}
{% call for_each_neuron(layer) %}
{% if rules.leak_order == "last" %}
{% print leak(layer) %}
{% endif %}
{% if rules.checks == "step" %}
{% print fire(layer) %}
{% endif %}
{% if layer.spikes %}
        if ({{ name }}_spikes[n] > 0u) {
            {{ name }}_id[{{ layer.spikes.slot() }}][fired] = ({{ id_t }})n;
{% if rules.spikes_max > 1 %}
            {{ name }}_times[{{ layer.spikes.slot() }}][fired] = {{ name }}_spikes[n];
{% endif %}
            fired++;
        }
{% endif %}
{% endcall %}
{% endmacro %}

{% macro leak(layer) %}
{% set v, amount = layer.name ~ "_membrane[n]", layer.layer.membrane_decay %}
{% if rules.leak == "shift" %}
{# V - (V >> shift), rounded down; a negative shift is none #}
{% if (amount >= 0).any() %}
{% set shift = out.each(layer.name ~ "_leak", amount.clip(0), "n", "uint32_t") %}
{% set off = v ~ " -= ((" ~ v ~ " < 0) ? (-1 - ((-1 - " ~ v ~ ") >> " ~ shift ~ ")) : (" ~ v ~ " >> " ~ shift ~ "));" %}
{% if (amount >= 0).all() %}
        {{ off }}
{% else %}
        if ({{ out.each(layer.name ~ "_leaks", (amount >= 0).astype("int64"), "n", "uint32_t") }} != 0u) {
            {{ off }}
        }
{% endif %}
{% endif %}
{% elif rules.leak != "none" and amount.any() %}
{% set lost = out.each(layer.name ~ "_leak", amount, "n", kind) %}
{% set crosses = rules.leak == "crossing" %}
        if ({{ v }} > 0) {
            {{ v }} -= {{ lost if crosses else "((" ~ v ~ " > " ~ lost ~ ") ? " ~ lost ~ " : " ~ v ~ ")" }};
        } else if ({{ v }} < 0) {
            {{ v }} += {{ lost if crosses else "((-" ~ v ~ " > " ~ lost ~ ") ? " ~ lost ~ " : -" ~ v ~ ")" }};
        }
{% endif %}
{% endmacro %}

{% macro threshold(layer) -%}
{{ out.each(layer.name ~ "_threshold", layer.layer.threshold, "n", kind) }}
{%- endmacro %}
{% macro above(layer) -%}
{{ layer.name }}_membrane[n] {{ ">=" if rules.fires == "reached" else ">" }} {{ threshold(layer) }}
{%- endmacro %}
{% macro reset(layer) -%}
{{ layer.name }}_membrane[n] {{ "-= " ~ threshold(layer) if subtracts else "= 0" }};
{%- endmacro %}

{% macro fire(layer) %}
{% set count = layer.name ~ "_spikes[n]" %}
{% if layer.spikes and subtracts and rules.checks == "step" and rules.spikes_max > 1 %}
        while (({{ above(layer) }}) && ({{ count }} < {{ rules.spikes_max }}u)) {
            {{ reset(layer) }}
            {{ count }}++;
        }
{% elif layer.spikes %}
        if ({{ above(layer) }}) {
{% if rules.reset_at == "spike" %}
            {{ reset(layer) }}
{% endif %}
            if ({{ count }} < {{ rules.spikes_max }}u) {
                {{ count }}++;
            }
        }
{% endif %}
{% endmacro %}

{# All spikes arrive as one sum, or one event after the other and the bias as the last. #}
{% macro timestep(layer) %}
{% set name = layer.name %}
{% if not by_event %}
{% set sums = set_sums(layer, layer.bias) ~ add_rows(layer) %}
{% set first, last = begin(layer), end(layer) %}
{% set taken %}
{% call for_each_neuron(layer) %}
{% print receive(layer) %}
{% endcall %}
{% endset %}
{% print first ~ sums ~ taken ~ last %}
{% else %}
{% set arrivals %}
{% for each in layer.inputs %}
{% set of, slot, several = each.spikes.name, each.slot, each.spikes.several %}
{% set deeper = "    " if several else "" %}
{% call for_each_event(each.spikes, slot) %}
{% if several %}
            uint32_t again;
            for (again = 0u; again < {{ of }}_times[{{ slot }}][i]; again++) {
{% endif %}
{% if not each.window %}
{% print set_sums(layer, 0 * layer.bias) | indent(12 if several else 8, true) %}
{% endif %}
{{ deeper }}            {{ name }}_row{{ loop.index0 }}({{ of }}_id[{{ slot }}][i]{{ ", 1u" if several }});
{% if not each.window %}
{{ deeper }}            {{ name }}_take();
{% endif %}
{% if several %}
            }
{% endif %}
{% endcall %}
{% endfor %}
{% if layer.bias.any() %}
{% print set_sums(layer, layer.bias) %}
    {{ name }}_take();
{% endif %}
{% endset %}
{% print begin(layer) ~ arrivals ~ end(layer) %}
{% endif %}
{% endmacro %}

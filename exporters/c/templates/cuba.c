{# CuBa-LIF neurons, as runtime.families.cuba.neurons has them. #}
{% from "registers.c" import hold, hold_function with context %}
{% from "rows.c" import add_rows, row_of_event, rows_of_events, set_sums with context %}
{% set kind = plan.kind %}

{% macro shared_functions() %}
{% for name in ("accumulator", "current", "push", "membrane") if name in plan.held %}
{% print hold_function(name, plan.rules[name]) %}
{% endfor %}
{% if plan.decays %}
{% print decay(plan.rules.decay_bits) %}
{% endif %}
{% endmacro %}

{# The magnitude of x times factor / 2**bits, rounded toward zero. 32-bit numbers are cut in two at
   the decay's bits, so that no product needs 64: (h 2**b + l) f >> b  =  h f + (l f >> b).
   Cores with a long multiplication, which ARMv6-M and ARMv8-M Baseline have not, take the upper half
   of 2 x (f << 31 - b) instead, to which 2**32 - 1 is added where x is negative: that rounds up.
   It needs factors below 2**bits. #}
{% macro decay(bits) %}
{% set long = kind == "int32_t" and plan.largest < 2 ** 30 and plan.decays | map("max") | max < plan.rules.decay_one %}
static {{ kind }} decayed({{ kind }} x, u{{ kind }} factor)
{
{% if long %}
#if !defined(__ARM_ARCH_6M__) && !defined(__ARM_ARCH_8M_BASE__)
    const int64_t product = (int64_t)(2 * x) * (int32_t)(factor << {{ 31 - bits }});
    return (int32_t)((product + (int64_t)((x < 0) ? UINT32_MAX : 0u)) >> 32);
#else
{% endif %}
    const u{{ kind }} size = (x < 0) ? (u{{ kind }})(-x) : (u{{ kind }})x;
{% if kind == "int64_t" %}
    const {{ kind }} kept = ({{ kind }})((size * factor) >> {{ bits }});
{% elif bits <= 16 %}
    const {{ kind }} kept = ({{ kind }})(((size >> {{ bits }}) * factor) + (((size & {{ (2 ** bits - 1) | c("uint32_t") }}) * factor) >> {{ bits }}));
{% else %}
    const {{ kind }} kept = ({{ kind }})((uint32_t)(((uint64_t)size * factor) >> {{ bits }}));
{% endif %}
    return (x < 0) ? -kept : kept;
{% if long %}
#endif
{% endif %}
}

{% endmacro %}

{% macro layer_functions(layer) %}
{% for each in layer.inputs %}
{% print (row_of_event if each.spikes.several or each.layout != "rows" else rows_of_events)(each, layer.size) %}
{% endfor %}
{% endmacro %}

{# What is left of a state, and the plus sign behind it; nothing where nothing is left. #}
{% macro kept(state, factor, table) -%}
{% if plan.is_decay(factor) -%}
decayed({{ state }}, {{ out.each(table, factor, "n", "u" ~ kind) }}) + {# #}
{%- elif factor.any() -%}
{{ state }} + {# #}
{%- endif %}
{%- endmacro %}

{% macro timestep(layer) %}
{% set name, bias = layer.name, layer.layer.voltage_bias %}
{% set current, membrane = name ~ "_current[n]", name ~ "_membrane[n]" %}
{% set unit = layer.unit * 2 ** plan.rules.mantissa_shift %}
{% print set_sums(layer, layer.bias) %}
{% print add_rows(layer) %}
{% set pushed = current ~ (" + " ~ out.each(name ~ "_bias_v", bias, "n", kind) if bias.any() else "") %}
{% set arrived = hold(layer, "accumulator", "sums[n]" ~ (" * " ~ unit | c(kind) if unit > 1 else "")) %}
    for (n = 0u; n < {{ layer.size }}u; n++) {
        {{ current }} = {{ hold(layer, "current", kept(current, layer.layer.current_decay, name ~ "_keep_i") ~ arrived) }};
        {{ membrane }} = {{ hold(layer, "membrane", kept(membrane, layer.layer.membrane_decay, name ~ "_keep_v") ~ hold(layer, "push", pushed)) }};
{% if layer.spikes %}
{% set threshold = out.each(name ~ "_threshold", layer.layer.threshold, "n", kind) %}
{% set waits = name ~ "_refractory[n]" %}
{% if "refractory" in layer.states %}
        if ({{ waits }} > 0u) {
            {{ waits }}--;
            {{ membrane }} = 0;
        } else if ({{ membrane }} > {{ threshold }}) {
{% else %}
        if ({{ membrane }} > {{ threshold }}) {
{% endif %}
            {{ membrane }} {{ "-= " ~ threshold if plan.program.convention.reset == "subtract" else "= 0" }};
            {{ name }}_id[{{ layer.spikes.slot() }}][fired] = ({{ id_t }})n;
            fired++;
{% if "refractory" in layer.states %}
            {{ waits }} = {{ plan.rules.refractory - 1 }}u;
        } else {
            /* it stays below its threshold */
{% endif %}
        }
{% endif %}
    }
{% endmacro %}

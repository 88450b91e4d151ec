{# Functions that hold a number as a register of the chip does. #}
{% macro clamp(low, high) %}
    if (x < {{ low | c(plan.kind) }}) {
        x = {{ low | c(plan.kind) }};
    } else if (x > {{ high | c(plan.kind) }}) {
        x = {{ high | c(plan.kind) }};
    }
{% endmacro %}
{% macro hold_function(name, register) %}
{% set kind = plan.kind %}
{% set half = 2 ** (register.bits - 1) %}
static {{ kind }} {{ name }}({{ kind }} x)
{
{% if register.overflow == "wrap" %}
{# (x + half) mod 2 half - half, of unsigned integers #}
    const u{{ kind }} raised = ((u{{ kind }})x + {{ half | c("u" ~ kind) }}) & {{ (2 * half - 1) | c("u" ~ kind) }};
    x = ({{ kind }})raised - {{ half | c(kind) }};
{% elif register.overflow == "wrap-once" %}
{% set twice = (2 * half) | c(kind if half < 2 ** 30 else "int64_t") %}
    if (x > {{ half | c(kind) }}) {
        x -= {{ twice }};
    } else if (x <= {{ -half | c(kind) }}) {
        x += {{ twice }};
    }
{% elif register.overflow != "none" %}
{% print clamp(1 - half if register.overflow == "clip" else -half, half - 1) %}
{% endif %}
{% if register.between %}
{% print clamp(*register.between) %}
{% endif %}
    return x;
}

{% endmacro %}
{% macro hold(layer, register, value) -%}
{{ register if register in layer.held }}({{ value }})
{%- endmacro %}

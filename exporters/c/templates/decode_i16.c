{% from "squash_i16.c" import squashed with context %}
{% set scores = code.bias | length %}
{% macro decoder_function() %}
{% set bias = out.each("bias", code.bias, "a", "int32_t") %}
static void decode(int16_t *action)
{
    {{ prefix }}_layer_t view;
{% if code.diagonal is not none %}
{% set term = code.terms[0] %}
{% set weight = out.each("read_weight", code.diagonal, "a", "int32_t") %}
    uint32_t a;
    {{ prefix }}_net_layer({{ term.tap.index }}u, 0u, &view);
    for (a = 0u; a < {{ scores }}u; a++) {
        action[a] = {{ squashed(code.squash, bias ~ " + " ~ dropped("view.membrane[a]", term.drop) ~ " * " ~ weight) }};
    }
{% else %}
    int32_t score[{{ scores }}];
    uint32_t a;
    uint32_t n;
    for (a = 0u; a < {{ scores }}u; a++) {
        score[a] = {{ bias }};
    }
{% for term in code.terms %}
{% set k, tap = loop.index0, term.tap %}
    {{ prefix }}_net_layer({{ tap.index }}u, {{ 0 if tap.silent else tap.lag }}u, &view);
{% if not tap.silent %}
    for (n = 0u; n < view.count; n++) {
{% print weigh(k, term.weight, "", "view.id[n]") %}
    }
{% elif tap.lag %}
{% do out.variable("late" ~ k, int_t, tap.lag, tap.size) %}
{% do out.variable("late" ~ k ~ "_at", "uint32_t") %}
{% set value = "late" ~ k ~ "[late" ~ k ~ "_at][n]" %}
    for (n = 0u; n < {{ tap.size }}u; n++) {
{% print weigh(k, term.weight, dropped(value, term.drop), "n") %}
        {{ value }} = view.membrane[n];
    }
    late{{ k }}_at = (late{{ k }}_at + 1u) % {{ tap.lag }}u;
{% else %}
    for (n = 0u; n < {{ tap.size }}u; n++) {
{% print weigh(k, term.weight, dropped("view.membrane[n]", term.drop), "n") %}
    }
{% endif %}
{% endfor %}
{% if choices %}
    n = 0u;
    for (a = 1u; a < {{ scores }}u; a++) {
        n = (score[a] > score[n]) ? a : n;
    }
    action[0] = (int16_t)n;
{% else %}
    for (a = 0u; a < {{ scores }}u; a++) {
        action[a] = {{ squashed(code.squash, "score[a]") }};
    }
{% endif %}
{% endif %}
}

{% endmacro %}
{% macro dropped(value, bits) -%}
{{ "(" ~ value ~ " >> " ~ bits ~ ")" if bits else value }}
{%- endmacro %}
{# A value, "" for 1, times the weights of a neuron: one, or a list of them. #}
{% macro weigh(k, weight, value, index) %}
{% set first, score, each = as_lists(weight) %}
{% set name = "read" ~ k %}
{% if (first[1:] - first[:-1] == 1).all() %}
{% set weight = out.each(name ~ "_weight", each, index, "int32_t") %}
{% if (score[1:] - score[:-1] == 1).all() %}
        score[{{ index }}{{ " + " ~ score[0] ~ "u" if score[0] }}] += {{ value ~ " * " if value }}{{ weight }};
{% else %}
        score[{{ out.each(name ~ "_score", score, index, "uint32_t") }}] += {{ value ~ " * " if value }}{{ weight }};
{% endif %}
{% else %}
{% if value %}
        const int32_t value = {{ value }};
{% endif %}
{% set first = out.constant(name ~ "_first", first) %}
        for (a = {{ first }}[{{ index }}]; a < {{ first }}[({{ index }}) + 1u]; a++) {
            score[{{ out.constant(name ~ "_score", score) }}[a]] += {{ "value * " if value }}{{ out.constant(name ~ "_weight", each) }}[a];
        }
{% endif %}
{% endmacro %}
{% macro decoder_reset() %}
{% for term in code.terms if term.tap.silent and term.tap.lag %}
{% set k, tap = code.terms.index(term), term.tap %}
    late{{ k }}_at = 0u;
    for (k = 0u; k < {{ tap.lag * tap.size }}u; k++) {
        late{{ k }}[k / {{ tap.size }}u][k % {{ tap.size }}u] = 0;
    }
{% endfor %}
{% endmacro %}

{# timesteps of which the scores are a mean #}
{% set timesteps, scores = 1 if codec.score == "last" else codec.timesteps, plan.bias | length %}
{% macro total_kind(tap) -%}
{% set counted = narrowest(0, timesteps * tap.times_max) %}
{% if tap.silent -%}
{{ plan.kind if timesteps == 1 else "int64_t" }}
{%- else -%}
{{ counted if counted in ("uint8_t", "uint16_t") else "uint32_t" }}
{%- endif %}
{%- endmacro %}
{% macro decoder_functions() %}
{% for tap in plan.taps %}
{% do out.variable("total" ~ loop.index0, total_kind(tap), tap.size) %}
{% if tap.silent and tap.lag %}
{% do out.variable("late" ~ loop.index0, int_t, tap.lag, tap.size) %}
{% do out.variable("late" ~ loop.index0 ~ "_at", "uint32_t") %}
{% endif %}
{% endfor %}
{% set weighted %}
{% for tap in plan.taps %}
{% print weigh(loop.index0, tap) %}
{% endfor %}
{% endset %}
{% set bias = out.each("bias", plan.bias * timesteps, "a") %}
{% if codec.squash == "tanh" %}
{% do out.constant("tanh_of", tanh_table) %}
{% include "squash.c" %}
{% endif %}

static void decode_begin(void)
{
    uint32_t n;
{% for tap in plan.taps %}
    for (n = 0u; n < {{ tap.size }}u; n++) {
        total{{ loop.index0 }}[n] = {{ "0" if tap.silent else "0u" }};
    }
{% endfor %}
}

/* What leaves the chip in a timestep is added up{{ ", of the last one alone" if codec.score == "last" }}. */
static void decode_add(void)
{
    {{ prefix }}_layer_t view;
    uint32_t n;
{% for tap in plan.taps %}
{% set k = loop.index0 %}
    {{ prefix }}_net_layer({{ tap.index }}u, {{ 0 if tap.silent else tap.lag }}u, &view);
{% if not tap.silent %}
    for (n = 0u; n < view.count; n++) {
        total{{ k }}[view.id[n]] = ({{ total_kind(tap) }})(total{{ k }}[view.id[n]] + {{ "view.times[n]" if tap.times_max > 1 else "1u" }});
    }
{% elif tap.lag %}
    for (n = 0u; n < {{ tap.size }}u; n++) {
        total{{ k }}[n] += late{{ k }}[late{{ k }}_at][n];
        late{{ k }}[late{{ k }}_at][n] = view.membrane[n];
    }
    late{{ k }}_at = (late{{ k }}_at + 1u) % {{ tap.lag }}u;
{% else %}
    for (n = 0u; n < {{ tap.size }}u; n++) {
        total{{ k }}[n] += view.membrane[n];
    }
{% endif %}
{% endfor %}
}

static void decode_end({{ prefix }}_action_t *action)
{
    double score[{{ scores }}u];
    uint32_t n;
    uint32_t a;
    for (a = 0u; a < {{ scores }}u; a++) {
        score[a] = {{ bias }};
    }
{% print weighted %}
{% set value = "score[a]" ~ (" / " ~ timesteps | c("double") if timesteps > 1 else "") %}
    for (a = 0u; a < {{ scores }}u; a++) {
{% if choices %}
        score[a] = {{ value }};
    }
    action[0] = 0;
    for (a = 1u; a < {{ scores }}u; a++) {
        if (score[a] > score[action[0]]) {
            action[0] = (int32_t)a;
        }
    }
{% else %}
        action[a] = {{ "squash(" ~ value ~ ")" if codec.squash == "tanh" else value }};
    }
{% endif %}
}
{% endmacro %}
{# A sum times its weights; where each neuron has a score of its own, as one loop. #}
{% macro weigh(k, tap) %}
    for (n = 0u; n < {{ tap.size }}u; n++) {
{% if tap.diagonal is not none %}
{% set weight = out.each("read" ~ k ~ "_weight", tap.diagonal, "n") %}
        score[n{{ " + " ~ tap.first ~ "u" if tap.first }}] += (double)total{{ k }}[n]{{ " * " ~ weight if weight != "1.0" }};
{% else %}
{% set first, score, weight = tap.lists %}
{% set first = out.constant("read" ~ k ~ "_first", first) %}
        if (total{{ k }}[n] != 0) {
            const double total = (double)total{{ k }}[n];
            for (a = {{ first }}[n]; a < {{ first }}[n + 1u]; a++) {
                score[{{ out.constant("read" ~ k ~ "_score", score + tap.first) }}[a]] += total * {{ out.constant("read" ~ k ~ "_weight", weight) }}[a];
            }
        }
{% endif %}
    }
{% endmacro %}
{% macro decoder_reset() %}
{% for tap in plan.taps if tap.silent and tap.lag %}
{% set k = plan.taps.index(tap) %}
    {
        uint32_t n;
        uint32_t t;
        late{{ k }}_at = 0u;
        for (t = 0u; t < {{ tap.lag }}u; t++) {
            for (n = 0u; n < {{ tap.size }}u; n++) {
                late{{ k }}[t][n] = 0;
            }
        }
    }
{% endfor %}
{% endmacro %}

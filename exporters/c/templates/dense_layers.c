{# What a layer hands on of a sum. #}
{% macro after(layer, sum) -%}
{% if layer is sameas network.layers[-1] -%}
{{ sum }}
{%- elif layer.activation == "tanh" -%}
hidden_tanh{{ layer.fraction }}({{ sum }})
{%- else -%}
(int16_t)(({{ sum }} < 0) ? 0 : ({{ sum }} >> {{ layer.drop }}))
{%- endif %}
{%- endmacro %}

{# Sums of a block of outputs that stay in registers, from their biases to the outputs. #}
{% macro in_registers(layer, block) %}
    {
{% for j in block %}
        int32_t a{{ loop.index0 }} = {{ layer.bias[j] | c("int32_t") }};
{% endfor %}
{% print caller(block) %}
{% for j in block %}
        y[{{ j }}] = {{ after(layer, "a" ~ loop.index0) }};
{% endfor %}
    }
{% endmacro %}

{% macro local_table(name, values, kind) %}
{{ array(name, values, kind) | indent(4, true) }}
    const {{ kind }} *w = {{ name }};
{% endmacro %}

{# One statement for each weight that is not 0. #}
{% macro statements(layer) %}
{% set factors = layer.factors.tolist() %}
{% for block in layer.blocks %}
{% call(block) in_registers(layer, block) %}
        int32_t in;
{% for row in factors %}
{% set i = loop.index0 %}
{% for j in block if row[j] %}
{% if loop.first %}
        in = x[{{ i }}];
{% endif %}
        a{{ j - block[0] }} += in * {{ row[j] }};
{% endfor %}
{% endfor %}
{% endcall %}
{% endfor %}
{% endmacro %}

{# The weights of each output that are not 0 as lists. #}
{% macro lists(k, layer) %}
{% set first, source, weight = as_lists(layer.factors.T) %}
{% set bias = out.constant("bias" ~ k, layer.bias, "int32_t") %}
{% set first = out.constant("first" ~ k, first) %}
    uint32_t i;
    uint32_t j;
    for (j = 0u; j < {{ layer.bias | length }}u; j++) {
        int32_t a = {{ bias }}[j];
        for (i = {{ first }}[j]; i < {{ first }}[j + 1u]; i++) {
            a += (int32_t)x[{{ out.constant("source" ~ k, source) }}[i]] * {{ out.constant("weight" ~ k, weight) }}[i];
        }
        y[j] = {{ after(layer, "a") }};
    }
{% endmacro %}

{# All weights as a loop over the inputs. #}
{% macro rows(layer) %}
{% print local_table("weights", layer.by_block(layer.factors), narrowest_of(layer.factors)) %}
    uint32_t i;
{% for block in layer.blocks %}
{% call(block) in_registers(layer, block) %}
        for (i = 0u; i < {{ layer.factors | length }}u; i++) {
            const int32_t in = x[i];
{% for j in block %}
            a{{ loop.index0 }} += in * w[{{ loop.index0 }}];
{% endfor %}
            w += {{ block | length }};
        }
{% endcall %}
{% endfor %}
{% endmacro %}

{# A layer with two products and their sum in one instruction. #}
{% macro pairs(layer) %}
{% set inputs = layer.factors | length %}
{% print local_table("pairs", layer.by_block(layer.pairs), "int32_t") %}
    int32_t in;
    uint32_t i;
{% for block in layer.blocks %}
{% call(block) in_registers(layer, block) %}
        for (i = 0u; i < {{ inputs // 2 }}u; i++) {
            in = pair_at(&x[2u * i]);
{% for j in block %}
            a{{ loop.index0 }} = __smlad(in, w[{{ loop.index0 }}], a{{ loop.index0 }});
{% endfor %}
            w += {{ block | length }};
        }
{% if inputs % 2 %}
        in = x[{{ inputs - 1 }}];
{% for j in block %}
        a{{ loop.index0 }} += in * (int16_t)w[{{ loop.index0 }}];
{% endfor %}
        w += {{ block | length }};
{% endif %}
{% endcall %}
{% endfor %}
    (void)w;
{% endmacro %}

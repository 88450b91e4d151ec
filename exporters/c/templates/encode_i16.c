{% set delta, count = code.delta, code.delta.observed | length %}
{% set level_kind = narrowest(-delta.levels_max - delta.most, delta.levels_max + delta.most) %}
{% macro encoder_functions() %}
{# what is added to gain o; the threshold makes the smallest sum that sends nothing 0 #}
{% do out.constant("centre_at_rest", delta.offset + delta.threshold * 2 ** delta.shift, "int32_t") %}
{% do out.variable("level", level_kind, count) %}
{% do out.variable("centre", "int32_t", count) %}
{% set shift = out.each("shift", delta.shift, "k", "uint32_t") %}
{% set x_max = out.each("x_max", delta.x_max, "k", "int32_t") %}
{% set first = out.each("first_of", 2 * delta.most * delta.observed, "k", "uint32_t") %}
/* Send-on-delta. With X = (gain o + offset) >> shift, an observation in 1/256 steps, and level q,
 * centre is offset + (({{ delta.threshold }} - 256 q) << shift), so that the sum gain o + centre is from 0 to
 * below (2 x {{ delta.threshold }} + 1) << shift where X is within {{ delta.threshold }} of 256 q: nothing is sent.
 * `sent` is for the others. */
static uint32_t sent(uint32_t k, int32_t sum, {{ id_t }} *id, uint32_t count)
{
    const int32_t at = 256 * (int32_t)level[k];
    int32_t x = (sum >> {{ shift }}) - {{ delta.threshold }} + at;
    int32_t size;
    int32_t events;
    x = (x > {{ x_max }}) ? {{ x_max }} : x;
    x = (x < -{{ x_max }}) ? -{{ x_max }} : x;
    size = (x < at) ? (at - x) : (x - at);
    if (size > {{ delta.threshold }}) {
        uint32_t first = {{ first }};
        events = (size + 128) >> 8;
        events = (events < {{ delta.most }}) ? events : {{ delta.most }};
        if (x < at) {
            first += {{ delta.most }}u;
            level[k] = ({{ level_kind }})(level[k] - events);
            centre[k] += (events * 256) * ((int32_t)1 << {{ shift }});
        } else {
            level[k] = ({{ level_kind }})(level[k] + events);
            centre[k] -= (events * 256) * ((int32_t)1 << {{ shift }});
        }
{% if delta.code == "unary" %}
        while (events > 0) {
            id[count] = ({{ id_t }})first;
            first++;
            count++;
            events--;
        }
{% else %}
        id[count] = ({{ id_t }})(first + (uint32_t)events - 1u);
        count++;
{% endif %}
    }
    return count;
}

static uint32_t encode(const int16_t *observation, {{ id_t }} *id)
{
    uint32_t count = 0u;
    int32_t sum;
{% if count <= 160 %}
{% for k in range(count) %}
    sum = ({{ delta.gain[k] }} * observation[{{ delta.observed[k] }}]) + centre[{{ k }}];
    if ((uint32_t)sum >= {{ delta.bound[k] | c("uint32_t") }}) {
        count = sent({{ k }}u, sum, id, count);
    }
{% endfor %}
{% else %}
    uint32_t k;
    for (k = 0u; k < {{ count }}u; k++) {
{% set at = out.each("observed_at", delta.observed, "k", "uint32_t") %}
        sum = ({{ out.each("gain", delta.gain, "k", "int32_t") }} * observation[{{ at }}]) + centre[k];
        if ((uint32_t)sum >= {{ out.each("bound", delta.bound, "k", "uint32_t") }}) {
            count = sent(k, sum, id, count);
        }
    }
{% endif %}
    return count;
}

{% endmacro %}

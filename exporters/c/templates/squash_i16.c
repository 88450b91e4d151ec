{# Q15 of a score in 2**-fraction: of its tanh, or of itself; nothing where the largest is chosen. #}
{% macro squash_function(squash, fraction, name="tanh_q15") %}
{% if squash == "tanh" %}
{% do out.constant("tanh_of", q15.TABLE, "int16_t") %}
/* Q15 of tanh of a score in 2**-{{ fraction }}, within 5 units: straight lines between 32 entries for each
 * unit of the score. */
static int16_t {{ name }}(int32_t score)
{
    const uint32_t size = (score < 0) ? (uint32_t)(-score) : (uint32_t)score;
    const uint32_t place = size >> {{ fraction - q15.PER_UNIT }}u;
    int32_t y = 32767;
    if (place < {{ q15.TABLE | length - 1 }}u) {
        const int32_t between = (int32_t)((size >> {{ fraction - q15.LEAST_FRACTION }}u) & 1023u);
        y = tanh_of[place];
        y += ((tanh_of[place + 1u] - y) * between + 512) >> 10;
    }
    return (int16_t)((score < 0) ? -y : y);
}

{% elif squash != "argmax" %}
/* Q15 of a score in 2**-{{ fraction }}. */
static int16_t linear_q15(int32_t score)
{
    int32_t y = score >> {{ fraction - 15 }};
    y = (y > 32767) ? 32767 : y;
    return (int16_t)((y < -32767) ? -32767 : y);
}

{% endif %}
{% endmacro %}
{% macro squashed(squash, score) -%}
{{ "tanh_q15" if squash == "tanh" else "linear_q15" }}({{ score }})
{%- endmacro %}

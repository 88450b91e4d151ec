{% from "normalise.c" import normalise with context %}
{% set encoder, count = codec.encoder, live.sum() %}
{% set apart_max = 256 * encoder.most * (codec.timesteps + 1) %}
{% set apart_kind = "int32_t" if apart_max < 2 ** 31 - 128 else "int64_t" %}
{% set moved_kind = narrowest(0, count - 1) %}
{% set furthest = parts.x_max.max() // 256 + 1 + encoder.most %}
{% set level_kind = narrowest(-furthest, furthest) %}
{% set far_kind = "int32_t" if parts.fits_int32 and apart_kind == "int32_t" else "int64_t" %}
{% macro encoder_functions() %}
{% set normalised = normalise(live) %}
{% do out.variable("level", level_kind, count) %}
{% do out.variable("apart", apart_kind, count) %}
{% do out.variable("moved", moved_kind, count) %}
{% do out.variable("moving", "uint32_t") %}
{% set step = out.each("step", encoder.step[live], "k") %}
{% set observed = "k" if live.all() else out.constant("observed_at", live.nonzero()[0]) ~ "[k]" %}
{% set scale = out.each("scale", parts.scale, "k", "int32_t") %}
{% set mean_fixed = out.each("mean_fixed", parts.mean, "k", "int32_t") %}
{% set gain = out.each("gain", parts.gain, "k", "int32_t") %}
{% set x_max = out.each("x_max", parts.x_max, "k", "int32_t") %}
/* Send-on-delta. X is an observation in 1/256 steps; a channel sends events when X is further than
 * {{ encoder.threshold }} from 256 times the events that it has sent. X is computed in integers; only where
 * their error leaves open which whole number is the nearest, in double. */
{% include "nearest.c" %}
/* Trunc(x 2**k), for a shift that says k, as long as the magnitude stays below 2**29. */
static int32_t fixed_point(double x, int32_t least)
{
    uint64_t bits;
    uint32_t size;
    int32_t shift;
    (void)memcpy(&bits, &x, sizeof bits);
    shift = least - (int32_t)((bits >> 52) & 0x7FFu);
    size = 0x80000000u | (uint32_t)((bits >> 21) & 0x7FFFFFFFu);
    if (shift < 3) {
        size = 0x20000000u;
    } else if (shift > 31) {
        size = 0u;
    } else {
        size >>= (uint32_t)shift;
    }
    return ((bits >> 63) != 0u) ? -(int32_t)size : (int32_t)size;
}

/* X as NumPy computes it. */
static int32_t exact(uint32_t k, double observed)
{
{% if "[k]" not in normalised ~ step %}
    (void)k;
{% endif %}
{% print normalised %}
    x /= {{ step }};
    x *= 256.0;
    if (x > 1073741824.0) {
        x = 1073741824.0;
    } else if (x < -1073741824.0) {
        x = -1073741824.0;
    }
    return nearest(x);
}

static void encode_begin(const double *observation)
{
    uint32_t k;
    moving = 0u;
    for (k = 0u; k < {{ count }}u; k++) {
        const double observed = observation[{{ observed }}];
        /* the product with the gain is 32 by 32 bits */
        const int32_t apart_mean = fixed_point(observed, {{ scale }}) - {{ mean_fixed }};
        /* X + 1/2 in 2**-{{ parts.fraction }}u */
        const int64_t raised = ((int64_t)apart_mean * {{ gain }}) + {{ parts.rounding_offset | c("int64_t") }};
        const uint32_t rest = (uint32_t)((uint64_t)raised >> {{ parts.fraction - 16 }}u) & 65535u;
        int32_t x = (int32_t)((uint64_t)raised >> {{ parts.fraction }}u) - {{ parts.offset }};
        {{ far_kind }} far;
        if ((rest - {{ parts.tie_margin }}u) >= {{ parts.certain_width }}u) {
            x = exact(k, observed);
        }
        far = ({{ far_kind }})x - 256 * ({{ far_kind }})level[k];
        if ((far > {{ encoder.threshold }}) || (far < -{{ encoder.threshold }})) {
            /* clipped as the observation is; what is within the threshold stays there */
            const int32_t clipped = (x > {{ x_max }}) ? {{ x_max }} : x;
            x = (clipped < -{{ x_max }}) ? -{{ x_max }} : clipped;
            far = ({{ far_kind }})x - 256 * ({{ far_kind }})level[k];
            far = (far > {{ apart_max }}) ? {{ apart_max }} : far;
            far = (far < -{{ apart_max }}) ? -{{ apart_max }} : far;
            moved[moving] = ({{ moved_kind }})k;
            apart[moving] = ({{ apart_kind }})far;
            moving++;
        }
    }
}

static uint32_t encode(uint32_t timestep, {{ id_t }} *id)
{
    uint32_t count = 0u;
    uint32_t j;
    (void)timestep;
    for (j = 0u; j < moving; j++) {
        const {{ apart_kind }} size = (apart[j] < 0) ? -apart[j] : apart[j];
        const uint32_t k = moved[j];
        if (size > {{ encoder.threshold }}) {
            const {{ apart_kind }} rounded = (size + 128) >> 8;
            const uint32_t events = (rounded < {{ encoder.most }}) ? (uint32_t)rounded : {{ encoder.most }}u;
            const uint32_t first = (2u * (uint32_t){{ observed }} + ((apart[j] < 0) ? 1u : 0u)) * {{ encoder.most }}u;
{% if encoder.code == "unary" %}
            uint32_t nth;
            for (nth = 0u; nth < events; nth++) {
                id[count] = ({{ id_t }})(first + nth);
                count++;
            }
{% else %}
            id[count] = ({{ id_t }})(first + events - 1u);
            count++;
{% endif %}
            if (apart[j] < 0) {
                level[k] = ({{ level_kind }})(level[k] - (int32_t)events);
                apart[j] += ({{ apart_kind }})(256u * events);
            } else {
                level[k] = ({{ level_kind }})(level[k] + (int32_t)events);
                apart[j] -= ({{ apart_kind }})(256u * events);
            }
        }
    }
    return count;
}

{% endmacro %}
{% macro encoder_reset() %}
    {
        uint32_t k;
        for (k = 0u; k < {{ count }}u; k++) {
            level[k] = 0;
        }
        moving = 0u;
    }
{% endmacro %}
{% macro seed_function() %}{% endmacro %}

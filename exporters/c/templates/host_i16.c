{% for name, kind in (("exponent", "int8_t"), ("low", "int16_t"), ("high", "int16_t")) %}
{% do out.constant(prefix ~ "_" ~ name, int16[name], kind) %}
{% endfor %}
{% set suffix = "_i16" if doubles else "" %}
{% set host, action_kind = prefix ~ suffix, "int32_t" if choices else "double" %}
/* {{ mark }}
 * {{ origin }}
 *
 * Doubles around the 16-bit interface: for hosts that play the policy (make lib{{ suffix }}), and the
 * scales as tables. A firmware that writes its sensors as integers does not need this file.
 */
#include "{{ prefix }}_i16.h"

#include <math.h>
#include <string.h>

{{ out.text }}

/* Whether a number is neither infinite nor no number; by its bits, whatever the compiler assumes. */
static int is_finite(const double *x)
{
    uint64_t bits;
    (void)memcpy(&bits, x, sizeof bits);
    return ((uint32_t)(bits >> 32) & 0x7FF00000u) != 0x7FF00000u;
}

/* {{ prefix }}_interface of {{ prefix }}.h, for the shared object of this interface */
#ifdef __cplusplus
extern "C" {
#endif
extern const uint32_t {{ host }}_interface[4];
void {{ host }}_reset(void);
int {{ host }}_step(const double observation[{{ PREFIX }}_OBSERVATIONS], {{ action_kind }} action[{{ PREFIX }}_ACTIONS]);
#ifdef __cplusplus
}
#endif

const uint32_t {{ host }}_interface[4] = {1u, {{ PREFIX }}_OBSERVATIONS, {{ PREFIX }}_ACTIONS, {{ PREFIX }}_CHOICES};

int {{ prefix }}_to_i16(const double value[{{ PREFIX }}_OBSERVATIONS],
                  int16_t observation[{{ PREFIX }}_OBSERVATIONS])
{
    uint32_t k;
    for (k = 0u; k < {{ PREFIX }}_OBSERVATIONS; k++) {
        if (!is_finite(&value[k])) {
            return 1;
        }
    }
    for (k = 0u; k < {{ PREFIX }}_OBSERVATIONS; k++) {
        double x = ldexp(value[k], {{ prefix }}_exponent[k]);
        double whole;
        double rest;
        x = (x > {{ prefix }}_high[k]) ? {{ prefix }}_high[k] : x;
        x = (x < {{ prefix }}_low[k]) ? {{ prefix }}_low[k] : x;
        /* to the nearest, halves to even */
        whole = floor(x);
        rest = x - whole;
        if ((rest > 0.5) || ((rest == 0.5) && (fmod(whole, 2.0) != 0.0))) {
            whole += 1.0;
        }
        observation[k] = (int16_t)whole;
    }
    return 0;
}

void {{ host }}_reset(void)
{
    {{ prefix }}_reset_i16();
}

int {{ host }}_step(const double observation[{{ PREFIX }}_OBSERVATIONS], {{ action_kind }} action[{{ PREFIX }}_ACTIONS])
{
    int16_t in[{{ PREFIX }}_OBSERVATIONS];
    int16_t out[{{ PREFIX }}_ACTIONS];
    uint32_t a;
    if ({{ prefix }}_to_i16(observation, in) != 0) {
        return 1;
    }
    {{ prefix }}_act_i16(in, out);
    for (a = 0u; a < {{ PREFIX }}_ACTIONS; a++) {
        action[a] = {{ "out[a]" if choices else "(double)out[a] / 32768.0" }};
    }
    return 0;
}

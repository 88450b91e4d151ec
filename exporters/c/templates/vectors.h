/* {{ mark }} */
#ifndef {{ PREFIX }}_{{ name }}_H
#define {{ PREFIX }}_{{ name }}_H

{% for include in includes %}
#include <{{ include }}.h>
{% endfor %}

#ifdef __cplusplus
extern "C" {
#endif

{% for count, value in counts.items() %}
#define VECTOR_{{ count }} {{ value }}u
{% endfor %}

{{ out.text }}

#ifdef __cplusplus
}
#endif

#endif

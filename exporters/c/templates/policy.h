/* {{ mark }}
 * {{ origin }}
 *
 * One instance, static memory, no allocation, no recursion. Not safe for calls from two threads.
 */
#ifndef {{ PREFIX }}_H
#define {{ PREFIX }}_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define {{ PREFIX }}_INPUTS {{ plan.program.width }}u     /* channels of the input */
#define {{ PREFIX }}_EVENTS_MAX {{ plan.events_max }}u /* of them that can spike in one timestep */
#define {{ PREFIX }}_LAYERS {{ plan.layers | length }}u     /* of neurons on the chip */
{% if codec %}
#define {{ PREFIX }}_OBSERVATIONS {{ observations }}u /* numbers of an observation */
#define {{ PREFIX }}_ACTIONS {{ actions }}u      /* numbers of an action */
#define {{ PREFIX }}_TIMESTEPS {{ codec.timesteps }}u    /* of an inference */
#define {{ PREFIX }}_OK 0
#define {{ PREFIX }}_NOT_FINITE 1   /* an observation is no finite number: nothing was done */

typedef {{ "int32_t" if choices else "double" }} {{ prefix }}_action_t;
{% endif %}

typedef {{ plan.kind }} {{ int_t }}; /* states of the chip */
typedef {{ plan.id_kind }} {{ id_t }}; /* number of a channel or neuron */

/* A layer after the last timestep. */
typedef struct {
    const {{ int_t }} *current;  /* [size]; a null pointer where neurons have none */
    const {{ int_t }} *membrane; /* [size], resets included */
    const {{ id_t }} *id;        /* [count] neurons that spiked, in their order */
    const uint8_t *times;     /* [count] how often; a null pointer: once each */
    uint32_t count;
    uint32_t size;
} {{ prefix }}_layer_t;

{% if codec %}
/* For those who load this as a library: version, observations, actions, and how many actions there
 * are to choose from, 0 where an action is numbers. */
extern const uint32_t {{ prefix }}_interface[4];

/* Begin an episode: forget every state. */
void {{ prefix }}_reset(void);

{% if codec.encoder.random %}
/* Start the random numbers anew, as an episode with this seed does; 0 after a reset. */
void {{ prefix }}_seed(uint64_t seed);

{% endif %}
/* One control step: {{ PREFIX }}_OK, or {{ PREFIX }}_NOT_FINITE, which leaves all as it was.{% if not choices %} Numbers of an
 * action are in [-1, 1]: low + (x + 1) / 2 (high - low) of the environment's action space.{% endif %} */
int {{ prefix }}_step(const double observation[{{ PREFIX }}_OBSERVATIONS],
                {{ prefix }}_action_t action[{{ PREFIX }}_ACTIONS]);

{% endif %}
/* The chip alone. All states and spikes to zero. */
void {{ prefix }}_net_reset(void);

/* Begin a timestep: room for the numbers of the input channels that spike in it, in their order;
 * `times` gets room for how often each does, or a null pointer where that is once. */
{{ id_t }} *{{ prefix }}_net_begin(uint8_t **times);

/* The timestep, in which so many input channels spike. */
void {{ prefix }}_net_step(uint32_t count);

/* Layer number `index` after the last timestep; its spikes so many timesteps late, as far as they
 * are kept (0: those of the last). */
void {{ prefix }}_net_layer(uint32_t index, uint32_t late, {{ prefix }}_layer_t *view);

{% if codec %}
#ifdef {{ PREFIX }}_PROBE
/* For a self-test, which defines it: called after each timestep with the input spikes. */
void {{ prefix }}_probe(uint32_t timestep, const {{ id_t }} *id, uint32_t count);
#endif

{% endif %}
#ifdef __cplusplus
}
#endif

#endif

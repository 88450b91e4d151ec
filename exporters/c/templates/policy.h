/* @mark@
 * @origin@
 *
 * One instance, static memory, no allocation, no recursion. Not safe for calls from two threads.
 */
#ifndef @PREFIX@_H
#define @PREFIX@_H

#include <stdint.h>

#define @PREFIX@_INPUTS @inputs@u     /* channels of the input */
#define @PREFIX@_EVENTS_MAX @events_max@u /* of them that can spike in one timestep */
#define @PREFIX@_LAYERS @layers@u     /* of neurons on the chip */
@codec_defines@
typedef @int_kind@ @prefix@_int_t; /* states of the chip */
typedef @id_kind@ @prefix@_id_t; /* number of a channel or neuron */

/* A layer after the last timestep. */
typedef struct {
    const @prefix@_int_t *current;  /* [size]; a null pointer where neurons have none */
    const @prefix@_int_t *membrane; /* [size], resets included */
    const @prefix@_id_t *id;        /* [count] neurons that spiked, in their order */
    const uint8_t *times;     /* [count] how often; a null pointer: once each */
    uint32_t count;
    uint32_t size;
} @prefix@_layer_t;
@codec_calls@
/* The chip alone. All states and spikes to zero. */
void @prefix@_net_reset(void);

/* Begin a timestep: room for the numbers of the input channels that spike in it, in their order;
 * `times` gets room for how often each does, or a null pointer where that is once. */
@prefix@_id_t *@prefix@_net_begin(uint8_t **times);

/* The timestep, in which so many input channels spike. */
void @prefix@_net_step(uint32_t count);

/* Layer number `index` after the last timestep; its spikes so many timesteps late, as far as they
 * are kept (0: those of the last). */
void @prefix@_net_layer(uint32_t index, uint32_t late, @prefix@_layer_t *view);

#endif

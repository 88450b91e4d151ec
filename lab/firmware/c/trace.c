/* Keeps every spike of the last control step: pairs of a layer and a neuron, timestep by timestep. */
#include "policy.h"

#define TRACE_MAX 65536u

uint16_t trace_spikes[2u * TRACE_MAX];
uint32_t trace_count;

void policy_probe(uint32_t timestep, const policy_id_t *id, uint32_t count);

void policy_probe(uint32_t timestep, const policy_id_t *id, uint32_t count)
{
    uint32_t layer;
    (void)id;
    (void)count;
    if (timestep == 0u) {
        trace_count = 0u;
    }
    for (layer = 0u; layer < POLICY_LAYERS; layer++) {
        policy_layer_t view;
        uint32_t n;
        policy_net_layer(layer, 0u, &view);
        for (n = 0u; (n < view.count) && (trace_count < TRACE_MAX); n++) {
            trace_spikes[2u * trace_count] = (uint16_t)layer;
            trace_spikes[2u * trace_count + 1u] = (uint16_t)view.id[n];
            trace_count++;
        }
    }
}

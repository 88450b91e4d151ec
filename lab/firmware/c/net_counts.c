/* The network of an export, without its codec: a raster to how often each output neuron spikes. */
#include "policy.h"

#include "net.h"

#include <string.h>

void policy_reset(void)
{
}

int policy_step(const int8_t *raster, policy_action_t *counts)
{
    uint32_t t;
    memset(counts, 0, POLICY_ACTIONS * sizeof(*counts));
    net_net_reset();
    for (t = 0u; t < POLICY_STEPS; t++) {
        const int8_t *row = &raster[t * POLICY_WIDTH];
        uint8_t *times;
        net_id_t *id = net_net_begin(&times);
        net_layer_t view;
        uint32_t count = 0u;
        uint32_t n;
        for (n = 0u; n < POLICY_WIDTH; n++) {
            if (row[n] != 0) {
                id[count] = (net_id_t)n;
                count++;
            }
        }
        net_net_step(count);
        net_net_layer(NET_LAYERS - 1u, 0u, &view);
        for (n = 0u; n < view.count; n++) {
            counts[view.id[n]]++;
        }
    }
    return 0;
}

/* A dense policy around the network that emlearn wrote: scaled and clipped observation to action. */
#include "policy.h"

#include "net.h"
#include "scales.h"

void policy_reset(void)
{
}

static float features[POLICY_OBSERVATIONS];

int policy_step(const float *observation, policy_action_t *action)
{
    EmlError error;
    int i;
    for (i = 0; i < POLICY_OBSERVATIONS; i++) {
        const float scaled = (observation[i] - scale_mean[i]) * scale_factor[i];
        const float low = (scaled < SCALE_LOWEST) ? SCALE_LOWEST : scaled;
        features[i] = (low > SCALE_HIGHEST) ? SCALE_HIGHEST : low;
    }
#if POLICY_GEMMS == 1
    /* emlearn's network has two layers or more, so this is one of its layers */
    error = eml_net_layer_forward(&net_layers[0], features, POLICY_OBSERVATIONS, net_buf2,
                                  net.activations_length);
#else
    error = eml_net_infer(&net, features, POLICY_OBSERVATIONS);
#endif
    if (error != EmlOk) {
        return 1;
    }
#if POLICY_CHOOSES
    action[0] = eml_net_argmax(net_buf2, eml_net_outputs(&net));
#else
    for (i = 0; i < POLICY_ACTIONS; i++) {
        action[i] = net_buf2[i];
    }
#endif
    return 0;
}

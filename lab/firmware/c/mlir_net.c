/* A network of snn-mlir: a raster to how often each output neuron spikes. @...@ are filled in. */
#include "policy.h"

#include <string.h>

typedef struct {
    void *allocated, *aligned;
    intptr_t offset, size, stride;
} memref_t;

extern void _mlir_ciface_snn_forward_step(@POINTERS@);

static struct {
@FIELDS@} state;
static @ELEMENT@ out[@OUTPUT@];

void policy_reset(void)
{
}

int policy_step(const OBSERVATION *raster, policy_action_t *counts)
{
@MEMREFS@    memref_t output = {out, out, 0, @OUTPUT@, 1};
    int t, n;
    memset(&state, 0, sizeof state);
    memset(counts, 0, POLICY_ACTIONS * sizeof(*counts));
    for (t = 0; t < POLICY_STEPS; t++) {
        OBSERVATION *row = (OBSERVATION *)&raster[t * POLICY_WIDTH];
        memref_t input = {row, row, 0, POLICY_WIDTH, 1};
        _mlir_ciface_snn_forward_step(&input, @STATES@&output);
        for (n = 0; n < POLICY_ACTIONS; n++) {
            counts[n] += (policy_action_t)out[n];
        }
    }
    return 0;
}

/* @mark@
 * @origin@
 *
 * The chip's integers. Spikes are lists of the neurons that spike, and only their synapses are
 * added up. Layers are named l0, l1, ... in the order in which they are computed.
 */
#include "@prefix@.h"

/* shifts of negative numbers to the right have to keep the sign, as all compilers of note do */
typedef char @prefix@_shifts_keep_the_sign[((-1) >> 1) == -1 ? 1 : -1];

@declarations@

@functions@
void @prefix@_net_reset(void)
{
    uint32_t n;
@reset@
}

@prefix@_id_t *@prefix@_net_begin(uint8_t **times)
{
@advance@
    *times = @input_times@;
    return in_id[@begin_slot@];
}

void @prefix@_net_step(uint32_t count)
{
    in_count[@begin_slot@] = (@input_count_kind@)count;
@steps@
}

void @prefix@_net_layer(uint32_t index, uint32_t late, @prefix@_layer_t *view)
{
    (void)late;
    view->id = 0;
    view->times = 0;
    view->count = 0u;
    switch (index) {
@views@
    default:
        view->size = 0u;
        view->current = 0;
        view->membrane = 0;
        break;
    }
}

/* @mark@
 * @origin@
 *
 * A network of 8-bit weights, 16-bit inputs and 32-bit sums, @weights@ weights that are not 0. Each
 * constant is a weight times the power of two of its input; the normaliser is in the first layer.
 */
#include "@prefix@_i16.h"

/* two products of 16 bits in one instruction: Cortex-M4, M7, M33 and later */
#if defined(__ARM_FEATURE_SIMD32) && defined(__GNUC__)
#include <arm_acle.h>
#define @PREFIX@_PAIRS 1
static int32_t pair_at(const int16_t *x)
{
    int32_t both;
    __builtin_memcpy(&both, x, sizeof both);
    return both;
}
#endif

/* shifts of negative numbers to the right have to keep the sign, as all compilers of note do */
typedef char @prefix@_shifts_keep_the_sign[((-1) >> 1) == -1 ? 1 : -1];

@declarations@

@layers@
@tanh@
void @prefix@_reset_i16(void)
{
    /* nothing is remembered */
}

void @prefix@_net_i16(const int16_t observation[@PREFIX@_OBSERVATIONS], int32_t score[@scores@])
{
@net@
}

void @prefix@_act_i16(const int16_t observation[@PREFIX@_OBSERVATIONS],
                    int16_t action[@PREFIX@_ACTIONS])
{
    int32_t score[@scores@];
    uint32_t a;
@chosen@
    @prefix@_net_i16(observation, score);
@act@
}

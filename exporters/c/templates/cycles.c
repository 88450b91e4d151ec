/* @mark@
 *
 * An example: cycles of a control step on recorded observations. Build it with the sources of the
 * policy and the start-up code of the board; stop in `done` with a debugger and read `cycles`.
 */
#include "@header@"
#include "cycles.h"
#include "@vectors@"

volatile struct {
    uint32_t least;
    uint32_t mean;
    uint32_t most;
    uint32_t steps; /* 0: the core has no counter */
} cycles;

static void done(void)
{
    for (;;) {
        __asm__ volatile("nop");
    }
}

int main(void)
{
    @action_type@ action[@PREFIX@_ACTIONS];
    uint32_t least = 0xFFFFFFFFu;
    uint32_t most = 0u;
    uint32_t i;
    uint64_t total = 0u;
    if (cycles_start() != 0) {
        done();
    }
    @reset_call@;
    for (i = 0u; i < @steps_define@; i++) {
        const uint32_t before = cycles_now();
        uint32_t spent;
        @step_call@;
        spent = cycles_between(before, cycles_now());
        least = (spent < least) ? spent : least;
        most = (spent > most) ? spent : most;
        total += spent;
    }
    cycles.least = least;
    cycles.mean = (uint32_t)(total / @steps_define@);
    cycles.most = most;
    cycles.steps = @steps_define@;
    done();
    return 0;
}

/* {{ mark }}
 *
 * Runs the recorded inferences, and compares every input spike, current, membrane and output spike
 * with what the interpreter computed, bit for bit{{ ", and every action to 1e-12" if codec and not choices }}.
 */
#include "{{ prefix }}.h"
#include "vectors.h"

#include <stdio.h>
#include <stdlib.h>

static unsigned long compared;
static unsigned long differing;

/* One more number, and the first that differs in words. */
static void compare(const char *what, uint32_t row, uint32_t layer, uint32_t n, long long found,
                    long long wanted)
{
    compared++;
    if (found != wanted) {
        if (differing == 0u) {
            (void)printf("row %lu layer %lu number %lu: %s is %lld, and not %lld\n",
                         (unsigned long)row, (unsigned long)layer, (unsigned long)n, what, found,
                         wanted);
        }
        differing++;
    }
}

static void compare_layer(uint32_t row, uint32_t index)
{
    {{ prefix }}_layer_t view;
    uint32_t n;
    uint32_t next = 0u;
    {{ prefix }}_net_layer(index, 0u, &view);
    for (n = 0u; n < view.size; n++) {
        const size_t place = (size_t)row * VECTOR_NEURONS + vector_first[index] + n;
        uint32_t spikes = 0u;
        if ((next < view.count) && (view.id[next] == n)) {
            spikes = (view.times == NULL) ? 1u : view.times[next];
            next++;
        }
        compare("a spike", row, index, n, (long long)spikes, (long long)vector_spikes[place]);
        compare("a membrane", row, index, n, view.membrane[n], vector_membrane[place]);
        if (view.current != NULL) {
            compare("a current", row, index, n, view.current[n], vector_current[place]);
        }
    }
    compare("the number of spikes", row, index, 0u, (long long)next, (long long)view.count);
}

static void compare_row(uint32_t row)
{
    uint32_t index;
    for (index = 0u; index < {{ PREFIX }}_LAYERS; index++) {
        compare_layer(row, index);
    }
}

{% include "run_codec.c" if codec else "run_network.c" %}

int main(void)
{
    run();
    (void)printf("%lu numbers compared, %lu differ\n", compared, differing);
    return ((differing == 0u) && (compared > 0u)) ? EXIT_SUCCESS : EXIT_FAILURE;
}

/* {{ mark }}
 * {{ origin }}
 *
 * The policy with observations and actions as 16-bit integers. Observation k stands for
 * value 2**{{ prefix }}_exponent[k], rounded, and kept within {{ prefix }}_low[k] and {{ prefix }}_high[k] (the
 * range that training clipped to); README.md has them as a table. Actions are {{ "an index" if choices else "Q15: 32767 stands for 1" }}.
 *
 * One instance, static memory, no allocation, no recursion, no floating point.
 */
#ifndef {{ PREFIX }}_I16_H
#define {{ PREFIX }}_I16_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#ifndef {{ PREFIX }}_OBSERVATIONS
#define {{ PREFIX }}_OBSERVATIONS {{ observations }}u
#define {{ PREFIX }}_ACTIONS {{ actions }}u
#endif
#define {{ PREFIX }}_CHOICES {{ choices }}u /* actions to choose from; 0: an action is numbers */

/* An episode begins. */
void {{ prefix }}_reset_i16(void);

/* The action for an observation. */
void {{ prefix }}_act_i16(const int16_t observation[{{ PREFIX }}_OBSERVATIONS],
                    int16_t action[{{ PREFIX }}_ACTIONS]);

{% if not doubles %}
/* The network alone: the sums of its last layer. */
void {{ prefix }}_net_i16(const int16_t observation[{{ PREFIX }}_OBSERVATIONS], int32_t score[{{ scores }}]);

{% endif %}
/* In host_i16.c: the scales, and the observation from numbers in units of training. Returns 0, or 1
 * where one of them is not finite, and then writes nothing. */
extern const int8_t {{ prefix }}_exponent[{{ PREFIX }}_OBSERVATIONS];
extern const int16_t {{ prefix }}_low[{{ PREFIX }}_OBSERVATIONS];
extern const int16_t {{ prefix }}_high[{{ PREFIX }}_OBSERVATIONS];
int {{ prefix }}_to_i16(const double value[{{ PREFIX }}_OBSERVATIONS],
                  int16_t observation[{{ PREFIX }}_OBSERVATIONS]);

#ifdef __cplusplus
}
#endif

#endif

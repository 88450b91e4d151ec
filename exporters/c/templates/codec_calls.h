
/* For those who load this as a library: version, observations, actions, and how many actions there
 * are to choose from, 0 where an action is numbers. */
extern const uint32_t @prefix@_interface[4];

/* Begin an episode: forget every state. */
void @prefix@_reset(void);
@seed_call@
/* One control step: @PREFIX@_OK, or @PREFIX@_NOT_FINITE, which leaves all as it was. */
int @prefix@_step(const double observation[@PREFIX@_OBSERVATIONS],
                @prefix@_action_t action[@PREFIX@_ACTIONS]);


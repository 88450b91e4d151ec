
/* Begin an episode: forget every state. */
void @prefix@_reset(void);
@seed_call@
/* One control step: @PREFIX@_OK, or @PREFIX@_NOT_FINITE, which leaves all as it was. */
int @prefix@_step(const double observation[@PREFIX@_OBSERVATIONS],
                @prefix@_action_t action[@PREFIX@_ACTIONS]);


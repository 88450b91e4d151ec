#define @PREFIX@_OBSERVATIONS @observations@u /* numbers of an observation */
#define @PREFIX@_ACTIONS @actions@u      /* numbers of an action */
#define @PREFIX@_TIMESTEPS @timesteps@u    /* of an inference */
#define @PREFIX@_OK 0
#define @PREFIX@_NOT_FINITE 1   /* an observation is no finite number: nothing was done */

typedef @action_kind@ @prefix@_action_t;

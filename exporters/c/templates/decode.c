@squash_function@
static void decode_begin(void)
{
    uint32_t n;
@clear@
}

/* What leaves the chip in a timestep is added up. */
static void decode_add(void)
{
    @prefix@_layer_t view;
    uint32_t n;
@add@
}

static void decode_end(@prefix@_action_t *action)
{
    double score[@scores@u];
    uint32_t n;
    uint32_t a;
    for (a = 0u; a < @scores@u; a++) {
        score[a] = @score_start@;
    }
@weigh@
@act@
}

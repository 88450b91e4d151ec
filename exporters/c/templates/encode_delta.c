/* Send-on-delta. X is an observation in 1/256 steps; a channel sends events when X is further than
 * @threshold@ from 256 times the events that it has sent. Observations within bounds, which are
 * kept as the upper halves of doubles, do not need X: the bounds lie half of 1/256 step inside. */
@nearest@
static void keep_bounds(uint32_t k)
{
    const double unit = @unit@;
    const double centre = @mean_plus@unit * (double)level[k];
    const double reach = unit * @reach@;
    low_key[k] = key_of(centre - reach);
    high_key[k] = key_of(centre + reach);
}

/* 256ths of steps from the level of a channel, no further than what changes its events. */
static @apart_kind@ apart_from(uint32_t k, double observed)
{
    double x = @normalised@;
    int64_t apart;
@clip@
    x /= @step@;
    x *= 256.0;
    if (x > 1073741824.0) {
        x = 1073741824.0;
    } else if (x < -1073741824.0) {
        x = -1073741824.0;
    }
    apart = (int64_t)nearest(x) - 256 * (int64_t)level[k];
    if (apart > @apart_max@) {
        apart = @apart_max@;
    } else if (apart < -@apart_max@) {
        apart = -@apart_max@;
    }
    return (@apart_kind@)apart;
}

static void encode_begin(const double *observation)
{
    uint32_t k;
    moving = 0u;
    for (k = 0u; k < @channels@u; k++) {
        const double observed = observation[@observed@];
        const int32_t key = key_of(observed);
        if ((key <= low_key[k]) || (key >= high_key[k])) {
            moved[moving] = (@moved_kind@)k;
            apart[moving] = apart_from(k, observed);
            moving++;
        }
    }
}

static uint32_t encode(uint32_t timestep, @prefix@_id_t *id)
{
    uint32_t count = 0u;
    uint32_t j;
    for (j = 0u; j < moving; j++) {
        const @apart_kind@ size = (apart[j] < 0) ? -apart[j] : apart[j];
        const uint32_t k = moved[j];
        if (size > @threshold@) {
            const @apart_kind@ rounded = (size + 128) >> 8;
            const uint32_t events = (rounded < @most@) ? (uint32_t)rounded : @most@u;
            const uint32_t first = (2u * (uint32_t)@observed@ + ((apart[j] < 0) ? 1u : 0u)) * @most@u;
@emit@
            if (apart[j] < 0) {
                level[k] -= (int32_t)events;
                apart[j] += (@apart_kind@)(256u * events);
            } else {
                level[k] += (int32_t)events;
                apart[j] -= (@apart_kind@)(256u * events);
            }
        }
        if (timestep == (@PREFIX@_TIMESTEPS - 1u)) {
            keep_bounds(k);
        }
    }
    return count;
}


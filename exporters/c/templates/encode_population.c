/* Population code: each channel has a receptive field, A = exp(u) with u = -1/2 ((x - m) / s)**2,
 * and integrates it. Few patterns of spikes are possible; u, of which A never falls, is looked up
 * among the bounds between them, so that no exponential is computed. */
static void encode_begin(const double *observation)
{
    uint32_t i;
    uint32_t p;
    active = 0u;
    for (i = 0u; i < @PREFIX@_OBSERVATIONS; i++) {
        const uint32_t k = i;
        const double observed = observation[i];
        double x = @normalised@;
@clip@
        for (p = 0u; p < @populations@u; p++) {
            const uint32_t n = (i * @populations@u) + p;
            double u = (x - @centre@) / @width@;
            uint32_t pattern = 0u;
            u *= u;
            u *= -0.5;
            while ((pattern < @patterns@u) && (u > pattern_above[pattern])) {
                pattern++;
            }
            if (pattern_spikes[pattern] != 0u) {
                channel[active] = (@prefix@_id_t)n;
                shown[active] = (@shown_kind@)pattern;
                active++;
            }
        }
    }
}

static uint32_t encode(uint32_t timestep, @prefix@_id_t *id)
{
    uint32_t count = 0u;
    uint32_t j;
    for (j = 0u; j < active; j++) {
        id[count] = channel[j];
        count += (uint32_t)((pattern_spikes[shown[j]] >> timestep) & 1u);
    }
    return count;
}


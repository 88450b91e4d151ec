/* Rate code in 8 bits: a number between low and high becomes 0 to 256 spikes in 256 timesteps. */
@nearest@
static void encode_begin(const double *observation)
{
    uint32_t k;
    for (k = 0u; k < @channels@u; k++) {
        const double observed = observation[k];
        double x = @normalised@;
@clip@
        x = (x - @low@) / @range@;
        if (x < 0.0) {
            x = 0.0;
        } else if (x > 1.0) {
            x = 1.0;
        }
        rate[k] = (uint16_t)nearest(x * 256.0);
@begin@
    }
}

static uint32_t encode(uint32_t timestep, @prefix@_id_t *id)
{
    uint32_t count = 0u;
    uint32_t k;
    (void)timestep;
    for (k = 0u; k < @channels@u; k++) {
@spike@
    }
    return count;
}


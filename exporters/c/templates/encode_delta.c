/* Send-on-delta. X is an observation in 1/256 steps; a channel sends events when X is further than
 * @threshold@ from 256 times the events that it has sent. X is computed in integers; only where
 * their error leaves open which whole number is the nearest, in double. */
@nearest@
/* Trunc(x 2**k), for a shift that says k, as long as the magnitude stays below 2**29. */
static int32_t fixed(double x, int32_t scale)
{
    uint64_t bits;
    uint32_t size;
    int32_t shift;
    (void)memcpy(&bits, &x, sizeof bits);
    shift = scale - (int32_t)((bits >> 52) & 0x7FFu);
    size = 0x80000000u | (uint32_t)((bits >> 21) & 0x7FFFFFFFu);
    if (shift < 3) {
        size = 0x20000000u;
    } else if (shift > 31) {
        size = 0u;
    } else {
        size >>= (uint32_t)shift;
    }
    return ((bits >> 63) != 0u) ? -(int32_t)size : (int32_t)size;
}

/* X as NumPy computes it. */
static int32_t exact(uint32_t k, double observed)
{
    double x = @normalised@;
@clip@
    x /= @step@;
    x *= 256.0;
    if (x > 1073741824.0) {
        x = 1073741824.0;
    } else if (x < -1073741824.0) {
        x = -1073741824.0;
    }
    return nearest(x);
}

static void encode_begin(const double *observation)
{
    uint32_t k;
    moving = 0u;
    for (k = 0u; k < @channels@u; k++) {
        const double observed = observation[@observed@];
        /* the product with the gain is 32 by 32 bits */
        const int32_t apart_mean = fixed(observed, @scale@) - @mean_fixed@;
        /* X + 1/2 in 2**-@fraction@ */
        const int64_t raised = ((int64_t)apart_mean * @gain@) + @raise@;
        const uint32_t rest = (uint32_t)((uint64_t)raised >> @rest_shift@) & @rest_mask@u;
        int32_t x = (int32_t)((uint64_t)raised >> @fraction@) - @base@;
        @far_kind@ far;
        if ((rest - @unsure@u) >= @sure@u) {
            x = exact(k, observed);
        }
        far = (@far_kind@)x - 256 * (@far_kind@)level[k];
        if ((far > @threshold@) || (far < -@threshold@)) {
            /* clipped as the observation is; what is within the threshold stays there */
            const int32_t clipped = (x > @x_max@) ? @x_max@ : x;
            x = (clipped < -@x_max@) ? -@x_max@ : clipped;
            far = (@far_kind@)x - 256 * (@far_kind@)level[k];
            far = (far > @apart_max@) ? @apart_max@ : far;
            far = (far < -@apart_max@) ? -@apart_max@ : far;
            moved[moving] = (@moved_kind@)k;
            apart[moving] = (@apart_kind@)far;
            moving++;
        }
    }
}

static uint32_t encode(uint32_t timestep, @prefix@_id_t *id)
{
    uint32_t count = 0u;
    uint32_t j;
    (void)timestep;
    for (j = 0u; j < moving; j++) {
        const @apart_kind@ size = (apart[j] < 0) ? -apart[j] : apart[j];
        const uint32_t k = moved[j];
        if (size > @threshold@) {
            const @apart_kind@ rounded = (size + 128) >> 8;
            const uint32_t events = (rounded < @most@) ? (uint32_t)rounded : @most@u;
            const uint32_t first = (2u * (uint32_t)@observed@ + ((apart[j] < 0) ? 1u : 0u)) * @most@u;
@emit@
            if (apart[j] < 0) {
                level[k] = (@level_kind@)(level[k] - (int32_t)events);
                apart[j] += (@apart_kind@)(256u * events);
            } else {
                level[k] = (@level_kind@)(level[k] + (int32_t)events);
                apart[j] -= (@apart_kind@)(256u * events);
            }
        }
    }
    return count;
}


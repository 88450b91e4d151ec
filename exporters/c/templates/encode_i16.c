/* Send-on-delta. With X = (gain o + offset) >> shift, an observation in 1/256 steps, and level q,
 * centre is offset + ((@threshold@ - 256 q) << shift), so that the sum gain o + centre is from 0 to
 * below (2 x @threshold@ + 1) << shift where X is within @threshold@ of 256 q: nothing is sent.
 * `sent` is for the others. */
static uint32_t sent(uint32_t k, int32_t sum, @prefix@_id_t *id, uint32_t count)
{
    const int32_t at = 256 * (int32_t)level[k];
    int32_t x = (sum >> @shift@) - @threshold@ + at;
    int32_t size;
    int32_t events;
    x = (x > @x_max@) ? @x_max@ : x;
    x = (x < -@x_max@) ? -@x_max@ : x;
    size = (x < at) ? (at - x) : (x - at);
    if (size > @threshold@) {
        uint32_t first = @first@;
        events = (size + 128) >> 8;
        events = (events < @most@) ? events : @most@;
        if (x < at) {
            first += @most@u;
            level[k] = (@level_kind@)(level[k] - events);
            centre[k] += (events * 256) * ((int32_t)1 << @shift@);
        } else {
            level[k] = (@level_kind@)(level[k] + events);
            centre[k] -= (events * 256) * ((int32_t)1 << @shift@);
        }
@emit@
    }
    return count;
}

static uint32_t encode(const int16_t *observation, @prefix@_id_t *id)
{
    uint32_t count = 0u;
    int32_t sum;
@channels_of@
    return count;
}


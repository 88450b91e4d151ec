/* Q15 of tanh of a score in 2**-@fraction@, within 5 units: straight lines between 32 entries for each
 * unit of the score. */
static int16_t tanh_q15(int32_t score)
{
    const uint32_t size = (score < 0) ? (uint32_t)(-score) : (uint32_t)score;
    const uint32_t place = size >> @place_shift@u;
    int32_t y = 32767;
    if (place < @last@u) {
        const int32_t between = (int32_t)((size >> @between_shift@u) & 1023u);
        y = tanh_of[place];
        y += ((tanh_of[place + 1u] - y) * between + 512) >> 10;
    }
    return (int16_t)((score < 0) ? -y : y);
}


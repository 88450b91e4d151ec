static void run(void)
{
    uint32_t row;
    uint32_t i;
    for (row = 0u; row < VECTOR_ROWS; row++) {
        uint8_t *times;
        {{ id_t }} *id;
        const uint32_t first = vector_events[row];
        const uint32_t count = vector_events[row + 1u] - first;
        if ((row % VECTOR_RESET) == 0u) {
            {{ prefix }}_net_reset();
        }
        id = {{ prefix }}_net_begin(&times);
        for (i = 0u; i < count; i++) {
            id[i] = ({{ id_t }})vector_channels[first + i];
            if (times != NULL) {
                times[i] = vector_times[first + i];
            }
        }
        {{ prefix }}_net_step(count);
        compare_row(row);
    }
}

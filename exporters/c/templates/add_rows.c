static void @name@(const @id_kind@ *id, uint32_t count)
{
    uint32_t i = 0u;
    uint32_t n;
    for (; (i + @together@u) <= count; i += @together@u) {
        const @stored@ *row[@together@];
        for (n = 0u; n < @together@u; n++) {
            row[n] = &@table@[id[i + n] * @neurons@u];
        }
        for (n = 0u; n < @neurons@u; n++) {
            sums[n] += (@sum_kind@)(@rows@);
        }
    }
    for (; i < count; i++) {
        const @stored@ *row = &@table@[id[i] * @neurons@u];
        for (n = 0u; n < @neurons@u; n++) {
            sums[n] += row[n];
        }
    }
}


static uint32_t mixed(uint32_t x)
{
    x = (x ^ (x >> 16)) * 0x85EBCA6Bu;
    x = (x ^ (x >> 13)) * 0xC2B2AE35u;
    return x ^ (x >> 16);
}

void @prefix@_seed(uint64_t seed)
{
    const uint32_t low = (uint32_t)(seed & 0xFFFFFFFFu);
    const uint32_t begun = mixed(mixed(low + 0x9E3779B9u) + (uint32_t)(seed >> 32));
    uint32_t k;
    for (k = 0u; k < @channels@u; k++) {
        const uint32_t first = mixed(begun + k);
        random[k] = (first == 0u) ? 1u : first;
    }
}

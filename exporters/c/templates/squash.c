/* The upper half of a product. */
static uint64_t high(uint64_t a, uint64_t b)
{
    const uint32_t a0 = (uint32_t)a;
    const uint32_t a1 = (uint32_t)(a >> 32);
    const uint32_t b0 = (uint32_t)b;
    const uint32_t b1 = (uint32_t)(b >> 32);
    const uint64_t middle = ((uint64_t)a1 * b0) + (((uint64_t)a0 * b0) >> 32);
    const uint64_t other = ((uint64_t)a0 * b1) + (uint32_t)middle;
    return ((uint64_t)a1 * b1) + (middle >> 32) + (other >> 32);
}

/* The product of two numbers in 2**-32. */
static uint32_t product_of(uint32_t a, uint32_t b)
{
    return (uint32_t)(((uint64_t)a * b) >> 32);
}

/* (h - tanh(h)) / h in 2**-40, for h**2 in 2**-40: h**2/3 - 2 h**4/15 + 17 h**6/315 - 62 h**8/2835 */
static uint32_t bend(uint32_t h2)
{
    uint32_t a = 93928738u; /* 62/2835 in 2**-32 */
    a = 231791886u - (product_of(a, h2) >> 8);
    a = 572662306u - (product_of(a, h2) >> 8);
    a = 1431655765u - (product_of(a, h2) >> 8);
    return product_of(a, h2);
}

/* r / (1 + r) = r (1 - r) (1 + r**2) (1 + r**4) ..., both in 2**-36. */
static uint32_t shared(uint32_t r)
{
    const uint32_t one = 0x80000000u;
    const uint32_t r2 = product_of(r, r);
    const uint32_t r4 = product_of(r2, r2);
    uint32_t product = product_of(one - (r >> 5), one + (r2 >> 9)) << 1;
    product = product_of(product, one + (r4 >> 17)) << 1;
    return product_of(r, product) << 1;
}

/* tanh in integers, within 3e-13: from the nearest k/16 below, by the addition theorem
 * tanh(x + h) = t + (1 - t**2) u / (1 + t u)        t = tanh(x), u = tanh(h), in 2**-64 */
static double squash(double x)
{
    uint64_t bits;
    uint64_t size;
    uint64_t sign;
    uint32_t exponent;
    (void)memcpy(&bits, &x, sizeof bits);
    exponent = (uint32_t)(bits >> 52) & 0x7FFu;
    if (exponent < 1003u) {
        return x; /* below 2**-20 */
    }
    size = (bits & UINT64_C(0xFFFFFFFFFFFFF)) | UINT64_C(0x10000000000000);
    if (exponent > 1026u) {
        size = UINT64_MAX; /* 16 and more */
    } else if (exponent >= 1019u) {
        size <<= exponent - 1019u; /* in 2**-56 */
    } else {
        size >>= 1019u - exponent;
    }
    sign = bits & UINT64_C(0x8000000000000000);
    if ((size >> 52) >= 240u) {
        x = 1.0; /* 15 and more */
        (void)memcpy(&bits, &x, sizeof bits);
    } else {
        const uint32_t k = (uint32_t)(size >> 52);
        const uint64_t h = (size & UINT64_C(0xFFFFFFFFFFFFF)) << 8;
        const uint64_t loss = ((uint64_t)(uint32_t)(h >> 28) * bend((uint32_t)(high(h, h) >> 24))) >> 12;
        const uint64_t u = h - loss;
        uint64_t result = u;
        if (k != 0u) {
            const uint64_t t = tanh_of[k];
            const uint64_t r = high(t, u);
            const uint64_t ru = high(r, u);
            const uint64_t later = ((uint64_t)(uint32_t)(ru >> 24) * shared((uint32_t)(r >> 28))) >> 12;
            result = t + high((uint64_t)0 - high(t, t), u - (ru - later));
        }
        x = (double)result;
        (void)memcpy(&bits, &x, sizeof bits);
        bits -= (uint64_t)64 << 52; /* times 2**-64 */
    }
    bits |= sign;
    (void)memcpy(&x, &bits, sizeof x);
    return x;
}


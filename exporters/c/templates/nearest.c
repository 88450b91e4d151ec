/* The nearest whole number, halves to even; for magnitudes below 2**31 - 1. */
static int32_t nearest(double x)
{
    int32_t whole = (int32_t)x;
    const double rest = x - (double)whole;
    const int odd = (whole % 2) != 0;
    if ((rest > 0.5) || ((rest == 0.5) && odd)) {
        whole++;
    } else if ((rest < -0.5) || ((rest == -0.5) && odd)) {
        whole--;
    }
    return whole;
}


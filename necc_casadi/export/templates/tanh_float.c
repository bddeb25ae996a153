/* tanh of LANES numbers and its derivative 1 - tanh^2, without a branch or a library call.
 *
 * x = n ln2/2 + r with |r| <= ln2/4; tanh r = N/D, Lambert's continued fraction cut after r^3;
 * exp 2x = 2^n (D + N)/(D - N), hence tanh x = ((2^n - 1) D + (2^n + 1) N)
 *                                            / ((2^n + 1) D + (2^n - 1) N).
 * Adding 1.5 2^23 rounds to an integer and leaves it in the low bits. NaN stays NaN.
 */
static void activate_tanh(necc_real *restrict a, necc_real *restrict slope)
{
    const float shift = 12582912.0f;
    float r[LANES], scale[LANES];
    uint32_t bits[LANES];
    int k;
    for (k = 0; k < LANES; ++k) {
        float x = a[k];
        x = x > 10.0f ? 10.0f : x; /* tanh 10 rounds to 1 */
        x = x < -10.0f ? -10.0f : x;
        r[k] = x;
        scale[k] = x * 2.88539f + shift;
    }
    memcpy(bits, scale, sizeof bits);
    for (k = 0; k < LANES; ++k) {
        const float n = scale[k] - shift;
        r[k] = (r[k] - n * 0.34657288f) - n * 7.143034e-07f;
        bits[k] = (bits[k] + 127u) << 23;
    }
    memcpy(scale, bits, sizeof scale);
    for (k = 0; k < LANES; ++k) {
        const float s = r[k] * r[k];
        const float N = r[k] * (15.0f + s);
        const float D = 15.0f + s * 6.0f;
        const float plus = scale[k] + 1.0f, minus = scale[k] - 1.0f;
        const float t = (minus * D + plus * N) / (plus * D + minus * N);
        a[k] = t;
        slope[k] = 1.0f - t * t;
    }
}

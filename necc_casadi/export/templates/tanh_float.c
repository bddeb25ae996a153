/* tanh of LANES numbers and its derivative 1 - tanh^2, without a branch or a library call.
 *
 * x = n ln2/2 + r with |r| <= ln2/4; tanh r = N/D, Lambert's continued fraction cut after r^3;
 * exp 2x = 2^n (D + N)/(D - N), hence tanh x = ((2^n - 1) D + (2^n + 1) N)
 *                                            / ((2^n + 1) D + (2^n - 1) N).
 * Adding 1.5 2^23 rounds to an integer and leaves it in the low bits. NaN stays NaN. One comparison
 * a loop, since compilers make branches of two.
 */
static void activate_tanh(necc_real *restrict a, necc_real *restrict slope)
{
    const float shift = 12582912.0f;
    int k;
    for (k = 0; k < LANES; ++k) {
        a[k] = a[k] > 10.0f ? 10.0f : a[k]; /* tanh 10 rounds to 1 */
    }
    for (k = 0; k < LANES; ++k) {
        a[k] = a[k] < -10.0f ? -10.0f : a[k];
    }
    for (k = 0; k < LANES; ++k) {
        union { float number; uint32_t bits; } scale;
        const float rounded = a[k] * 2.88539f + shift;
        const float n = rounded - shift;
        const float r = (a[k] - n * 0.34657288f) - n * 7.143034e-07f;
        const float s = r * r;
        const float N = r * (15.0f + s);
        const float D = 15.0f + s * 6.0f;
        float plus, minus, t;
        scale.number = rounded;
        scale.bits = (scale.bits + 127u) << 23;
        plus = scale.number + 1.0f;
        minus = scale.number - 1.0f;
        t = (minus * D + plus * N) / (plus * D + minus * N);
        a[k] = t;
        slope[k] = 1.0f - t * t;
    }
}

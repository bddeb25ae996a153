/* tanh of LANES numbers and its derivative 1 - tanh^2, without a branch or a library call.
 *
 * x = n ln2/2 + r with |r| <= ln2/4; tanh r = N/D, Lambert's continued fraction cut after r^7;
 * exp 2x = 2^n (D + N)/(D - N), hence tanh x = ((2^n - 1) D + (2^n + 1) N)
 *                                            / ((2^n + 1) D + (2^n - 1) N).
 * Adding 1.5 2^52 rounds to an integer and leaves it in the low bits. NaN stays NaN.
 */
static void activate_tanh(necc_real *restrict a, necc_real *restrict slope)
{
    const double shift = 6755399441055744.0;
    double r[LANES], scale[LANES];
    uint64_t bits[LANES];
    int k;
    for (k = 0; k < LANES; ++k) {
        double x = a[k];
        x = x > 20.0 ? 20.0 : x; /* tanh 20 rounds to 1 */
        x = x < -20.0 ? -20.0 : x;
        r[k] = x;
        scale[k] = x * 2.8853900817779268 + shift;
    }
    memcpy(bits, scale, sizeof bits);
    for (k = 0; k < LANES; ++k) {
        const double n = scale[k] - shift;
        r[k] = (r[k] - n * 0.3465735902799665) - n * 6.17333302073885e-15;
        bits[k] = (bits[k] + 1023u) << 52;
    }
    memcpy(scale, bits, sizeof scale);
    for (k = 0; k < LANES; ++k) {
        const double s = r[k] * r[k];
        const double N = r[k] * (135135.0 + s * (17325.0 + s * (378.0 + s)));
        const double D = 135135.0 + s * (62370.0 + s * (3150.0 + s * 28.0));
        const double plus = scale[k] + 1.0, minus = scale[k] - 1.0;
        const double t = (minus * D + plus * N) / (plus * D + minus * N);
        a[k] = t;
        slope[k] = 1.0 - t * t;
    }
}

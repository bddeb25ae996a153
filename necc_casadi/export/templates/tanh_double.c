/* tanh of LANES numbers and its derivative 1 - tanh^2, without a branch or a library call.
 *
 * x = n ln2/2 + r with |r| <= ln2/4; tanh r = N/D, Lambert's continued fraction cut after r^7;
 * exp 2x = 2^n (D + N)/(D - N), hence tanh x = ((2^n - 1) D + (2^n + 1) N)
 *                                            / ((2^n + 1) D + (2^n - 1) N).
 * Adding 1.5 2^52 rounds to an integer and leaves it in the low bits. NaN stays NaN. One comparison
 * a loop, since compilers make branches of two.
 */
static void activate_tanh(necc_real *restrict a, necc_real *restrict slope)
{
    const double shift = 6755399441055744.0;
    int k;
    for (k = 0; k < LANES; ++k) {
        a[k] = a[k] > 20.0 ? 20.0 : a[k]; /* tanh 20 rounds to 1 */
    }
    for (k = 0; k < LANES; ++k) {
        a[k] = a[k] < -20.0 ? -20.0 : a[k];
    }
    for (k = 0; k < LANES; ++k) {
        union { double number; uint64_t bits; } scale;
        const double rounded = a[k] * 2.8853900817779268 + shift;
        const double n = rounded - shift;
        const double r = (a[k] - n * 0.3465735902799665) - n * 6.17333302073885e-15;
        const double s = r * r;
        const double N = r * (135135.0 + s * (17325.0 + s * (378.0 + s)));
        const double D = 135135.0 + s * (62370.0 + s * (3150.0 + s * 28.0));
        double plus, minus, t;
        scale.number = rounded;
        scale.bits = (scale.bits + 1023u) << 52;
        plus = scale.number + 1.0;
        minus = scale.number - 1.0;
        t = (minus * D + plus * N) / (plus * D + minus * N);
        a[k] = t;
        slope[k] = 1.0 - t * t;
    }
}

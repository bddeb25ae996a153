/* sin of LANES numbers and its derivative cos, without a library call while |x| <= 5000.
 *
 * x = n pi/2 + r, pi/2 in three parts (Cody and Waite) so that n times the first two is exact;
 * then the Taylor polynomials on |r| <= pi/4, exchanged and signed by the two low bits of n.
 */
static void activate_sin(necc_real *restrict a, necc_real *restrict slope)
{
    const float shift = 12582912.0f;
    int k, large = 0;
    for (k = 0; k < LANES; ++k) {
        large |= (fabsf(a[k]) > 5000.0f) ? 1 : 0;
    }
    if (large != 0) {
        for (k = 0; k < LANES; ++k) {
            slope[k] = cosf(a[k]);
            a[k] = sinf(a[k]);
        }
        return;
    }
    for (k = 0; k < LANES; ++k) {
        union { float number; uint32_t bits; } scale;
        const float rounded = a[k] * 0.63661975f + shift;
        const float n = rounded - shift;
        const float r = ((a[k] - n * 1.5703125f) - n * 0.0004837513f) - n * 7.54979e-08f;
        const float s = r * r;
        const float sine = r + r * s * (-1.0f / 6.0f + s * (1.0f / 120.0f
            + s * (-1.0f / 5040.0f + s * (1.0f / 362880.0f))));
        const float cosine = 1.0f + s * (-1.0f / 2.0f + s * (1.0f / 24.0f + s * (-1.0f / 720.0f
            + s * (1.0f / 40320.0f))));
        float value, other;
        scale.number = rounded;
        value = (scale.bits & 1u) != 0u ? cosine : sine;
        other = (scale.bits & 1u) != 0u ? sine : cosine;
        a[k] = (scale.bits & 2u) != 0u ? -value : value;
        slope[k] = ((scale.bits + 1u) & 2u) != 0u ? -other : other;
    }
}

/* sin of LANES numbers and its derivative cos, without a library call while |x| <= 1e6.
 *
 * x = n pi/2 + r, pi/2 in three parts (Cody and Waite) so that n times the first two is exact;
 * then the Taylor polynomials on |r| <= pi/4, exchanged and signed by the two low bits of n.
 */
static void activate_sin(necc_real *restrict a, necc_real *restrict slope)
{
    const double shift = 6755399441055744.0;
    int k, large = 0;
    for (k = 0; k < LANES; ++k) {
        large |= (fabs(a[k]) > 1e6) ? 1 : 0;
    }
    if (large != 0) {
        for (k = 0; k < LANES; ++k) {
            slope[k] = cos(a[k]);
            a[k] = sin(a[k]);
        }
        return;
    }
    for (k = 0; k < LANES; ++k) {
        union { double number; uint64_t bits; } scale;
        const double rounded = a[k] * 0.6366197723675814 + shift;
        const double n = rounded - shift;
        const double r = ((a[k] - n * 1.5707963267341256) - n * 6.077100506303966e-11)
                       - n * 2.0222662487959506e-21;
        const double s = r * r;
        const double sine = r + r * s * (-1.0 / 6.0 + s * (1.0 / 120.0
            + s * (-1.0 / 5040.0 + s * (1.0 / 362880.0 + s * (-1.0 / 39916800.0
            + s * (1.0 / 6227020800.0 - s * (1.0 / 1307674368000.0)))))));
        const double cosine = 1.0 + s * (-1.0 / 2.0 + s * (1.0 / 24.0 + s * (-1.0 / 720.0
            + s * (1.0 / 40320.0 + s * (-1.0 / 3628800.0 + s * (1.0 / 479001600.0
            + s * (-1.0 / 87178291200.0 + s * (1.0 / 20922789888000.0))))))));
        double value, other;
        scale.number = rounded;
        value = (scale.bits & 1u) != 0u ? cosine : sine;
        other = (scale.bits & 1u) != 0u ? sine : cosine;
        a[k] = (scale.bits & 2u) != 0u ? -value : value;
        slope[k] = ((scale.bits + 1u) & 2u) != 0u ? -other : other;
    }
}

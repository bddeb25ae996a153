/* (x + sqrt(x^2 + 4))/2 of LANES numbers and its derivative. */
static void activate_squareplus(necc_real *restrict a, necc_real *restrict slope)
{
    int k;
    for (k = 0; k < LANES; ++k) {
        const necc_real x = a[k];
        const necc_real root = @sqrt@(x * x + R(4.0));
        a[k] = (x + root) * R(0.5);
        slope[k] = (R(1.0) + x / root) * R(0.5);
    }
}

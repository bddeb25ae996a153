/* Integral action: zeta' = Ki (s + tau y), s the outputs' B' (q - q*), held within its limits. */
@leaf@
static void integrate(const necc_real x[NECC_NX], necc_real dt, necc_real zeta[NECC_NU],
                      necc_real rest[NECC_NU])
{
    static const necc_real limit[NECC_NU] = {@limit@};
    necc_real slope[NECC_NU];
    int i;
    integral_rate(x, slope);
    for (i = 0; i < NECC_NU; ++i) {
        necc_real next = zeta[i], left = rest[i];
        accumulate(&next, &left, dt * slope[i]);
        if (isfinite(next)) {
            const int inside = next >= -limit[i] && next <= limit[i];
            zeta[i] = next < -limit[i] ? -limit[i] : next > limit[i] ? limit[i] : next;
            rest[i] = inside != 0 ? left : R(0.0);
        }
    }
}

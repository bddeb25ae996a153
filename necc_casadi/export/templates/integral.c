/* Integral action: zeta' = Ki (s + tau y), s the outputs' B' (q - q*), held within its limits. */
@leaf@
static void integrate(const necc_real x[NECC_NX], necc_real dt, necc_real zeta[NECC_NU])
{
    static const necc_real limit[NECC_NU] = {@limit@};
    necc_real rate[NECC_NU];
    int i;
    integral_rate(x, rate);
    for (i = 0; i < NECC_NU; ++i) {
        const necc_real next = zeta[i] + dt * rate[i];
        if (isfinite(next))
            zeta[i] = next < -limit[i] ? -limit[i] : next > limit[i] ? limit[i] : next;
    }
}

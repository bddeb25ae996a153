/* Clip u to the limits of the plant. */
static int saturate(necc_real u[NECC_NU])
{
    static const necc_real low[NECC_NU] = {@low@};
    static const necc_real high[NECC_NU] = {@high@};
    int i, flags = NECC_OK;
    for (i = 0; i < NECC_NU; ++i) {
        const necc_real v = u[i];
        u[i] = v < low[i] ? low[i] : v > high[i] ? high[i] : v;
        if (v < low[i] || v > high[i]) {
            flags = NECC_SATURATED;
        }
    }
    return flags;
}

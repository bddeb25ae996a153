/* v = resting + share pull, within the limits of the plant: the largest share of damping up to 1
 * that they leave, the same for every input. A limit that u is beyond without damping clips. */
static int scale_damping(const necc_real resting[NECC_NU], const necc_real pull[NECC_NU],
                 necc_real v[NECC_NU], necc_real share[1])
{
    static const necc_real low[NECC_NU] = {@low@};
    static const necc_real high[NECC_NU] = {@high@};
    int i, flags = NECC_OK;
    share[0] = R(1.0);
    for (i = 0; i < NECC_NU; ++i) {
        const necc_real asked = resting[i] + pull[i];
        necc_real part = R(1.0);
        if (asked > high[i] && resting[i] < high[i]) {
            part = (high[i] - resting[i]) / pull[i];
        }
        if (asked < low[i] && resting[i] > low[i]) {
            part = (low[i] - resting[i]) / pull[i];
        }
        if (part < share[0]) {
            share[0] = part;
        }
    }
    for (i = 0; i < NECC_NU; ++i) {
        const necc_real u = resting[i] + share[0] * pull[i];
        v[i] = u < low[i] ? low[i] : u > high[i] ? high[i] : u;
        if (share[0] < R(1.0) || u < low[i] || u > high[i]) {
            flags = NECC_SATURATED;
        }
    }
    return flags;
}

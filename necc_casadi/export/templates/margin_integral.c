/* What of W knows x alone, for each end of what is not known. */
@leaf@
/* See necc.h. */
necc_real necc_margin(const necc_state *state, const necc_real x[NECC_NX])
{
    static const necc_real q_star[NECC_NU] = {@q_star@};
    static const necc_real xi_bar[NECC_NXI] = {@xi_bar@};
    static const necc_real half[NECC_NU + NECC_NXI] = {@half@};
    static const necc_real low[NECC_NU] = {@low@};
    static const necc_real high[NECC_NU] = {@high@};
    static const necc_real weight[NECC_NU] = {@weight@};
    const necc_real *const xi = state->xi;
    necc_real parts[@ends@], W;
    shape_terms s;
    int i;
    if (!all_finite(x, NECC_NX) || !all_finite(xi, NECC_NXI) || !all_finite(state->zeta, NECC_NU)) {
        return R(-1.0);
    }
    for (i = 0; i < NECC_NU; ++i) {
        if (!(x[i] - q_star[i] <= half[i] && q_star[i] - x[i] <= half[i])) {
            return R(-1.0);
        }
    }
    for (i = 0; i < NECC_NXI; ++i) {
        if (!(xi[i] - xi_bar[i] <= half[NECC_NU + i] && xi_bar[i] - xi[i] <= half[NECC_NU + i])) {
            return R(-1.0);
        }
    }
    shape(x, xi, &s);
    known_energy(x, parts);
    W = parts[0];
    for (i = 1; i < @ends@; ++i) {
        W = parts[i] > W ? parts[i] : W;
    }
    if (!all_finite(parts, @ends@)) {
        return R(-1.0);
    }
    W += s.value - @rest@;
    for (i = 0; i < NECC_NU; ++i) {
        const necc_real below = state->zeta[i] - low[i], above = high[i] - state->zeta[i];
        const necc_real off = below > above ? below : above;
        W += weight[i] * off * off;
    }
    W = R(1.0) - W / @level@;
    return isfinite(W) ? W : R(-1.0);
}


/* See necc.h. */
int necc_set_target(necc_state *state, const necc_real x[NECC_NX], const necc_real r[NECC_NR])
{
    static const necc_real low[NECC_NR] = {@low@};
    static const necc_real high[NECC_NR] = {@high@};
    necc_real trial[NECC_NR], kept[NECC_NR], xi[NECC_NXI], kept_xi[NECC_NXI];
    necc_real share = R(0.0), step = R(1.0);
    int i, halvings, moved = 0;
    if (!all_finite(x, NECC_NX) || !all_finite(r, NECC_NR) || !all_finite(state->xi, NECC_NXI)) {
        return NECC_REJECTED;
    }
    for (i = 0; i < NECC_NR; ++i) {
        if (!(r[i] >= low[i] && r[i] <= high[i])) {
            return NECC_OUTSIDE;
        }
    }
    if (same(r, state->r, NECC_NR) != 0) {
        return NECC_OK;
    }
    if (admits(state, x, r@theta_of_state@, xi) != 0) {
        take(state, x, r, xi);
        return NECC_OK;
    }
    (void)memcpy(kept, state->r, sizeof kept);
    present_xi(state, x, kept_xi);
    for (halvings = 0; halvings < 24; ++halvings) {
        step *= R(0.5);
        for (i = 0; i < NECC_NR; ++i) {
            trial[i] = state->r[i] + (share + step) * (r[i] - state->r[i]);
            trial[i] = trial[i] < low[i] ? low[i] : trial[i] > high[i] ? high[i] : trial[i];
        }
        if (admits(state, x, trial@theta_of_state@, xi) != 0) {
            share += step;
            moved = 1;
            (void)memcpy(kept, trial, sizeof kept);
            (void)memcpy(kept_xi, xi, sizeof kept_xi);
        }
    }
    take(state, x, kept, kept_xi);
    return moved ? NECC_LIMITED : NECC_REFUSED;
}

void necc_get_target(const necc_state *state, necc_real r[NECC_NR])
{
    (void)memcpy(r, state->r, sizeof state->r);
}

/* Whether V(x, xi; r) is at most the level above its value at r, within the box of the proof. */
static int holds_at(const necc_real x[NECC_NX], const necc_real xi[NECC_NXI],
                    const necc_real r[NECC_NR])
{
    static const necc_real xi_star[NECC_NXI] = {@xi_star@};
    static const necc_real half[NECC_NR + NECC_NXI] = {@half@};
    necc_real at[NECC_NX], E[1];
    shape_terms s;
    int i;
    seen(x, r, at);
    for (i = 0; i < NECC_NR; ++i)
        if (!(at[i] - r_star[i] <= half[i] && r_star[i] - at[i] <= half[i]))
            return 0;
    for (i = 0; i < NECC_NXI; ++i)
        if (!(xi[i] - xi_star[i] <= half[NECC_NR + i] && xi_star[i] - xi[i] <= half[NECC_NR + i]))
            return 0;
    shape(at, xi, &s);
    energy_above(x, r, E);
    return E[0] + s.value - @rest@ <= @level@;
}

/* See necc.h. */
int necc_set_target(necc_state *state, const necc_real x[NECC_NX], const necc_real r[NECC_NR])
{
    static const necc_real low[NECC_NR] = {@low@};
    static const necc_real high[NECC_NR] = {@high@};
    necc_real trial[NECC_NR], kept[NECC_NR], share, step = R(1.0);
    int i, halvings, moved = 0;
    if (!all_finite(x, NECC_NX) || !all_finite(r, NECC_NR) || !all_finite(state->xi, NECC_NXI))
        return NECC_REJECTED;
    for (i = 0; i < NECC_NR; ++i)
        if (!(r[i] >= low[i] && r[i] <= high[i]))
            return NECC_OUTSIDE;
    if (holds_at(x, state->xi, r)) {
        memcpy(state->r, r, sizeof state->r);
        return NECC_OK;
    }
    share = R(0.0);
    memcpy(kept, state->r, sizeof kept);
    for (halvings = 0; halvings < 24; ++halvings) {
        step *= R(0.5);
        for (i = 0; i < NECC_NR; ++i) {
            trial[i] = state->r[i] + (share + step) * (r[i] - state->r[i]);
            trial[i] = trial[i] < low[i] ? low[i] : trial[i] > high[i] ? high[i] : trial[i];
        }
        if (holds_at(x, state->xi, trial)) {
            share += step;
            moved = 1;
            memcpy(kept, trial, sizeof kept);
        }
    }
    memcpy(state->r, kept, sizeof kept);
    return moved ? NECC_LIMITED : NECC_REFUSED;
}

void necc_get_target(const necc_state *state, necc_real r[NECC_NR])
{
    memcpy(r, state->r, sizeof state->r);
}

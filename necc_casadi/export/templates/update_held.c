int necc_update(necc_state *state, necc_real dt)
{
    necc_state next;
    necc_real change[NECC_NXI];
    int i;
    if (!(dt >= R(0.0)) || !isfinite(dt) || all_finite(state->xi, NECC_NXI) == 0) {
        return NECC_REJECTED;
    }
    if (state->sampled == 0) {
        return NECC_OK;
    }
    next = *state;
    if (next.moved != 0) {
        rate(next.x, next.xi@share@, next.xidot);
    }
    advance(&next, dt, change);
    for (i = 0; i < NECC_NXI; ++i) {
        accumulate(&next.xi[i], &next.xi_rest[i], change[i]);
    }
    next.moved = 1;
    @integrate@
    if (all_finite(next.xi, NECC_NXI) == 0) {
        return NECC_REJECTED;
    }
    *state = next;
    return NECC_OK;
}

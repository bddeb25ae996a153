/* xi as it is where x is measured. */
static void present_xi(const necc_state *state, const necc_real x[NECC_NX], necc_real xi[NECC_NXI])
{
    (void)x;
    (void)memcpy(xi, state->xi, sizeof state->xi);
}

/* r and xi are taken at x. Where xi jumps, it goes on from there: nothing that rounding left of the
 * old one is added to it, and its rate is that of what the law sees now. */
static void take(necc_state *state, const necc_real x[NECC_NX], const necc_real r[NECC_NR],
                 const necc_real xi[NECC_NXI])
{
    if (same(xi, state->xi, NECC_NXI) == 0) {
        (void)memcpy(state->xi, xi, sizeof state->xi);
        (void)memset(state->xi_rest, 0, sizeof state->xi_rest);
        seen(x, r, state->x);
        state->moved = 1;
    }
    (void)memmove(state->r, r, sizeof state->r);
}

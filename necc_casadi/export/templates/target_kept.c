/* xi as it is where x is measured. */
static void present_xi(const necc_state *state, const necc_real x[NECC_NX], necc_real xi[NECC_NXI])
{
    necc_real at[NECC_NX], shift[NECC_NXI];
    (void)memcpy(xi, state->xi, sizeof state->xi);
    if (state->sampled != 0) {
        seen(x, state->r, at);
        integrated(at, shift);
        read_off(state, shift, xi);
    }
}

/* r and xi are taken at x: what is kept is that of what the law sees now. */
static void take(necc_state *state, const necc_real x[NECC_NX], const necc_real r[NECC_NR],
                 const necc_real xi[NECC_NXI])
{
    necc_real at[NECC_NX];
    (void)memmove(state->r, r, sizeof state->r);
    (void)memcpy(state->xi, xi, sizeof state->xi);
    if (state->sampled != 0) {
        seen(x, r, at);
        (void)memcpy(state->x, at, sizeof state->x);
        keep(state, at);
    }
}

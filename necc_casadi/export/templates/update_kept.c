/* xi(x) for what is kept. */
static void read_off(const necc_state *s, const necc_real shift[NECC_NXI], necc_real xi[NECC_NXI])
{
    int i;
    for (i = 0; i < NECC_NXI; ++i) {
        xi[i] = (shift[i] + s->kept[i]) + s->kept_rest[i];
    }
}

/* What is kept where xi is given at x. */
static void keep(necc_state *s, const necc_real x[NECC_NX])
{
    necc_real shift[NECC_NXI];
    int i;
    integrated(x, shift);
    for (i = 0; i < NECC_NXI; ++i) {
        s->kept[i] = -shift[i];
        s->kept_rest[i] = R(0.0);
        accumulate(&s->kept[i], &s->kept_rest[i], s->xi[i]);
    }
}

/* xi at x: the first sample says what is kept, and later damping moves it over the time that is due,
 * in @steps@ steps down V(x, .). */
static void arrive(necc_state *s, const necc_real x[NECC_NX])
{
    necc_real shift[NECC_NXI], change[NECC_NXI];
    const necc_real h = s->due / R(@steps@.0);
    int i, step;
    if (s->sampled == 0) {
        keep(s, x);
        return;
    }
    integrated(x, shift);
    read_off(s, shift, s->xi);
    for (step = 0; step < @steps@ && s->due > R(0.0); ++step) {
        rate(x, s->xi@share@, change);
        for (i = 0; i < NECC_NXI; ++i) {
            accumulate(&s->kept[i], &s->kept_rest[i], h * change[i]);
        }
        read_off(s, shift, s->xi);
    }
    s->due = R(0.0);
}

int necc_update(necc_state *state, necc_real dt)
{
    static const necc_real longest = @longest@;
    necc_real due;
    if (!(dt >= R(0.0)) || !isfinite(dt) || all_finite(state->xi, NECC_NXI) == 0) {
        return NECC_REJECTED;
    }
    if (state->sampled == 0) {
        return NECC_OK;
    }
    due = state->due + dt;
    state->due = due > longest ? longest : due;
    @integrate@
    return NECC_OK;
}

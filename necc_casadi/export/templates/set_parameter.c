
/* See necc.h. */
int necc_set_parameter(necc_state *state, const necc_real theta[NECC_NTHETA])
{
    static const necc_real low[NECC_NTHETA] = {@least@};
    static const necc_real high[NECC_NTHETA] = {@most@};
    int i, covered = 1;
    if (!all_finite(theta, NECC_NTHETA)) {
        return NECC_REJECTED;
    }
    for (i = 0; i < NECC_NTHETA; ++i) {
        if (!(theta[i] >= low[i] && theta[i] <= high[i])) {
            return NECC_OUTSIDE;
        }
    }
    if (same(theta, state->theta, NECC_NTHETA) != 0) {
        return NECC_OK;
    }
    if (state->sampled != 0) {
        necc_real x[NECC_NX], xi[NECC_NXI];
        unseen(state->x, state->r, x);
        if (admits(state, x, state->r, theta, xi) != 0) {
            take(state, x, state->r, xi);
        } else {
            covered = share_of_level(state->x, state->xi, state->r, theta) <= R(1.0);
        }
    }
    (void)memcpy(state->theta, theta, sizeof state->theta);
    return covered ? NECC_OK : NECC_UNCOVERED;
}

void necc_get_parameter(const necc_state *state, necc_real theta[NECC_NTHETA])
{
    (void)memcpy(theta, state->theta, sizeof state->theta);
}

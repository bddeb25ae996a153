
/* What the plant has now of @names@: NECC_OK; NECC_UNCOVERED, the
 * parameters are taken, but the last sample is not in the set that is proved with them: nothing is
 * claimed until necc_margin is above 0; NECC_OUTSIDE, they are out of range and nothing changes. The
 * claims are about what the plant really has: tell it when that changes, after the necc_step of a
 * sample, then necc_step once more with dt = 0. */
int necc_set_parameter(necc_state *state, const necc_real theta[NECC_NTHETA]);

/* The parameters that are applied. */
void necc_get_parameter(const necc_state *state, necc_real theta[NECC_NTHETA]);


/* Move the set-point towards r, coordinate by coordinate in the order of x: NECC_OK, it is r;
 * NECC_LIMITED, it is moved as far as the proof allows from the measured x, call again; NECC_REFUSED,
 * it stays; NECC_OUTSIDE, r is outside its range and nothing changes. At any r that is taken V is
 * below the level of the certificate, for every sequence of commands; coordinates that do not move
 * have one value. Call it after the necc_step of a sample, with the same x, and necc_step once more
 * with dt = 0: u for the set-point it is now. */
int necc_set_target(necc_state *state, const necc_real x[NECC_NX], const necc_real r[NECC_NR]);

/* The set-point that is applied. */
void necc_get_target(const necc_state *state, necc_real r[NECC_NR]);

/* How far the measured x and xi of the state are inside the region of the certificate:
 * (c - V(x, xi)) / (c - V(z)) with z the minimum: 1 there, 0 on the border, negative outside.
 * -1 where no state of the region is, however low V is there, and where something is not finite.
 * Angles count as they stand: whole turns are not taken off. Pure. */
necc_real necc_margin(const necc_state *state, const necc_real x[NECC_NX]);

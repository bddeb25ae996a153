/* How far the measured x and the state are inside what is proved: 1 - W / level with the largest W
 * of every@unknown@ zeta* in @resting@: at most 1, 0 on the
 * border, negative outside; -1 outside the box of the proof, and where something is not finite. Pure. */
necc_real necc_margin(const necc_state *state, const necc_real x[NECC_NX]);

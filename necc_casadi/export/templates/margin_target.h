/* How far the measured x and the state are inside what is proved at the present set-point@told@:
 * 1 - (V(x, xi) - V(at rest)) / level: 1 at rest, 0 on the border, negative outside; -1 outside the
 * box of the proof, and where something is not finite. Pure. */
necc_real necc_margin(const necc_state *state, const necc_real x[NECC_NX]);

/* What becomes of xi when a set-point moves or a parameter changes: NECC_SWITCH_KEEP, it stays and
 * u jumps by the force that is held; NECC_SWITCH_BUMPLESS, it jumps and u does not, where there is
 * such a xi; NECC_SWITCH_LEAST, it is where V(x, .) is least, from which a set-point moves
 * farthest. Whichever it is, V with the new xi is below the level: only such a move is made. */
void necc_set_switch(necc_state *state, int how);
@set_target@@set_parameter@

/* Euler's method for xi over dt, the x of the last sample held. */
static void advance(const necc_state *s, necc_real dt, necc_real next[NECC_NXI])
{
    int i;
    for (i = 0; i < NECC_NXI; ++i)
        next[i] = s->xi[i] + dt * s->xidot[i];
}

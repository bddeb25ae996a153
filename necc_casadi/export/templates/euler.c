/* What Euler's method adds to xi over dt, x held. */
static void advance(const necc_state *s, necc_real dt, necc_real change[NECC_NXI])
{
    int i;
    for (i = 0; i < NECC_NXI; ++i) {
        change[i] = dt * s->xidot[i];
    }
}

/* What Heun's method adds to xi over dt, x held. */
static void advance(const necc_state *s, necc_real dt, necc_real change[NECC_NXI])
{
    necc_real trial[NECC_NXI], k2[NECC_NXI];
    int i;
    for (i = 0; i < NECC_NXI; ++i) {
        trial[i] = s->xi[i] + dt * s->xidot[i];
    }
    rate(s->x, trial@share@, k2);
    for (i = 0; i < NECC_NXI; ++i) {
        change[i] = dt * R(0.5) * (s->xidot[i] + k2[i]);
    }
}

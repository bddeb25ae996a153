/* Heun's method for xi over dt, the x of the last sample held. */
static void advance(const necc_state *s, necc_real dt, necc_real next[NECC_NXI])
{
    necc_real k2[NECC_NXI], unused[NECC_NU];
    int i;
    for (i = 0; i < NECC_NXI; ++i)
        next[i] = s->xi[i] + dt * s->xidot[i];
    necc_control(s->x, next, unused, k2);
    for (i = 0; i < NECC_NXI; ++i)
        next[i] = s->xi[i] + dt * R(0.5) * (s->xidot[i] + k2[i]);
}

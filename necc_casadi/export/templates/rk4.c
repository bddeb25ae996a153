/* The classical Runge-Kutta method for xi over dt, the x of the last sample held. */
static void advance(const necc_state *s, necc_real dt, necc_real next[NECC_NXI])
{
    static const necc_real fraction[3] = {R(0.5), R(0.5), R(1.0)};
    necc_real k[4][NECC_NXI], trial[NECC_NXI], unused[NECC_NU];
    int i, stage;
    memcpy(k[0], s->xidot, sizeof k[0]);
    for (stage = 0; stage < 3; ++stage) {
        for (i = 0; i < NECC_NXI; ++i)
            trial[i] = s->xi[i] + dt * fraction[stage] * k[stage][i];
        necc_control(s->x, trial, unused, k[stage + 1]);
    }
    for (i = 0; i < NECC_NXI; ++i)
        next[i] = s->xi[i] + dt / R(6.0) * (k[0][i] + R(2.0) * (k[1][i] + k[2][i]) + k[3][i]);
}

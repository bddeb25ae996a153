/* What the classical Runge-Kutta method adds to xi over dt, x held. */
static void advance(const necc_state *s, necc_real dt, necc_real change[NECC_NXI])
{
    static const necc_real fraction[3] = {R(0.5), R(0.5), R(1.0)};
    necc_real k[4][NECC_NXI], trial[NECC_NXI];
    int i, stage;
    (void)memcpy(k[0], s->xidot, sizeof k[0]);
    for (stage = 0; stage < 3; ++stage) {
        for (i = 0; i < NECC_NXI; ++i) {
            trial[i] = s->xi[i] + dt * fraction[stage] * k[stage][i];
        }
        rate(s->x, trial@share@, k[stage + 1]);
    }
    for (i = 0; i < NECC_NXI; ++i) {
        change[i] = dt / R(6.0) * (k[0][i] + R(2.0) * (k[1][i] + k[2][i]) + k[3][i]);
    }
}

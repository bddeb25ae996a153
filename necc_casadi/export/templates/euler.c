/* Euler's method for xi with x held; v is the input at the start. */
static void advance(const necc_real x[NECC_NX], const necc_real xi[NECC_NXI], necc_real dt,
                    necc_real v[NECC_NU], necc_real next[NECC_NXI])
{
    necc_real k1[NECC_NXI];
    int i;
    necc_control(x, xi, v, k1);
    for (i = 0; i < NECC_NXI; ++i)
        next[i] = xi[i] + dt * k1[i];
}

/* The same for one stream. */
static void products_of_one(const necc_real *restrict w, int rows, int columns,
                            const necc_real *restrict in, necc_real *restrict out)
{
    const necc_real *w0 = w;
    const necc_real *v = in;
    const necc_real *const end = in + columns;
    necc_real a[LANES];
    int k;
    for (k = 0; k < LANES; ++k) {
        a[k] = R(0.0);
    }
    while (v < end) {
        const necc_real *const w1 = w0 + rows, *const w2 = w1 + rows, *const w3 = w2 + rows;
        const necc_real a0 = v[0], a1 = v[1], a2 = v[2], a3 = v[3];
        for (k = 0; k < LANES; ++k) {
            a[k] += (w0[k] * a0 + w1[k] * a1) + (w2[k] * a2 + w3[k] * a3);
        }
        w0 = w3 + rows;
        v += 4;
    }
    for (k = 0; k < LANES; ++k) {
        out[k] = a[k];
    }
}

/* LANES rows of out = W in, for two streams. w is the first of these rows in the first of
 * `columns` columns, each `rows` long. The sums stay in registers where there are enough; every
 * loop over LANES is one that a compiler vectorises without reordering a sum.
 */
static void products_of_two(const necc_real *restrict w, int rows, int columns,
                            const necc_real *restrict in, necc_real *restrict out)
{
    const necc_real *w0 = w;
    const necc_real *v = in;
    const necc_real *const end = in + columns;
    necc_real a[LANES], b[LANES];
    int k;
    for (k = 0; k < LANES; ++k) {
        a[k] = R(0.0);
        b[k] = R(0.0);
    }
    while (v < end) {
        const necc_real *const w1 = w0 + rows, *const w2 = w1 + rows, *const w3 = w2 + rows;
        const necc_real a0 = v[0], a1 = v[1], a2 = v[2], a3 = v[3];
        const necc_real b0 = v[WIDTH], b1 = v[WIDTH + 1], b2 = v[WIDTH + 2], b3 = v[WIDTH + 3];
        for (k = 0; k < LANES; ++k) {
            a[k] += (w0[k] * a0 + w1[k] * a1) + (w2[k] * a2 + w3[k] * a3);
            b[k] += (w0[k] * b0 + w1[k] * b1) + (w2[k] * b2 + w3[k] * b3);
        }
        w0 = w3 + rows;
        v += 4;
    }
    for (k = 0; k < LANES; ++k) {
        out[k] = a[k];
        out[WIDTH + k] = b[k];
    }
}

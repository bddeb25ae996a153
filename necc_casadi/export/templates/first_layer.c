/* The first hidden layer at v: activation(b + W v); its derivative along v[i] is column i of W
 * times the slope. w holds b, then W column by column.
 */
static void first_layer_@activation@(const necc_real *restrict w, int rows, int inputs,
                             const necc_real *restrict v, necc_real *restrict out)
{
    necc_real slope[LANES];
    int p, k, i;
    for (p = 0; p < rows; p += LANES) {
        for (k = 0; k < LANES; ++k) {
            out[p + k] = w[p + k];
        }
        for (i = 0; i < inputs; ++i) {
            const necc_real *const column = w + (1 + i) * rows + p;
            for (k = 0; k < LANES; ++k) {
                out[p + k] += column[k] * v[i];
            }
        }
        activate_@activation@(out + p, slope);
        for (i = 0; i < inputs; ++i) {
            const necc_real *const column = w + (1 + i) * rows + p;
            for (k = 0; k < LANES; ++k) {
                out[(1 + i) * WIDTH + p + k] = column[k] * slope[k];
            }
        }
    }
}

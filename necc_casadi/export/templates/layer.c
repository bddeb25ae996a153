/* A further hidden layer: activation(b + W in), and its derivatives by the chain rule. */
static void layer_@activation@(const necc_real *restrict w, int rows, int columns, int streams,
                       const necc_real *restrict in, necc_real *restrict out)
{
    necc_real slope[LANES];
    int p, k, s;
    for (p = 0; p < rows; p += LANES) {
        for (s = 0; s + 2 <= streams; s += 2) {
            products_of_two(w + rows + p, rows, columns, in + s * WIDTH, out + s * WIDTH + p);
        }@last_stream@
        for (k = 0; k < LANES; ++k) {
            out[p + k] += w[p + k];
        }
        activate_@activation@(out + p, slope);
        for (s = 1; s < streams; ++s) {
            for (k = 0; k < LANES; ++k) {
                out[s * WIDTH + p + k] *= slope[k];
            }
        }
    }
}

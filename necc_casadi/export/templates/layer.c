/* One hidden layer: activation(b + W in), and its derivatives by the chain rule. */
static void layer_@activation@(const necc_real *w, int rows, int columns, int streams,
                       const necc_real *in, necc_real *out)
{
    necc_real slope[LANES];
    int p, k, s;
    affine(w, rows, columns, streams, in, out);
    for (p = 0; p < rows; p += LANES) {
        activate_@activation@(out + p, slope);
        for (s = 1; s < streams; ++s)
            for (k = 0; k < LANES; ++k)
                out[s * WIDTH + p + k] *= slope[k];
    }
}

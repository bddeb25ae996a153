static void add_four_columns_to_two(const necc_real *restrict w, int rows,
                                    const necc_real *restrict in, necc_real *restrict out)
{
    const necc_real v0 = in[0], v1 = in[1], v2 = in[2], v3 = in[3];
    const necc_real d0 = in[WIDTH], d1 = in[WIDTH + 1], d2 = in[WIDTH + 2], d3 = in[WIDTH + 3];
    int p, k;
    for (p = 0; p < rows; p += LANES)
        for (k = p; k < p + LANES; ++k) {
            const necc_real w0 = w[k], w1 = w[k + rows];
            const necc_real w2 = w[k + 2 * rows], w3 = w[k + 3 * rows];
            out[k] = out[k] + w0 * v0 + w1 * v1 + w2 * v2 + w3 * v3;
            out[WIDTH + k] = out[WIDTH + k] + w0 * d0 + w1 * d1 + w2 * d2 + w3 * d3;
        }
}

static void add_four_columns(const necc_real *restrict w, int rows,
                             const necc_real *restrict in, necc_real *restrict out)
{
    int p, k;
    for (p = 0; p < rows; p += LANES)
        for (k = p; k < p + LANES; ++k)
            out[k] = out[k] + w[k] * in[0] + w[k + rows] * in[1] + w[k + 2 * rows] * in[2]
                   + w[k + 3 * rows] * in[3];
}

static void add_column(const necc_real *restrict w, int rows, necc_real v,
                       necc_real *restrict out)
{
    int p, k;
    for (p = 0; p < rows; p += LANES)
        for (k = p; k < p + LANES; ++k)
            out[k] = out[k] + w[k] * v;
}

/* out = b + W in for stream 0, out = W in for the others; w holds b, then the columns of W. */
static void affine(const necc_real *restrict w, int rows, int columns, int streams,
                   const necc_real *restrict in, necc_real *restrict out)
{
    int j, k, s;
    memcpy(out, w, (size_t)rows * sizeof *out);
    for (s = 1; s < streams; ++s)
        for (k = 0; k < rows; ++k)
            out[s * WIDTH + k] = R(0.0);
    w += rows;
    for (j = 0; j + 4 <= columns; j += 4, w += 4 * rows) {
        for (s = 0; s + 2 <= streams; s += 2)
            add_four_columns_to_two(w, rows, in + s * WIDTH + j, out + s * WIDTH);
        if (s < streams)
            add_four_columns(w, rows, in + s * WIDTH + j, out + s * WIDTH);
    }
    for (; j < columns; ++j, w += rows)
        for (s = 0; s < streams; ++s)
            add_column(w, rows, in[s * WIDTH + j], out + s * WIDTH);
}

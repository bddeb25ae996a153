/* Weights of four columns lie together, LANES rows of each in turn; every loop over LANES is one
 * that a compiler vectorises without reordering a sum. Two streams share the weights they read.
 */
static void add_four_columns_to_two(const necc_real *restrict w, int rows,
                                    const necc_real *restrict in, necc_real *restrict out)
{
    const necc_real v0 = in[0], v1 = in[1], v2 = in[2], v3 = in[3];
    const necc_real d0 = in[WIDTH], d1 = in[WIDTH + 1], d2 = in[WIDTH + 2], d3 = in[WIDTH + 3];
    const necc_real *const end = out + rows;
    int k;
    for (; out < end; out += LANES, w += 4 * LANES)
        for (k = 0; k < LANES; ++k) {
            const necc_real w0 = w[k], w1 = w[k + LANES];
            const necc_real w2 = w[k + 2 * LANES], w3 = w[k + 3 * LANES];
            out[k] = out[k] + w0 * v0 + w1 * v1 + w2 * v2 + w3 * v3;
            out[WIDTH + k] = out[WIDTH + k] + w0 * d0 + w1 * d1 + w2 * d2 + w3 * d3;
        }
}

static void add_four_columns(const necc_real *restrict w, int rows,
                             const necc_real *restrict in, necc_real *restrict out)
{
    const necc_real v0 = in[0], v1 = in[1], v2 = in[2], v3 = in[3];
    const necc_real *const end = out + rows;
    int k;
    for (; out < end; out += LANES, w += 4 * LANES)
        for (k = 0; k < LANES; ++k)
            out[k] = out[k] + w[k] * v0 + w[k + LANES] * v1 + w[k + 2 * LANES] * v2
                   + w[k + 3 * LANES] * v3;
}

static void add_column(const necc_real *restrict w, int rows, necc_real v,
                       necc_real *restrict out)
{
    const necc_real *const end = out + rows;
    int k;
    for (; out < end; out += LANES, w += LANES)
        for (k = 0; k < LANES; ++k)
            out[k] = out[k] + w[k] * v;
}

/* out = b + W in for stream 0, out = W in for the others; w holds b, then W. */
static void affine(const necc_real *restrict w, int rows, int columns, int streams,
                   const necc_real *restrict in, necc_real *restrict out)
{
    const int whole = columns - columns % 4;
    int j, k, s;
    memcpy(out, w, (size_t)rows * sizeof *out);
    for (s = 1; s < streams; ++s)
        for (k = 0; k < rows; ++k)
            out[s * WIDTH + k] = R(0.0);
    w += rows;
    for (j = 0; j < whole; j += 4, w += 4 * rows) {
        for (s = 0; s + 2 <= streams; s += 2)
            add_four_columns_to_two(w, rows, in + s * WIDTH + j, out + s * WIDTH);
        if (s < streams)
            add_four_columns(w, rows, in + s * WIDTH + j, out + s * WIDTH);
    }
    for (j = whole; j < columns; ++j, w += rows)
        for (s = 0; s < streams; ++s)
            add_column(w, rows, in[s * WIDTH + j], out + s * WIDTH);
}

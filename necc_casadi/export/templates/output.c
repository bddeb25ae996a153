/* Networks. A vector and its derivatives along each input of the network travel together, as
 * streams of WIDTH numbers each: stream 0 is the value. Sums are added in an order that does not
 * depend on the processor's vectors.
 */

/* Stream 0 is v, stream 1 + i its derivative along v[i]; zeros up to `columns`. */
static void start(const necc_real *v, int inputs, int columns, necc_real *in)
{
    int i, j;
    for (j = 0; j < columns; ++j) {
        in[j] = j < inputs ? v[j] : R(0.0);
        for (i = 0; i < inputs; ++i)
            in[(1 + i) * WIDTH + j] = i == j ? R(1.0) : R(0.0);
    }
}

/* w.v for whole lanes, in eight partial sums that are then added in halves. */
static necc_real dot(const necc_real *restrict w, int columns, const necc_real *restrict v)
{
    necc_real sum[8] = {0};
    int p, k;
    for (p = 0; p < columns; p += 8)
        for (k = 0; k < 8; ++k)
            sum[k] += w[p + k] * v[p + k];
    return ((sum[0] + sum[4]) + (sum[2] + sum[6])) + ((sum[1] + sum[5]) + (sum[3] + sum[7]));
}

/* The last layer: its value, and its derivative along each input. w ends with the bias. */
static necc_real output(const necc_real *w, int columns, int inputs, const necc_real *in,
                        necc_real *slope)
{
    int i;
    for (i = 0; i < inputs; ++i)
        slope[i] = dot(w, columns, in + (1 + i) * WIDTH);
    return dot(w, columns, in) + w[columns];
}

/* Networks. A vector and its derivatives along each input of the network travel together, as
 * streams of WIDTH numbers each: stream 0 is the value, stream 1 + i the derivative along input i.
 * The order of every sum is fixed and does not depend on the processor's vectors.
 */

/* w.v for columns in whole sixteens, in sixteen partial sums that are then added in halves. */
static necc_real dot(const necc_real *restrict w, int columns, const necc_real *restrict v)
{
    necc_real sum[16];
    int p, k;
    for (k = 0; k < 16; ++k) {
        sum[k] = R(0.0);
    }
    for (p = 0; p < columns; p += 16) {
        for (k = 0; k < 16; ++k) {
            sum[k] += w[p + k] * v[p + k];
        }
    }
    for (k = 0; k < 8; ++k) {
        sum[k] += sum[k + 8];
    }
    return ((sum[0] + sum[4]) + (sum[2] + sum[6])) + ((sum[1] + sum[5]) + (sum[3] + sum[7]));
}

/* The last layer: its value, and its derivative along each input. w ends with the bias. */
static necc_real output(const necc_real *w, int columns, int inputs, const necc_real *in,
                        necc_real *slope)
{
    int i;
    for (i = 0; i < inputs; ++i) {
        slope[i] = dot(w, columns, in + (1 + i) * WIDTH);
    }
    return dot(w, columns, in) + w[columns];
}

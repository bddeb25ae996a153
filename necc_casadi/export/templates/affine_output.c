/* A network without hidden layers: w.v + b, and w; w ends with b. */
static necc_real affine_output(const necc_real *w, int inputs, const necc_real *v, necc_real *slope)
{
    necc_real sum = R(0.0);
    int i;
    for (i = 0; i < inputs; ++i) {
        sum += w[i] * v[i];
        slope[i] = w[i];
    }
    return sum + w[inputs];
}

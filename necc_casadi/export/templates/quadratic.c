/* Adds sum of kappa (v - o)^2 / 2 to the value and its gradient to slope; w holds kappa, then o. */
static necc_real quadratic(const necc_real *w, int inputs, const necc_real *v, necc_real *slope)
{
    necc_real sum = R(0.0);
    int i;
    for (i = 0; i < inputs; ++i) {
        const necc_real distance = v[i] - w[inputs + i];
        sum += w[i] * distance * distance;
        slope[i] += w[i] * distance;
    }
    return sum * R(0.5);
}

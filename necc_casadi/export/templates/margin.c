@table@

/* See necc.h. */
necc_real necc_margin(const necc_state *state, const necc_real x[NECC_NX])
{
    const necc_real *const xi = state->xi;
    shape_terms s;
    necc_real @H@margin;@held@
    if (!all_finite(x, NECC_NX) || !all_finite(xi, NECC_NXI)@outside@) {
        return R(-1.0);
    }
    shape(x, xi, &s);
    @energy@
    margin = (@level@ - @value@) / @height@;
    return isfinite(margin) ? margin : R(-1.0);
}

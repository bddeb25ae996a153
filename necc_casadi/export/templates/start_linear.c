static const necc_real x_star[NECC_NX] = {@x_star@};
static const necc_real gain[NECC_NXI * NECC_NX] = {@gain@};
int i, j;@momenta@
necc_init(state);
if (all_finite(x0, NECC_NX) == 0) {
    return NECC_REJECTED;
}@to_momenta@
for (i = 0; i < NECC_NXI; ++i) {
    for (j = 0; j < NECC_NX; ++j) {
        state->xi[i] += gain[i * NECC_NX + j] * (@x@[j] - x_star[j]);
    }
}
if (all_finite(state->xi, NECC_NXI) == 0) {
    necc_init(state);
    return NECC_REJECTED;
}
return NECC_OK;

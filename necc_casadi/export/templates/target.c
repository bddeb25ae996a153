/* V(x, xi; r@comma_theta@) above its value at r over the level of the certificate, of what the law
 * sees; infinite outside the box of the proof, and where it is not finite. */
static necc_real share_of_level(const necc_real at[NECC_NX], const necc_real xi[NECC_NXI],
                                const necc_real r[NECC_NR]@theta_parameter@)
{
    static const necc_real xi_star[NECC_NXI] = {@xi_star@};
    static const necc_real half[NECC_NR + NECC_NXI] = {@half@};
    necc_real E[1];
    shape_terms s;
    int i;
    for (i = 0; i < NECC_NR; ++i) {
        if (!(at[i] - r_star[i] <= half[i] && r_star[i] - at[i] <= half[i])) {
            return @infinite@;
        }
    }
    for (i = 0; i < NECC_NXI; ++i) {
        if (!(xi[i] - xi_star[i] <= half[NECC_NR + i] && xi_star[i] - xi[i] <= half[NECC_NR + i])) {
            return @infinite@;
        }
    }
    shape(at, xi, &s);
    energy_above(at, r@theta@, E);
    E[0] += s.value - @rest@;
    return isfinite(E[0]) ? E[0] / @level@ : @infinite@;
}

/* The last column of A is what the others, square, make of the solution; 0 if they are singular. */
static int eliminated(necc_real A[NECC_NU][NECC_NU + 1])
{
    int i, j, k;
    for (k = 0; k < NECC_NU; ++k) {
        int pivot = k;
        for (i = k + 1; i < NECC_NU; ++i) {
            pivot = @fabs@(A[i][k]) > @fabs@(A[pivot][k]) ? i : pivot;
        }
        if (!(@fabs@(A[pivot][k]) > R(0.0))) {
            return 0;
        }
        for (j = k; j <= NECC_NU; ++j) {
            const necc_real held = A[k][j];
            A[k][j] = A[pivot][j];
            A[pivot][j] = held;
        }
        for (i = 0; i < NECC_NU; ++i) {
            const necc_real share = A[i][k] / A[k][k];
            for (j = k; i != k && j <= NECC_NU; ++j) {
                A[i][j] -= share * A[k][j];
            }
        }
    }
    for (k = 0; k < NECC_NU; ++k) {
        A[k][NECC_NU] /= A[k][k];
    }
    return 1;
}

/* xi at which u at `at` is less than it was at `before` by what is added to it after: Newton's
 * method with differences; 0 where it finds none. */
static int bumpless(const necc_real before[NECC_NX], const necc_real at[NECC_NX],
                    const necc_real added[NECC_NU], necc_real xi[NECC_NXI])
{
    static const necc_real u_size[NECC_NU] = {@u_size@};
    necc_real u[NECC_NU], wanted[NECC_NU], up[NECC_NU], down[NECC_NU], unused[NECC_NXI];
    necc_real A[NECC_NU][NECC_NU + 1], trial[NECC_NXI];
    int i, j, step;
    necc_control(before, xi, wanted, unused);
    for (step = 0; step < 20; ++step) {
        necc_real off = R(0.0);
        necc_control(at, xi, u, unused);
        for (i = 0; i < NECC_NU; ++i) {
            A[i][NECC_NU] = wanted[i] - added[i] - u[i];
            off += @fabs@(A[i][NECC_NU]) / (u_size[i] + @fabs@(wanted[i]));
        }
        if (!(off > @close@)) {
            return 1;
        }
        for (j = 0; j < NECC_NXI; ++j) {
            const necc_real h = @cbrt_eps@ * (xi_size[j] + @fabs@(xi[j]));
            (void)memcpy(trial, xi, sizeof trial);
            trial[j] = xi[j] + h;
            necc_control(at, trial, up, unused);
            trial[j] = xi[j] - h;
            necc_control(at, trial, down, unused);
            for (i = 0; i < NECC_NU; ++i) {
                A[i][j] = (up[i] - down[i]) / (h + h);
            }
        }
        if (!eliminated(A)) {
            return 0;
        }
        for (j = 0; j < NECC_NXI; ++j) {
            xi[j] += A[j][NECC_NU];
        }
        if (!all_finite(xi, NECC_NXI)) {
            return 0;
        }
    }
    return 0;
}

static int same(const necc_real *a, const necc_real *b, int count)
{
    int i;
    for (i = 0; i < count; ++i) {
        if (!(a[i] >= b[i] && a[i] <= b[i])) {
            return 0;
        }
    }
    return 1;
}

@take@
/* Whether r@comma_theta@ may be taken at x, and with which xi. */
static int admits(const necc_state *state, const necc_real x[NECC_NX],
                  const necc_real r[NECC_NR]@theta_parameter@, necc_real xi[NECC_NXI])
{
    necc_real at[NECC_NX];
    present_xi(state, x, xi);
    seen(x, r, at);
    if (state->how == NECC_SWITCH_BUMPLESS) {
        necc_real before[NECC_NX], added[NECC_NU], now[NECC_NU];
        int i;
        seen(x, state->r, before);
        forward(state->r@theta_of_state@, now);
        forward(r@theta@, added);
        for (i = 0; i < NECC_NU; ++i) {
            added[i] -= now[i];
        }
        if (!bumpless(before, at, added, xi)) {
            return 0;
        }
    } else if (state->how == NECC_SWITCH_LEAST) {
        (void)least_over_xi(at, xi);
    } else {
        /* xi stays */
    }
    return share_of_level(at, xi, r@theta@) <= R(1.0);
}

void necc_set_switch(necc_state *state, int how)
{
    state->how = how;
}

/* See necc.h. */
necc_real necc_margin(const necc_state *state, const necc_real x[NECC_NX])
{
    necc_real at[NECC_NX], share;
    if (!all_finite(x, NECC_NX) || !all_finite(state->xi, NECC_NXI)) {
        return R(-1.0);
    }
    seen(x, state->r, at);
    share = share_of_level(at, state->xi, state->r@theta_of_state@);
    return isfinite(share) ? R(1.0) - share : R(-1.0);
}
@set_target@
@set_parameter@

/* What a large xi is, what a large V is, and V over xi^2 at these sizes. */
static const necc_real xi_size[NECC_NXI] = {@xi_size@};
static const necc_real V_size = @V_size@;
static const necc_real stiffness[NECC_NXI] = {@stiffness@};

/* V(x, xi) up to a term in x alone, and its gradient along xi. */
static necc_real energy(const necc_real x[NECC_NX], const necc_real xi[NECC_NXI],
                        necc_real gradient[NECC_NXI])
{
    shape_terms s;
    shape(x, xi, &s);
    energy_slope(x, xi, @law_arguments@, gradient);
    return s.value;
}

/* Central differences of the gradient along xi, symmetrised. */
static void energy_hessian(const necc_real x[NECC_NX], const necc_real xi[NECC_NXI],
                           necc_real hessian[NECC_NXI][NECC_NXI])
{
    necc_real at[NECC_NXI], up[NECC_NXI], down[NECC_NXI];
    int i, j;
    for (i = 0; i < NECC_NXI; ++i) {
        const necc_real h = @cbrt_eps@ * (xi_size[i] + @fabs@(xi[i]));
        (void)memcpy(at, xi, sizeof at);
        at[i] = xi[i] + h;
        (void)energy(x, at, up);
        at[i] = xi[i] - h;
        (void)energy(x, at, down);
        for (j = 0; j < NECC_NXI; ++j) {
            hessian[i][j] = (up[j] - down[j]) / (h + h);
        }
    }
    for (i = 0; i < NECC_NXI; ++i) {
        for (j = 0; j < i; ++j) {
            hessian[i][j] = R(0.5) * (hessian[i][j] + hessian[j][i]);
            hessian[j][i] = hessian[i][j];
        }
    }
}

/* step = -(A + shift diag(stiffness))^-1 g by Cholesky's method; 0 when the matrix is not positive definite. */
static int newton_step(necc_real A[NECC_NXI][NECC_NXI], necc_real shift,
                       const necc_real g[NECC_NXI], necc_real step[NECC_NXI])
{
    necc_real L[NECC_NXI][NECC_NXI];
    int i, j, k;
    for (i = 0; i < NECC_NXI; ++i) {
        for (j = 0; j <= i; ++j) {
            necc_real sum = A[i][j] + (i == j ? shift * stiffness[i] : R(0.0));
            for (k = 0; k < j; ++k) {
                sum -= L[i][k] * L[j][k];
            }
            if (i == j && !(sum > R(0.0))) {
                return 0;
            }
            L[i][j] = i == j ? @sqrt@(sum) : sum / L[j][j];
        }
    }
    for (i = 0; i < NECC_NXI; ++i) {
        step[i] = -g[i];
        for (k = 0; k < i; ++k) {
            step[i] -= L[i][k] * step[k];
        }
        step[i] /= L[i][i];
    }
    for (i = NECC_NXI - 1; i >= 0; --i) {
        for (k = i + 1; k < NECC_NXI; ++k) {
            step[i] -= L[k][i] * step[k];
        }
        step[i] /= L[i][i];
    }
    return 1;
}

/* A step that goes down: Newton's (returns 1), or with the least shift of 1e-3, 1e-2, ... that
 * gives one; zero when there is none. */
static int descent_step(const necc_real x[NECC_NX], const necc_real xi[NECC_NXI],
                        const necc_real g[NECC_NXI], necc_real step[NECC_NXI])
{
    necc_real hessian[NECC_NXI][NECC_NXI], shift = R(1e-3);
    int tries, i;
    for (i = 0; i < NECC_NXI; ++i) {
        step[i] = R(0.0);
    }
    energy_hessian(x, xi, hessian);
    if (newton_step(hessian, R(0.0), g, step) != 0) {
        return 1;
    }
    for (tries = 0; tries < 12 && newton_step(hessian, shift, g, step) == 0; ++tries) {
        shift *= R(10.0);
    }
    return 0;
}

static necc_real product(const necc_real *a, const necc_real *b)
{
    necc_real sum = R(0.0);
    int i;
    for (i = 0; i < NECC_NXI; ++i) {
        sum += a[i] * b[i];
    }
    return sum;
}

/* From xi to a minimum of V(x0, .): damped Newton method with Armijo's rule, at most 50 steps with
 * 30 halvings each. */
static int least_over_xi(const necc_real x0[NECC_NX], necc_real xi[NECC_NXI])
{
    necc_real g[NECC_NXI], step[NECC_NXI], trial[NECC_NXI], unused[NECC_NXI];
    int i, iteration, halvings;
    for (iteration = 0; iteration < 50; ++iteration) {
        const necc_real value = energy(x0, xi, g);
        const int convex = descent_step(x0, xi, g, step);
        const necc_real slope = product(g, step);
        int last = 0;
        necc_real length = R(1.0);
        if (-slope <= @tiny@ * (V_size + @fabs@(value))) {
            last = 1; /* below rounding */
        }
        for (halvings = 0; halvings < 30; ++halvings) {
            for (i = 0; i < NECC_NXI; ++i) {
                trial[i] = xi[i] + length * step[i];
            }
            if (last != 0 || energy(x0, trial, unused) <= value + R(1e-4) * length * slope) {
                break;
            }
            length *= R(0.5);
        }
        if (halvings == 30 || all_finite(trial, NECC_NXI) == 0) {
            break;
        }
        (void)memcpy(xi, trial, sizeof trial);
        if (last != 0) {
            return (convex != 0) ? NECC_OK : NECC_NOT_CONVERGED;
        }
    }
    return NECC_NOT_CONVERGED;
}

int necc_init_at(necc_state *state, const necc_real x0[NECC_NX])
{
    necc_init(state);
    return (all_finite(x0, NECC_NX) != 0) ? least_over_xi(x0, state->xi) : NECC_REJECTED;
}

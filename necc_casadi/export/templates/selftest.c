/* selftest.c: compares the controller with test_vectors.h; exit status 0 when all is well. */
#include "necc.h"
#include "test_vectors.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

static double worst = 0.0; /* largest error, relative to the scale of the output */
static int failures = 0;

static void compare(const necc_real *got, const double *expected, const double *scale, int count)
{
    int i;
    for (i = 0; i < count; ++i) {
        const double error = fabs((double)got[i] - expected[i]) / scale[i];
        if (!(error <= NECC_TOLERANCE)) {
            ++failures;
        }
        if (!(error <= worst)) {
            worst = error;
        }
    }
}

static void check(int holds, const char *what)
{
    if (!holds) {
        ++failures;
        printf("failed: %s\n", what);
    }
}

/* necc_output, then necc_update, and the next necc_output: to the bit what necc_step left. */
static void check_halves(const necc_vector *v, const necc_state *stepped)
{
    necc_real u[NECC_NU];
    necc_state state;
    int i, flags;
    necc_init(&state);
    for (i = 0; i < NECC_NXI; ++i) {
        state.xi[i] = v->xi[i];
    }
    flags = necc_output(&state, v->x, u);
    check(flags == v->flags, "flags of necc_output");
    compare(u, v->input, v->u_scale, NECC_NU);
    check(necc_update(&state, v->dt) == NECC_OK, "necc_update");
    check(!(necc_output(&state, necc_vectors[0].x, u) & NECC_REJECTED), "next necc_output");
    for (i = 0; i < NECC_NXI; ++i) {
        check(!(state.xi[i] < stepped->xi[i] || state.xi[i] > stepped->xi[i]), "halves of a step");
    }
}

static void check_vector(const necc_vector *v)
{
    necc_real u[NECC_NU], xidot[NECC_NXI];
    necc_state state;
    int i;
    necc_control(v->x, v->xi, u, xidot);
    compare(u, v->u, v->u_scale, NECC_NU);
    compare(xidot, v->xidot, v->xidot_scale, NECC_NXI);
    necc_init(&state);
    for (i = 0; i < NECC_NXI; ++i) {
        state.xi[i] = v->xi[i];
    }
    check(necc_step(&state, v->x, u, v->dt) == v->flags, "flags of necc_step");
    compare(u, v->input, v->u_scale, NECC_NU);
    for (i = 0; i < NECC_NXI; ++i) {
        check(!(state.xi[i] < v->xi[i] || state.xi[i] > v->xi[i]), "xi kept by the first sample");
    }
    check(!(necc_step(&state, necc_vectors[0].x, u, v->dt) & NECC_REJECTED), "next sample");
    compare(state.xi, v->next, v->next_scale, NECC_NXI);
    check_halves(v, &state);
}

static void check_rejection(necc_real bad)
{
    necc_real x[NECC_NX], u[NECC_NU];
    necc_state state;
    int i;
    necc_init(&state);
    for (i = 0; i < NECC_NX; ++i) {
        x[i] = necc_vectors[0].x[i];
    }
    x[NECC_NX - 1] = bad;
    check(necc_step(&state, x, u, necc_vectors[0].dt) == NECC_REJECTED, "rejection");
    for (i = 0; i < NECC_NU; ++i) {
        check(fpclassify(u[i]) == FP_ZERO, "u = 0 when rejected");
    }
}

/* Far out and next to zero, the result is finite or rejected. */
static void check_finite(necc_real far)
{
    necc_real x[NECC_NX], u[NECC_NU];
    necc_state state;
    int i, flags;
    necc_init(&state);
    for (i = 0; i < NECC_NX; ++i) {
        x[i] = far;
    }
    flags = necc_step(&state, x, u, necc_vectors[0].dt);
    for (i = 0; i < NECC_NU; ++i) {
        check(isfinite(u[i]), "finite u");
    }
    for (i = 0; i < NECC_NXI; ++i) {
        check(isfinite(state.xi[i]), "finite xi");
    }
    flags |= necc_init_at(&state, x);
    for (i = 0; i < NECC_NXI; ++i) {
        check(isfinite(state.xi[i]), "finite xi of necc_init_at");
    }
    check((flags & ~(NECC_SATURATED | NECC_REJECTED | NECC_NOT_CONVERGED)) == 0, "known flags");
}

int main(void)
{
    int i;
    for (i = 0; i < NECC_VECTORS; ++i) {
        check_vector(&necc_vectors[i]);
    }
    check_rejection((necc_real)NAN);
    check_rejection((necc_real)INFINITY);
    check_finite((necc_real)1e30);
    check_finite((necc_real)-1e30);
    check_finite((necc_real)1e-40);
    printf("%d vectors, largest error %.3g, %d failures\n", NECC_VECTORS, worst, failures);
    return failures == 0 ? EXIT_SUCCESS : EXIT_FAILURE;
}

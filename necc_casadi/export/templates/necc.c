/* necc.c: see necc.h. Design @design_hash@.
 */
#include "necc.h"

#ifndef @guard@
#error "necc.c and necc.h belong to different designs."
#endif

#include <float.h>
#include <math.h>
#include <stdint.h>
#include <string.h>

#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "necc.c rounds by adding and tests for NaN: compile it without -ffast-math."
#endif
#if FLT_EVAL_METHOD == 1 || FLT_EVAL_METHOD == 2
#error "necc.c needs arithmetic in its own type: on 32-bit x86 add -msse2 -mfpmath=sse."
#endif

const int necc_dimensions[4] = {NECC_NX, NECC_NXI, NECC_NU, (int)sizeof(necc_real)};

@sizes@
#define R(literal) @literal@

/* Weights, column by column. */

@weights@

@kernels@

@networks@

/* Plant terms. */

@leaves@
/* V = Phi(H + Hc, C) by its parts. */
typedef struct {
@parts@
} shape_terms;

static void shape(const necc_real x[NECC_NX], const necc_real xi[NECC_NXI], shape_terms *s)
{
@shape@
}

void necc_control(const necc_real x[NECC_NX], const necc_real xi[NECC_NXI],
                  necc_real u[NECC_NU], necc_real xidot[NECC_NXI])
{
    shape_terms s;
    shape(x, xi, &s);
    control_law(x, xi, @law_arguments@, u, xidot);
}

/* @rate_of@ */
static void rate(const necc_real x[NECC_NX], const necc_real xi[NECC_NXI]@share_parameter@,
                 necc_real xidot[NECC_NXI])
{
    shape_terms s;
    shape(x, xi, &s);
    state_rate(x, xi, @law_arguments@@share@, xidot);
}

static int all_finite(const necc_real *v, int count)
{
    int i;
    for (i = 0; i < count; ++i) {
        if (!isfinite(v[i])) {
            return 0;
        }
    }
    return 1;
}

@integrator@

@saturation@
@seen@
void necc_init(necc_state *state)
{
    static const necc_real xi[NECC_NXI] = {@xi_star@};
    (void)memset(state, 0, sizeof *state);
    (void)memcpy(state->xi, xi, sizeof xi);@reset_target@
}

@init_at@
int necc_start(necc_state *state, const necc_real x0[NECC_NX])
{
@start@
}

/* sum += change, and rest keeps what rounding takes away from the sum (Knuth's sum of two). */
static void accumulate(necc_real *sum, necc_real *rest, necc_real change)
{
    const necc_real due = change + *rest;
    const necc_real next = *sum + due;
    const necc_real moved = next - *sum;
    *rest = (*sum - (next - moved)) + (due - moved);
    *sum = next;
}

@integral@
@update@
static void no_input(necc_real u[NECC_NU])
{
    int i;
    for (i = 0; i < NECC_NU; ++i) {
        u[i] = R(0.0);
    }
}

int necc_output(necc_state *state, const necc_real x[NECC_NX], necc_real u[NECC_NU])
{
    necc_state next;
    necc_real v[NECC_NU], xidot[NECC_NXI];@parts_of_u@@counter@@held@
    no_input(u);
    if (all_finite(x, NECC_NX) == 0 || all_finite(state->xi, NECC_NXI) == 0) {
        return NECC_REJECTED;
    }
    next = *state;
    @see@@arrive@@law@
    if (all_finite(v, NECC_NU) == 0 || all_finite(xidot, NECC_NXI) == 0) {
        return NECC_REJECTED;
    }
    (void)memcpy(next.x, @at@, sizeof next.x);@remember@
    next.sampled = 1;
    *state = next;
    (void)memcpy(u, v, sizeof v);
    return @saturate@;
}

int necc_step(necc_state *state, const necc_real x[NECC_NX], necc_real u[NECC_NU], necc_real dt)
{
    necc_state next;
    int flags;
    no_input(u);
    next = *state;
    flags = necc_update(&next, dt);
    if (flags == NECC_OK) {
        flags = necc_output(&next, x, u);
    }
    if ((flags & NECC_REJECTED) == 0) {
        *state = next;
    }
    return flags;
}

@target@
@margin@

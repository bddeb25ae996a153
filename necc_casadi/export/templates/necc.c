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

static int all_finite(const necc_real *v, int count)
{
    int i;
    for (i = 0; i < count; ++i)
        if (!isfinite(v[i]))
            return 0;
    return 1;
}

@integrator@

@saturation@
@integral@
@seen@
void necc_init(necc_state *state)
{
    static const necc_real xi[NECC_NXI] = {@xi_star@};
    memset(state, 0, sizeof *state);
    memcpy(state->xi, xi, sizeof xi);@reset_target@
}

@init_at@
int necc_start(necc_state *state, const necc_real x0[NECC_NX])
{
@start@
}

int necc_step(necc_state *state, const necc_real x[NECC_NX], necc_real u[NECC_NU], necc_real dt)
{
    necc_real v[NECC_NU], next[NECC_NXI], rate[NECC_NXI];@counter@@held@
    memset(u, 0, NECC_NU * sizeof *u);
    if (!(dt >= R(0.0)) || !isfinite(dt) || !all_finite(x, NECC_NX) || !all_finite(state->xi, NECC_NXI))
        return NECC_REJECTED;
    memcpy(next, state->xi, sizeof next);@keep@
    if (state->sampled) {
        advance(state, dt, next);@integrate@
    }
    @see@necc_control(@at@, next, v, rate);@subtract@@forward@
    if (!all_finite(v, NECC_NU) || !all_finite(next, NECC_NXI) || !all_finite(rate, NECC_NXI))
        return NECC_REJECTED;
    memcpy(state->xi, next, sizeof next);@store@
    memcpy(state->x, @at@, sizeof state->x);
    memcpy(state->xidot, rate, sizeof rate);
    state->sampled = 1;
    memcpy(u, v, sizeof v);
    return @saturate@;
}

@target@
@margin@

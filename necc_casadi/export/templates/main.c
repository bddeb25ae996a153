/* main.c: the controller of necc.h in closed loop with its plant; prints CSV.
 *
 *   demo [steps [x1 x2 ...]]      steps of @sample_time@ s, from the measured state given
 */
#include "necc.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define SAMPLE_TIME @sample_literal@

/* The plant: xdot = (J - R) grad H + G u. */
@plant@
/* What the controller takes, y, of the plant's state x, and back. */
@measure@
/* One Runge-Kutta step of the plant with u held. */
static void plant_step(necc_real x[NECC_NX], const necc_real u[NECC_NU], necc_real dt)
{
    static const necc_real fraction[4] = {@rk4_fractions@};
    static const necc_real weight[4] = {@rk4_weights@}; /* sixths */
    necc_real k[NECC_NX] = {0}, trial[NECC_NX], next[NECC_NX];
    int i, stage;
    memcpy(next, x, sizeof next);
    for (stage = 0; stage < 4; ++stage) {
        for (i = 0; i < NECC_NX; ++i) {
            trial[i] = x[i] + dt * fraction[stage] * k[i];
        }
        plant(trial, u, k);
        for (i = 0; i < NECC_NX; ++i) {
            next[i] += dt * weight[stage] / @six@ * k[i];
        }
    }
    memcpy(x, next, sizeof next);
}

static void print_row(const necc_real *values, int count)
{
    int i;
    for (i = 0; i < count; ++i) {
        printf(",%.@digits@g", (double)values[i]);
    }
}

int main(int argc, char **argv)
{
    necc_real y[NECC_NX] = {@x_start@}, x[NECC_NX];
    necc_real u[NECC_NU];
    necc_state state;
    long step, steps = argc > 1 ? strtol(argv[1], NULL, 10) : @steps@;
    int i, flags = NECC_OK;
    for (i = 0; i < NECC_NX && i + 2 < argc; ++i) {
        y[i] = (necc_real)strtod(argv[i + 2], NULL);
    }
    model_state(y, x);
    necc_start(&state, y);
    printf("@columns@\n");
    for (step = 0; step < steps; ++step) {
        flags = necc_step(&state, y, u, step == 0 ? @zero@ : SAMPLE_TIME);
        printf("%.9g", (double)step * (double)SAMPLE_TIME);
        print_row(y, NECC_NX);
        print_row(state.xi, NECC_NXI);
#if NECC_HAS_INTEGRAL
        print_row(state.zeta, NECC_NU);
#endif
        print_row(u, NECC_NU);
        printf(",%d\n", flags);
        plant_step(x, u, SAMPLE_TIME);
        measure(x, y);
    }
    return flags & NECC_REJECTED ? EXIT_FAILURE : EXIT_SUCCESS;
}

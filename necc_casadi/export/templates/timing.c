/* timing.c: prints ns per necc_control and per necc_step, each the best of 50 blocks. */
#include "necc.h"

#include <stdio.h>
#include <time.h>

#define CALLS 200

static volatile necc_real sink;

static double control_block(const necc_state *start)
{
    necc_real x[NECC_NX] = {0}, u[NECC_NU], xidot[NECC_NXI];
    const clock_t began = clock();
    int i;
    for (i = 0; i < CALLS; ++i) {
        x[0] = (necc_real)i / CALLS;
        necc_control(x, start->xi, u, xidot);
        sink = u[0];
    }
    return (double)(clock() - began) / CLOCKS_PER_SEC;
}

static double step_block(const necc_state *start)
{
    necc_real x[NECC_NX] = {0}, u[NECC_NU];
    necc_state state = *start;
    const clock_t began = clock();
    int i;
    for (i = 0; i < CALLS; ++i) {
        x[0] = (necc_real)i / CALLS;
        (void)necc_step(&state, x, u, (necc_real)0.0001);
        sink = u[0];
    }
    return (double)(clock() - began) / CLOCKS_PER_SEC;
}

static double best(double (*block)(const necc_state *), const necc_state *start)
{
    double least = 1e9;
    int i;
    for (i = 0; i < 50; ++i) {
        const double seconds = block(start);
        least = seconds > 0 && seconds < least ? seconds : least;
    }
    return least * 1e9 / CALLS;
}

int main(void)
{
    necc_state state;
    necc_init(&state);
    printf("%.6g %.6g\n", best(control_block, &state), best(step_block, &state));
    return 0;
}

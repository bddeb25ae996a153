/* test_vectors.h: what the control law and necc_step return, computed by CasADi in double.
 *
 * Inputs are exact in necc_real; an output is right within NECC_TOLERANCE times its scale, which
 * is its natural size and the size of the terms that may cancel in it.
 */
#ifndef NECC_TEST_VECTORS_H
#define NECC_TEST_VECTORS_H

#include "necc.h"

#define NECC_VECTORS @count@
#define NECC_TOLERANCE @tolerance@

typedef struct {
    necc_real x[NECC_NX];
    necc_real xi[NECC_NXI];
    necc_real dt;
    double u[NECC_NU];         /* of necc_control */
    double xidot[NECC_NXI];    /* of necc_control */
    double input[NECC_NU];     /* of necc_step: u within its limits */
    double next[NECC_NXI];     /* xi at the next sample, dt later and with the first vector's x */
    double u_scale[NECC_NU], xidot_scale[NECC_NXI], next_scale[NECC_NXI];
    int flags;                 /* of necc_step at the first */
} necc_vector;

static const necc_vector necc_vectors[NECC_VECTORS] = {
@vectors@
};

#endif

/* necc.h: controller of @title@, held at @target@.
 *
@law@
 *
 * Everything here is reentrant: no heap, no globals, no state but the caller's.
 *
 * What is claimed of this design@claims@
 */
#ifndef NECC_H
#define NECC_H

#define NECC_INTERFACE 3 /* version of the functions below */
#define NECC_DESIGN "@design_hash@"
#define @guard@
@certificate_define@
#define NECC_NX @n@ /* plant states */
#define NECC_NXI @nc@ /* controller states */
#define NECC_NU @m@ /* inputs */
#define NECC_HAS_INTEGRAL @has_integral@
@has_target@
@margin_constants@
@sample_define@@sampling@

/* Order and units:
@order@
@measured@
 */

#ifdef __cplusplus
extern "C" {
#endif

typedef @real@ necc_real;

typedef struct {
    necc_real xi[NECC_NXI];@zeta@@r@
    necc_real x[NECC_NX]; /* of the last sample, as the law takes it */
@members@@zeta_rest@
    int sampled; /* 0 before the first sample */@moved@
} necc_state;

/* Flags that a function returns, added; 0 when there is nothing to report. */
#define NECC_OK 0
#define NECC_SATURATED 1 /* u was @limited@@limits@ */
#define NECC_REJECTED 2 /* x, xi or dt not finite, dt < 0, or overflow: u = 0, state kept */
#define NECC_NOT_CONVERGED 4 /* no minimum of V(x0, .) was reached: xi is the best found */

/* For programs that load the code: NECC_NX, NECC_NXI, NECC_NU, sizeof(necc_real). */
extern const int necc_dimensions[4];

/* xi at the designed equilibrium. */
void necc_init(necc_state *state);

/* xi at the minimum of V(x0, .) that Newton's method reaches from the designed equilibrium.
 * Not finite x0: as necc_init, and NECC_REJECTED. */
int necc_init_at(necc_state *state, const necc_real x0[NECC_NX]);

/* xi(0) of this design for the first measurement x0: @start_text@. */
int necc_start(necc_state *state, const necc_real x0[NECC_NX]);

/* The control law, not saturated, and the controller's dynamics at (x, xi); pure. */
void necc_control(const necc_real x[NECC_NX], const necc_real xi[NECC_NXI],
                  necc_real u[NECC_NU], necc_real xidot[NECC_NXI]);

/* u from the measured x and the present xi: apply it until the next sample. */
int necc_output(necc_state *state, const necc_real x[NECC_NX], necc_real u[NECC_NU]);

@update_text@
int necc_update(necc_state *state, necc_real dt);

/* One sample: necc_update over dt, then necc_output. dt is the time since the last sample, 0 at the
 * first, where nothing advances; a rejected call changes nothing and is no sample.
 * Where the time to the next sample is known, u need not wait for xi: the same values come of
 * necc_output, u applied, and then necc_update over the time that the sample is going to last. */
int necc_step(necc_state *state, const necc_real x[NECC_NX], necc_real u[NECC_NU], necc_real dt);

@set_target@
@margin@

#ifdef __cplusplus
}
#endif

#endif

/* fmu.c: the controller of necc.h as an FMI 2.0 co-simulation unit.
 *
 * Inputs x and the target, outputs u, xi, zeta, the margin (see necc.h) and flags; parameters may be
 * told at any time. u follows x at once: it is the law at the present x and xi. fmi2DoStep(h) is one
 * necc_step, with dt what passed since the last; xi is that of the present. Value references: x, u,
 * xi, zeta, margin, target, parameters; Integer 0 is flags, 1 what becomes of xi (necc_set_switch);
 * Boolean 0 tells whether xi starts at the minimum of V(x, .); if not, it starts @otherwise@.
 */
#include "necc.h"

#include <stddef.h>
#include <string.h>

#define GUID "@guid@"
/* Value references of the first of each kind. */
#define ZETA (NECC_NX + NECC_NU + NECC_NXI)
#define MARGIN (ZETA + NECC_HAS_INTEGRAL * NECC_NU)
#define TARGETS (MARGIN + NECC_HAS_MARGIN)
#if NECC_HAS_TARGET
#define PARAMETERS (TARGETS + NECC_NR)
#else
#define PARAMETERS TARGETS
#endif

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#elif defined(__GNUC__)
#define EXPORT __attribute__((visibility("default")))
#else
#define EXPORT
#endif
/* Declares a function and begins its definition. */
#define FUNCTION(type, name, ...) \
    EXPORT type name(__VA_ARGS__); \
    EXPORT type name(__VA_ARGS__)

typedef void *fmi2Component;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer;
typedef int fmi2Boolean;
typedef const char *fmi2String;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;

typedef struct {
    void (*logger)(void *, fmi2String, fmi2Status, fmi2String, fmi2String, ...);
    void *(*allocateMemory)(size_t, size_t);
    void (*freeMemory)(void *);
    void (*stepFinished)(void *, fmi2Status);
    void *componentEnvironment;
} fmi2CallbackFunctions;

typedef struct {
    necc_state state;
    necc_real x[NECC_NX];
#if NECC_HAS_TARGET
    necc_real target[NECC_NR]; /* commanded; the state has the one that is applied */
#endif
#if NECC_HAS_PARAMETER
    necc_real parameters[NECC_NTHETA]; /* told; taken with the next sample */
#endif
    necc_real since; /* the last sample, s */
    int flags;
    int start_at_minimum;
    int how; /* what becomes of xi where the target or a parameter changes */
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
} instance;

static void set_defaults(instance *self)
{
    static const necc_real x[NECC_NX] = {@x_star@};
    memcpy(self->x, x, sizeof x);
    self->start_at_minimum = @start_at_minimum@;
    self->since = 0;
    self->flags = NECC_OK;
    necc_init(&self->state);
#if NECC_HAS_TARGET
    necc_get_target(&self->state, self->target);
#endif
#if NECC_HAS_PARAMETER
    necc_get_parameter(&self->state, self->parameters);
#endif
    self->how = 0;
}

FUNCTION(fmi2String, fmi2GetTypesPlatform, void) { return "default"; }
FUNCTION(fmi2String, fmi2GetVersion, void) { return "2.0"; }

FUNCTION(fmi2Component, fmi2Instantiate, fmi2String name, int type, fmi2String guid,
         fmi2String resources, const fmi2CallbackFunctions *functions, fmi2Boolean visible,
         fmi2Boolean logging)
{
    instance *self;
    (void)name, (void)resources, (void)visible, (void)logging;
    if (type != 1 || strcmp(guid, GUID) != 0) {
        return NULL;
    }
    self = functions->allocateMemory(1, sizeof *self);
    if (self != NULL) {
        self->allocate = functions->allocateMemory;
        self->release = functions->freeMemory;
        set_defaults(self);
    }
    return self;
}

FUNCTION(void, fmi2FreeInstance, fmi2Component c)
{
    if (c != NULL) {
        ((instance *)c)->release(c);
    }
}

FUNCTION(fmi2Status, fmi2SetDebugLogging, fmi2Component c, fmi2Boolean on, size_t n,
         const fmi2String categories[])
{
    (void)c, (void)on, (void)n, (void)categories;
    return fmi2OK;
}

FUNCTION(fmi2Status, fmi2SetupExperiment, fmi2Component c, fmi2Boolean tolerance_given,
         fmi2Real tolerance, fmi2Real start, fmi2Boolean stop_given, fmi2Real stop)
{
    (void)c, (void)tolerance_given, (void)tolerance, (void)start, (void)stop_given, (void)stop;
    return fmi2OK;
}

FUNCTION(fmi2Status, fmi2EnterInitializationMode, fmi2Component c)
{
    (void)c;
    return fmi2OK;
}

FUNCTION(fmi2Status, fmi2ExitInitializationMode, fmi2Component c)
{
    instance *self = c;
    self->flags = NECC_OK;
    if (self->start_at_minimum) {
        self->flags = necc_init_at(&self->state, self->x);
    } else {
        self->flags = @start_otherwise@;
    }
    return self->flags == NECC_OK ? fmi2OK : fmi2Warning;
}

FUNCTION(fmi2Status, fmi2Terminate, fmi2Component c)
{
    (void)c;
    return fmi2OK;
}

FUNCTION(fmi2Status, fmi2Reset, fmi2Component c)
{
    set_defaults(c);
    return fmi2OK;
}

/* One sample of a state at the present x, for the set-point and the parameters that are applied. */
static int sample(const instance *self, necc_state *state, necc_real u[NECC_NU])
{
    int flags = necc_step(state, self->x, u, self->since);
#if NECC_HAS_TARGET || NECC_HAS_PARAMETER
    int added = NECC_OK;
    if (flags & NECC_REJECTED) {
        return flags;
    }
    necc_set_switch(state, self->how);
#if NECC_HAS_PARAMETER
    added |= necc_set_parameter(state, self->parameters);
#endif
#if NECC_HAS_TARGET
    added |= necc_set_target(state, self->x, self->target);
#endif
    if (added & NECC_REJECTED) /* a command that is no number */
        added = (added & ~NECC_REJECTED) | NECC_OUTSIDE;
    flags = added | necc_step(state, self->x, u, (necc_real)0);
#endif
    return flags;
}

FUNCTION(fmi2Status, fmi2DoStep, fmi2Component c, fmi2Real time, fmi2Real h, fmi2Boolean no_way_back)
{
    instance *self = c;
    necc_real u[NECC_NU];
    (void)time, (void)no_way_back;
    self->flags = sample(self, &self->state, u);
    if (self->flags & NECC_REJECTED) {
        self->since += (necc_real)h;
        return fmi2Warning;
    }
    self->since = (necc_real)h;
    return fmi2OK;
}

/* The present state, and the input there, within its limits. */
static necc_state present(const instance *self, necc_real u[NECC_NU])
{
    necc_state now = self->state;
    (void)sample(self, &now, u);
    return now;
}

FUNCTION(fmi2Status, fmi2GetReal, fmi2Component c, const fmi2ValueReference vr[], size_t n,
         fmi2Real value[])
{
    const instance *self = c;
    necc_real u[NECC_NU];
    const necc_state now = present(self, u);
    size_t i;
    for (i = 0; i < n; ++i) {
        const fmi2ValueReference r = vr[i];
        if (r < NECC_NX) {
            value[i] = (double)self->x[r];
        } else if (r < NECC_NX + NECC_NU) {
            value[i] = (double)u[r - NECC_NX];
        } else if (r < NECC_NX + NECC_NU + NECC_NXI) {
            value[i] = (double)now.xi[r - NECC_NX - NECC_NU];
        }
#if NECC_HAS_INTEGRAL
        else if (r < MARGIN) {
            value[i] = (double)now.zeta[r - ZETA];
        }
#endif
#if NECC_HAS_MARGIN
        else if (r == MARGIN) {
            value[i] = (double)necc_margin(&now, self->x);
        }
#endif
#if NECC_HAS_TARGET
        else if (r >= TARGETS && r < TARGETS + NECC_NR) {
            value[i] = (double)self->target[r - TARGETS];
        }
#endif
#if NECC_HAS_PARAMETER
        else if (r >= PARAMETERS && r < PARAMETERS + NECC_NTHETA) {
            value[i] = (double)self->parameters[r - PARAMETERS];
        }
#endif
        else {
            return fmi2Error;
        }
    }
    return fmi2OK;
}

FUNCTION(fmi2Status, fmi2SetReal, fmi2Component c, const fmi2ValueReference vr[], size_t n,
         const fmi2Real value[])
{
    instance *self = c;
    size_t i;
    for (i = 0; i < n; ++i) {
#if NECC_HAS_TARGET
        if (vr[i] >= TARGETS && vr[i] < TARGETS + NECC_NR) {
            self->target[vr[i] - TARGETS] = (necc_real)value[i];
            continue;
        }
#endif
#if NECC_HAS_PARAMETER
        if (vr[i] >= PARAMETERS && vr[i] < PARAMETERS + NECC_NTHETA) {
            self->parameters[vr[i] - PARAMETERS] = (necc_real)value[i];
            continue;
        }
#endif
        if (vr[i] >= NECC_NX) {
            return fmi2Error;
        }
        self->x[vr[i]] = (necc_real)value[i];
    }
    return fmi2OK;
}

FUNCTION(fmi2Status, fmi2GetInteger, fmi2Component c, const fmi2ValueReference vr[], size_t n,
         fmi2Integer value[])
{
    size_t i;
    for (i = 0; i < n; ++i) {
        if (vr[i] > 1) {
            return fmi2Error;
        }
        value[i] = vr[i] == 0 ? ((const instance *)c)->flags : ((const instance *)c)->how;
    }
    return fmi2OK;
}

FUNCTION(fmi2Status, fmi2SetInteger, fmi2Component c, const fmi2ValueReference vr[], size_t n,
         const fmi2Integer value[])
{
    size_t i;
    for (i = 0; i < n; ++i) {
        if (vr[i] != 1) {
            return fmi2Error;
        }
        ((instance *)c)->how = value[i];
    }
    return fmi2OK;
}

FUNCTION(fmi2Status, fmi2GetBoolean, fmi2Component c, const fmi2ValueReference vr[], size_t n,
         fmi2Boolean value[])
{
    size_t i;
    for (i = 0; i < n; ++i) {
        if (vr[i] != 0) {
            return fmi2Error;
        }
        value[i] = ((const instance *)c)->start_at_minimum;
    }
    return fmi2OK;
}

FUNCTION(fmi2Status, fmi2SetBoolean, fmi2Component c, const fmi2ValueReference vr[], size_t n,
         const fmi2Boolean value[])
{
    size_t i;
    for (i = 0; i < n; ++i) {
        if (vr[i] != 0) {
            return fmi2Error;
        }
        ((instance *)c)->start_at_minimum = value[i] != 0;
    }
    return fmi2OK;
}

/* Variables of a kind that this unit does not have. */
#define NOTHING(name, type) \
    FUNCTION(fmi2Status, name, fmi2Component c, const fmi2ValueReference vr[], size_t n, type v[]) \
    { \
        (void)c, (void)vr, (void)v; \
        return n == 0 ? fmi2OK : fmi2Error; \
    }
NOTHING(fmi2GetString, fmi2String)
NOTHING(fmi2SetString, const fmi2String)

FUNCTION(fmi2Status, fmi2GetFMUstate, fmi2Component c, void **saved)
{
    const instance *self = c;
    if (*saved == NULL) {
        *saved = self->allocate(1, sizeof *self);
    }
    if (*saved == NULL) {
        return fmi2Error;
    }
    memcpy(*saved, self, sizeof *self);
    return fmi2OK;
}

FUNCTION(fmi2Status, fmi2SetFMUstate, fmi2Component c, void *saved)
{
    memcpy(c, saved, sizeof(instance));
    return fmi2OK;
}

FUNCTION(fmi2Status, fmi2FreeFMUstate, fmi2Component c, void **saved)
{
    if (*saved != NULL) {
        ((instance *)c)->release(*saved);
    }
    *saved = NULL;
    return fmi2OK;
}

FUNCTION(fmi2Status, fmi2SerializedFMUstateSize, fmi2Component c, void *saved, size_t *size)
{
    (void)c, (void)saved, (void)size;
    return fmi2Error;
}

FUNCTION(fmi2Status, fmi2SerializeFMUstate, fmi2Component c, void *saved, char bytes[], size_t n)
{
    (void)c, (void)saved, (void)bytes, (void)n;
    return fmi2Error;
}

FUNCTION(fmi2Status, fmi2DeSerializeFMUstate, fmi2Component c, const char bytes[], size_t n,
         void **saved)
{
    (void)c, (void)saved, (void)bytes, (void)n;
    return fmi2Error;
}

FUNCTION(fmi2Status, fmi2GetDirectionalDerivative, fmi2Component c,
         const fmi2ValueReference unknown[], size_t n_unknown, const fmi2ValueReference known[],
         size_t n_known, const fmi2Real seed[], fmi2Real product[])
{
    (void)c, (void)unknown, (void)n_unknown, (void)known, (void)n_known, (void)seed, (void)product;
    return fmi2Error;
}

FUNCTION(fmi2Status, fmi2SetRealInputDerivatives, fmi2Component c, const fmi2ValueReference vr[],
         size_t n, const fmi2Integer order[], const fmi2Real value[])
{
    (void)c, (void)vr, (void)order, (void)value;
    return n == 0 ? fmi2OK : fmi2Error;
}

FUNCTION(fmi2Status, fmi2GetRealOutputDerivatives, fmi2Component c, const fmi2ValueReference vr[],
         size_t n, const fmi2Integer order[], fmi2Real value[])
{
    (void)c, (void)vr, (void)order, (void)value;
    return n == 0 ? fmi2OK : fmi2Error;
}

FUNCTION(fmi2Status, fmi2CancelStep, fmi2Component c)
{
    (void)c;
    return fmi2Error;
}

/* Every step is finished when fmi2DoStep returns, so there is no status to ask for. */
#define NO_STATUS(name, type) \
    FUNCTION(fmi2Status, name, fmi2Component c, int kind, type *value) \
    { \
        (void)c, (void)kind, (void)value; \
        return fmi2Discard; \
    }
NO_STATUS(fmi2GetStatus, fmi2Status)
NO_STATUS(fmi2GetRealStatus, fmi2Real)
NO_STATUS(fmi2GetIntegerStatus, fmi2Integer)
NO_STATUS(fmi2GetBooleanStatus, fmi2Boolean)
NO_STATUS(fmi2GetStringStatus, fmi2String)

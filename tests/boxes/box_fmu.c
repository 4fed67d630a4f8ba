/* An FMI 2.0 co-simulation FMU for the tests, in several builds (-D):

   CONVERTER       a grid-following converter: PLL, current control, inductor; else an R-L branch
   STATE           with get and set of its state
   HIDDEN          its state stands in statics, where no instance and no snapshot reaches it

   Real variables: 0-2 v_a v_b v_c, 3-5 i_a i_b i_c (load direction), 6 p_w, 7 fault, 8 after_s, 9 k_pll, 10 v_alpha,
   11 v_beta, 12 i_alpha, 13 i_beta. From after_s on it misbehaves as `fault` says; fault -1: as p_w says, in MW. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "fmi2Functions.h"

#define THIRD 2.0943951023931953
enum { OK, ERRS, PRINTS, SLEEPS, LEAKS, NANS, ABORTS, SEGFAULTS, DISCARDS, FATAL };

typedef struct {
    double r[16], i[3], theta, x_pll, x_d, x_q, t;
} State;

typedef struct {
    State s;
    const fmi2CallbackFunctions *callbacks;
    int broken; /* for good, after a fatal answer: whoever calls it then is told so */
} Instance;

#ifdef HIDDEN
static State hidden;
#define STATE_OF(c) (&hidden)
#else
#define STATE_OF(c) (&((Instance *)(c))->s)
#endif

static void begin(State *s) {
    memset(s, 0, sizeof *s);
    s->r[9] = 0.5;
}

static void terminals(State *s) { /* alpha and beta, where they are used, in place of the phases */
    if (s->r[10] != 0.0 || s->r[11] != 0.0)
        for (int k = 0; k < 3; k++) s->r[k] = s->r[10] * cos(k * THIRD) + s->r[11] * sin(k * THIRD);
}

static void branch(State *s, double h) { /* L di/dt = v - R i, v held: exact */
    const double decay = exp(-0.1 * h / 1e-3), gain = (1.0 - decay) / 0.1;
    for (int k = 0; k < 3; k++) s->i[k] = decay * s->i[k] + gain * s->r[k];
}

static void converter(State *s, double h) {
    const double R = 3e-3, L = 0.2e-3, w1 = 314.15926535897931;
    double c[3], n[3], v_d = 0, v_q = 0, i_d = 0, i_q = 0, *v = s->r;
    for (int k = 0; k < 3; k++) {
        c[k] = cos(s->theta - k * THIRD);
        n[k] = sin(s->theta - k * THIRD);
        v_d += v[k] * c[k] * 2 / 3;
        v_q -= v[k] * n[k] * 2 / 3;
        i_d -= s->i[k] * c[k] * 2 / 3; /* out of the converter */
        i_q += s->i[k] * n[k] * 2 / 3;
    }
    double wanted = s->r[6] / (1.5 * fmax(fabs(v_d), 100.0)), e_d = wanted - i_d, e_q = -i_q;
    s->x_pll += h * 10.0 * v_q;
    s->theta += h * (w1 + s->r[9] * v_q + s->x_pll);
    if (s->theta > 6.283185307179586) s->theta -= 6.283185307179586;
    s->x_d += h * 40.0 * e_d;
    s->x_q += h * 40.0 * e_q;
    double u_d = 0.9 * v_d + 0.3 * e_d + s->x_d - w1 * L * i_q, u_q = 0.3 * e_q + s->x_q + w1 * L * i_d;
    for (int k = 0; k < 3; k++) {
        double u = u_d * c[k] - u_q * n[k];
        s->i[k] += h / L * (v[k] - u - R * s->i[k]);
    }
}

static volatile int *volatile nowhere;

static fmi2Status misbehave(Instance *c, State *s) {
    int fault = (int)(s->r[7] < 0 ? s->r[6] / 1e6 + 0.5 : s->r[7]);
    if (s->t < s->r[8]) return fmi2OK;
    switch (fault) {
    case ERRS:
        c->callbacks->logger(c->callbacks->componentEnvironment, "box", fmi2Error, "error", "theta left the circle");
        return fmi2Error;
    case PRINTS:
        printf("step at %g s: all is well, and here is a long line about it\n", s->t);
        break;
    case SLEEPS:
        sleep(600);
        break;
    case LEAKS: {
        char *leak = malloc(4096);
        if (leak) memset(leak, 1, 4096);
        break;
    }
    case NANS:
        for (int k = 0; k < 3; k++) s->r[3 + k] = NAN;
        s->r[12] = s->r[13] = NAN;
        break;
    case ABORTS:
        fprintf(stderr, "assertion failed: theta < 2 pi\n");
        abort();
    case SEGFAULTS:
        *nowhere = 1;
        break;
    case DISCARDS:
        return fmi2Discard;
    case FATAL:
        c->broken = 1;
        return fmi2Fatal;
    }
    return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean back) {
    State *s = STATE_OF(c);
    if (((Instance *)c)->broken) return fmi2Fatal;
    (void)back;
    s->t = t;
    terminals(s);
#ifdef CONVERTER
    (void)branch;
    converter(s, h);
#else
    (void)converter;
    branch(s, h);
#endif
    memcpy(s->r + 3, s->i, sizeof s->i);
    s->r[12] = 2.0 / 3.0 * (s->i[0] - 0.5 * s->i[1] - 0.5 * s->i[2]);
    s->r[13] = (s->i[1] - s->i[2]) / sqrt(3.0);
    return misbehave(c, s);
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String where,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging) {
    Instance *c = calloc(1, sizeof *c);
    (void)name, (void)type, (void)guid, (void)where, (void)visible, (void)logging;
    c->callbacks = callbacks;
    begin(STATE_OF(c));
    return c;
}

void fmi2FreeInstance(fmi2Component c) { free(c); }

fmi2Status fmi2Reset(fmi2Component c) {
#ifndef HIDDEN /* the sloppy one forgets */
    begin(STATE_OF(c));
#endif
    (void)c;
    return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference at[], size_t n, fmi2Real x[]) {
    for (size_t k = 0; k < n; k++) x[k] = STATE_OF(c)->r[at[k]];
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference at[], size_t n, const fmi2Real x[]) {
    for (size_t k = 0; k < n; k++) STATE_OF(c)->r[at[k]] = x[k];
    return fmi2OK;
}

#ifdef STATE
fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *to) {
    if (!*to) *to = malloc(sizeof(State));
    memcpy(*to, STATE_OF(c), sizeof(State));
    return fmi2OK;
}
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate from) {
    memcpy(STATE_OF(c), from, sizeof(State));
    return fmi2OK;
}
#else
fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *to) { return (void)c, (void)to, fmi2Error; }
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate from) { return (void)c, (void)from, fmi2Error; }
#endif
fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *from) {
    (void)c;
    free(*from);
    *from = NULL;
    return fmi2OK;
}

/* what the standard wants to be there, and nobody here calls */
#define NONE(name, ...) \
    fmi2Status name(fmi2Component c, __VA_ARGS__) { return (void)c, fmi2OK; }
#pragma GCC diagnostic ignored "-Wunused-parameter"
const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return (void)c, fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return (void)c, fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component c) { return (void)c, fmi2OK; }
fmi2Status fmi2CancelStep(fmi2Component c) { return (void)c, fmi2OK; }
NONE(fmi2SetDebugLogging, fmi2Boolean a, size_t n, const fmi2String s[])
NONE(fmi2SetupExperiment, fmi2Boolean a, fmi2Real b, fmi2Real t, fmi2Boolean d, fmi2Real e)
NONE(fmi2GetInteger, const fmi2ValueReference v[], size_t n, fmi2Integer x[])
NONE(fmi2SetInteger, const fmi2ValueReference v[], size_t n, const fmi2Integer x[])
NONE(fmi2GetBoolean, const fmi2ValueReference v[], size_t n, fmi2Boolean x[])
NONE(fmi2SetBoolean, const fmi2ValueReference v[], size_t n, const fmi2Boolean x[])
NONE(fmi2GetString, const fmi2ValueReference v[], size_t n, fmi2String x[])
NONE(fmi2SetString, const fmi2ValueReference v[], size_t n, const fmi2String x[])
NONE(fmi2SerializedFMUstateSize, fmi2FMUstate f, size_t *n)
NONE(fmi2SerializeFMUstate, fmi2FMUstate f, fmi2Byte b[], size_t n)
NONE(fmi2DeSerializeFMUstate, const fmi2Byte b[], size_t n, fmi2FMUstate *f)
NONE(fmi2GetDirectionalDerivative, const fmi2ValueReference a[], size_t n, const fmi2ValueReference b[], size_t m,
     const fmi2Real d[], fmi2Real e[])
NONE(fmi2SetRealInputDerivatives, const fmi2ValueReference v[], size_t n, const fmi2Integer o[], const fmi2Real x[])
NONE(fmi2GetRealOutputDerivatives, const fmi2ValueReference v[], size_t n, const fmi2Integer o[], fmi2Real x[])
NONE(fmi2GetStatus, const fmi2StatusKind s, fmi2Status *v)
NONE(fmi2GetRealStatus, const fmi2StatusKind s, fmi2Real *v)
NONE(fmi2GetIntegerStatus, const fmi2StatusKind s, fmi2Integer *v)
NONE(fmi2GetBooleanStatus, const fmi2StatusKind s, fmi2Boolean *v)
NONE(fmi2GetStringStatus, const fmi2StatusKind s, fmi2String *v)
